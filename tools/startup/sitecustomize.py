"""Run by Python at its start where this folder is on its path: an editable install is not found before PYTHONPATH."""

import sys

sys.meta_path[:] = [finder for finder in sys.meta_path if not type(finder).__name__.startswith("ScikitBuild")]
