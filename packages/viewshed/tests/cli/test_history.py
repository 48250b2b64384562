"""``viewshed estimate --history`` as a stranger types it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cli.commands import run

from viewshed import BevGrid
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.estimators.temporal import SweepBuffer, TemporalEstimator
from viewshed.io.export import read_npz
from viewshed.recordings.read.source import each_sweep
from viewshed_lab._jobs import LocalEngine
from viewshed_lab.data.archive.archive import ArchiveSource
from viewshed_lab.data.archive.storage import Storage
from viewshed_lab.data.presets import preset_named
from viewshed_lab.data.simulated import simulate

GRID = BevGrid(64, 32.0)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two agents for six seconds, one sweep a second."""
    out = tmp_path_factory.mktemp("drive") / "street"
    preset = replace(
        preset_named("nuscenes-small"), grid_cells=32, grid_half_extent_m=32.0, splits=("all",), scenes=(1,),
        frames=(12,), moving=2, sensors=("vlp16",), conditions=("clear",), condition_weights=(1.0,), interval_s=1.0,
    )  # fmt: skip
    simulate(preset, Storage.of(out), LocalEngine(1))
    return out


@pytest.mark.slow
def test_a_recording_is_estimated_with_what_each_agent_saw_before(drive: Path, tmp_path: Path) -> None:
    words = ("estimate", drive, "--grid", "64x32", "--method", "shadow_map", "--out")
    assert run(*words, tmp_path / "past", "--history", 3)[0] == 0
    assert run(*words, tmp_path / "alone")[0] == 0
    estimator, alone = TemporalEstimator(ShadowMap(GRID), SweepBuffer(3)), ShadowMap(GRID)
    fewer = 0
    for number, (_, sweep) in enumerate(each_sweep(ArchiveSource.open(drive))):
        found = read_npz(tmp_path / "past" / f"street_{sweep.agent}_{number:03}.npz")
        np.testing.assert_allclose(found.visible_prob, estimator.estimate(sweep).visible_prob, atol=0.01)
        before = read_npz(tmp_path / "alone" / f"street_{sweep.agent}_{number:03}.npz")
        np.testing.assert_allclose(before.visible_prob, alone.estimate(sweep).visible_prob, atol=0.01)
        fewer += int(found.visible().sum() < before.visible().sum())
    assert number == 11
    assert fewer >= 5
