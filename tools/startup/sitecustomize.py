"""Drop scikit-build's import hooks at Python's start, so that PYTHONPATH wins over an editable install."""

import sys

sys.meta_path[:] = [finder for finder in sys.meta_path if not type(finder).__name__.startswith("ScikitBuild")]
