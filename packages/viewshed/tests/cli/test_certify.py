"""``viewshed estimate --certify``: what is written is certified, and what was inferred certifies nothing."""

from pathlib import Path

import numpy as np
import pytest
from tests.cli.commands import run

from viewshed import read_sweep
from viewshed.estimators import load_estimator
from viewshed.fov.visibility import CAR
from viewshed.grid import GRIDS
from viewshed.guarantees.envelope import Envelope, Given
from viewshed.io.samples import junction_path
from viewshed.preprocess.leveling import level

GIVEN = ("--sensor", "hdl32e", "--height", "1.84", "--attitude", "1,0,0,0")


@pytest.mark.slow
def test_what_is_written_is_certified(tmp_path: Path) -> None:
    done = run("estimate", junction_path(), "--certify", "replaced:5", *GIVEN, "--results", "npz", "--out", tmp_path)
    assert "certified against 5 replaced beams anywhere" in done.stdout
    with np.load(tmp_path / "junction.npz") as arrays:
        claimed = arrays["visible_prob"] >= 0.5
    sweep = read_sweep(junction_path(), sensor="hdl32e", sensor_height_m=1.84).replace(attitude=np.eye(4)[0])
    leveled = level(sweep, GRIDS["road"])
    envelope = Envelope.of(leveled, Given.of(leveled), GRIDS["road"], CAR)
    assert claimed.any()
    certified = envelope.claim & envelope.open(5)
    assert (claimed == load_estimator("shadow_map").estimate(leveled).visible() & certified).all()


@pytest.mark.slow
def test_what_is_inferred_certifies_nothing(tmp_path: Path) -> None:
    done = run("estimate", junction_path(), "--certify", "added", "--results", "npz", "--out", tmp_path)
    assert "visible 0 m²" in done.stdout
    assert "nothing certified: beam table, attitude, mounting height inferred from the sweep itself" in done.stdout


def test_an_unknown_threat(tmp_path: Path) -> None:
    done = run("estimate", junction_path(), "--certify", "magic", "--out", tmp_path)
    assert done.returncode == 2
    assert "threat must be one of added, replaced, window" in done.stderr
