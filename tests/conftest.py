"""Fixtures that every test may use."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("viewshed", deadline=None)  # the first call of a kernel compiles it
settings.load_profile("viewshed")


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real sweeps; tests that need it are skipped, with a reason, where it is missing."""
    folder = os.environ.get("VIEWSHED_REAL_DATA")
    if not folder:
        pytest.skip("VIEWSHED_REAL_DATA is not set: real sweeps are not tested")
    path = Path(folder)
    if not path.is_dir():
        pytest.fail(f"VIEWSHED_REAL_DATA={folder} is not a folder")
    return path
