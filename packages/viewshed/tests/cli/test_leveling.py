"""Each command levels a sweep once and identifies its sensor once, and README's Python gives what the command gives."""

from pathlib import Path

import numpy as np
import pytest

import viewshed
from viewshed.cli import main
from viewshed.io.export import read_npz
from viewshed.io.samples import junction_path
from viewshed.preprocess.sensor_identification import UNIDENTIFIED, SensorId, identify_sensor
from viewshed.sensors import lidar_model
from viewshed.sweep import Sweep
from viewshed_lab.sim import cast, junction


@pytest.fixture
def sweep_file(tmp_path: Path) -> Path:
    """A file that is not the embedded sample, on which compiled code is warmed up: one point fewer."""
    sample = viewshed.read_sweep(junction_path())
    posed = sample.replace(world_from_sensor=viewshed.Rigid.from_yaw(0.0, (0.0, 0.0, 1.8)), t_ns=0)
    viewshed.write_sweep(posed.select(np.arange(len(sample) - 1)), tmp_path / "street.npz")
    return tmp_path / "street.npz"


@pytest.fixture
def identified(monkeypatch: pytest.MonkeyPatch, sweep_file: Path) -> list[int]:
    """The sizes of the sweeps whose sensor was identified, which leveling does once."""
    sizes: list[int] = []

    def counting(sweep: Sweep, before: SensorId = UNIDENTIFIED) -> SensorId:
        sizes.append(len(sweep))
        return identify_sensor(sweep, before)

    monkeypatch.setattr("viewshed.preprocess.leveling.identify_sensor", counting)
    return sizes


@pytest.mark.parametrize(
    "words",
    [
        ("estimate", "FILE", "--out", "OUT"),
        ("estimate", "FILE", "--method", "shadow_map", "--history", "2", "--out", "OUT"),
        ("compare", "FILE", "--methods", "shadow_map,first_blocker,unet", "--out", "OUT/compare.png"),
        ("export", "FILE", "--to", "npz", "--out", "OUT/fov.npz"),
    ],
    ids=lambda words: words[0],
)
def test_a_sweep_is_leveled_once(words: tuple[str, ...], sweep_file: Path, identified: list[int]) -> None:
    (sweep_file.parent / "out").mkdir()
    places = {"FILE": str(sweep_file), "OUT": str(sweep_file.parent / "out")}
    arguments = [places.get(word, word.replace("OUT", places["OUT"])) for word in words]
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert end.value.code in (0, None)
    size = len(viewshed.read_sweep(sweep_file))
    assert identified.count(size) == 1


def test_no_sensor_means_none(tmp_path: Path) -> None:
    """A cloud of a known sensor: with ``--sensor none`` no beam table is inferred from its points."""
    bare = viewshed.Sweep(cast(lidar_model("vlp16"), junction(), 1.8).points)
    viewshed.write_sweep(bare, tmp_path / "bare.npz")
    assert identify_sensor(bare).model is not None
    saved = {}
    for sensor in ("auto", "none"):
        with pytest.raises(SystemExit):
            main([
                "estimate", str(tmp_path / "bare.npz"), "--method", "shadow_map", "--sensor", sensor, "--results",
                "npz", "--out", str(tmp_path / sensor),
            ])  # fmt: skip
        saved[sensor] = read_npz(tmp_path / sensor / "bare.npz").state
    assert np.array_equal(saved["auto"], viewshed.estimate(bare, method="shadow_map").state)
    without = viewshed.estimate(bare.replace(infer_sensor=False), method="shadow_map").state
    assert np.array_equal(saved["none"], without)
    assert not np.array_equal(saved["auto"], saved["none"])
