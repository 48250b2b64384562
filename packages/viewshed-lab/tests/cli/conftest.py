"""A small simulated data set for the commands that read one."""

from pathlib import Path

import pytest
from tests.cli.commands import run

SMALL = ("simulate", "ugv-small", "--sweeps", 6, "--grid", "24x8", "--workers", 1, "--out")


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("simulate") / "a"
    assert run(*SMALL, out)[0] == 0
    return out
