"""A small archive of streets and a small config: six scenes of four sweeps, 32 cells a side."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from viewshed_lab._jobs import LocalEngine
from viewshed_lab.data.archive.storage import Storage
from viewshed_lab.data.presets import preset_named
from viewshed_lab.data.simulated import simulate
from viewshed_lab.training import TrainConfig, read_config


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Tiny networks are slower with more threads."""
    torch = pytest.importorskip("torch", reason="torch is not installed: training is not tested")
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="session")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("training") / "streets"
    preset = replace(
        preset_named("nuscenes-small"), grid_cells=32, grid_half_extent_m=32.0, scenes=(6, 1), frames=(24, 2),
        sensors=("vlp16",), conditions=("clear",), condition_weights=(1.0,), revolution_s=0.0,
    )  # fmt: skip
    simulate(preset, Storage.of(out), LocalEngine(1))
    return out


@pytest.fixture
def config(archive: Path) -> TrainConfig:
    """Three epochs of a network with 4 channels; half of the frames are attacked."""
    return replace(
        read_config("road"), name="tiny", data=(str(archive),), cells=32, half_extent_m=32.0, width=4, depth=2,
        attacks=("paper", "ghost_wall", "replay"), attack_share=0.5, learning_rate=0.01, epochs=3, patience=3, batch=4,
        frames_per_epoch=0, validation_share=0.3, versions=0, mirrored=False, precision="32", workers=0,
    )  # fmt: skip
