"""Fixtures that every test may use."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

import tests  # noqa: F401  one package of three folders: pytest alone would use only the first folder it finds

ROOT = Path(__file__).resolve().parent

# Each run tries the same examples, so that no unrelated change fails by chance; `make properties` samples new ones.
# No deadlines: the first call of a kernel compiles it.
settings.register_profile("fixed", deadline=None, derandomize=True, database=None)
settings.register_profile("random", deadline=None, print_blob=True)
settings.load_profile(os.environ.get("VIEWSHED_HYPOTHESIS", "fixed"))


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Return the folder of real sweeps: VIEWSHED_REAL_DATA, or else ``shared/data`` beside the checkout."""
    given = os.environ.get("VIEWSHED_REAL_DATA")
    path = Path(given) if given else ROOT.parent / "shared" / "data"
    if not path.is_dir():
        if given:
            pytest.fail(f"VIEWSHED_REAL_DATA={given} is not a folder")
        pytest.skip("no real sweeps: VIEWSHED_REAL_DATA is not set and ../shared/data is not there")
    return path.resolve()
