"""The shipped networks on real sweeps, which they have never seen the like of."""

from pathlib import Path

import numpy as np
import onnxruntime
import pytest

from viewshed import CAR, GRIDS, PEDESTRIAN, Target, read_sweep
from viewshed.arrays import Mask
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.estimators.unet import load_network
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.networks.weights import manifest

pytestmark = pytest.mark.slow

ROAD = GRIDS["road"]
FILES = ("nuscenes/*.pcd.bin", "kitti/object/*.bin")


def agreement(one: Mask, two: Mask) -> float:
    return float((one & two).sum() / (one | two).sum())


def test_each_method_is_shipped_once_for_what_it_is_said_to_be() -> None:
    places = [(line.half_extent_m, line.target, method) for line in manifest().values() for method in line.methods]
    published = [(64.0, "car"), (16.0, "pedestrian")]
    assert sorted(places) == sorted((*place, method) for place in published for method in ("unet", "mc_dropout"))


def test_real_roads_look_as_the_shadow_map_sees_them(real_data: Path) -> None:
    """Two ways to see the same streets agree on most of what is visible, and on far less once one is mirrored."""
    found = []
    for path in sorted(path for pattern in FILES for path in real_data.glob(pattern)):
        sweep = read_sweep(path)
        mask = load_network("unet", ROAD).estimate(sweep).visible()
        other = ShadowMap(ROAD).estimate(sweep).visible()
        found.append([agreement(mask, each) for each in (other, other[::-1], other[:, ::-1], other.T)])
    same, *wrong = np.mean(found, axis=0)
    assert len(found) >= 6
    assert np.median([row[0] for row in found]) > 0.5
    assert same > max(wrong) + 0.05


def test_a_turned_sweep_has_a_turned_view(real_data: Path) -> None:
    """A quarter turn of the sensor turns the view: x ahead becomes y at the left."""
    sweep = read_sweep(sorted(real_data.glob(FILES[0]))[0]).replace(attitude=np.array([1.0, 0.0, 0.0, 0.0]))
    turned = sweep.replace(points=(sweep.points @ Rigid.from_yaw(np.pi / 2).rotation.T).astype(np.float32))
    estimator = load_network("unet", ROAD)
    straight, left = estimator.estimate(sweep).visible(), estimator.estimate(turned).visible()
    assert agreement(np.rot90(straight), left) > 0.8
    assert agreement(np.rot90(straight), left) > agreement(straight, left) + 0.1


def test_passes_differ_where_the_view_ends(real_data: Path) -> None:
    sweep = read_sweep(sorted(real_data.glob(FILES[0]))[0])
    found = load_network("mc_dropout", ROAD).estimate(sweep)
    assert np.isfinite(found.std).all()
    doubtful = (found.visible_prob > 0.2) & (found.visible_prob < 0.8)
    sure = (found.visible_prob < 0.02) | (found.visible_prob > 0.98)
    assert found.std[doubtful].mean() > 3 * found.std[sure].mean()


def test_a_graphics_card_is_asked_for_the_network_in_float32(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where there is none, that is what the error says; the network in bytes is refused for being in bytes."""
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: ["CPUExecutionProvider"])
    with pytest.raises(ImportError, match="engine cuda needs an ONNX Runtime with CUDA"):
        load_network("unet", ROAD, device="cuda")
    with pytest.raises(
        ValueError, match="engine must be onnxruntime for road_int8, a network with 8-bit weights, got cuda"
    ):
        load_network("unet", ROAD, weights="road_int8", device="cuda")
    with pytest.raises(ValueError, match="device must be one of cpu, cuda, got 'abacus'"):
        load_network("unet", ROAD, device="abacus")


@pytest.mark.parametrize(("name", "grid", "target"), [("road", ROAD, CAR), ("indoor", GRIDS["indoor"], PEDESTRIAN)])
def test_twenty_passes_in_bytes_say_what_they_say_in_float32(
    real_data: Path, name: str, grid: BevGrid, target: Target
) -> None:
    sweep = read_sweep(sorted(real_data.glob(FILES[0]))[0])
    whole, small = (
        load_network("mc_dropout", grid, target, weights=each).estimate(sweep) for each in (name, f"{name}_int8")
    )
    assert (whole.visible() != small.visible()).mean() < 0.02
    assert np.abs(whole.visible_prob - small.visible_prob).mean() < 0.02
    assert small.std.mean() == pytest.approx(whole.std.mean(), rel=0.1)
    assert np.corrcoef(whole.std.ravel(), small.std.ravel())[0, 1] > 0.9
