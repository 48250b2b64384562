"""The shadow map against targets that are really placed in an asymmetric scene and cast."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed import CAR, PEDESTRIAN, BevGrid, Target
from viewshed.estimators.shadow_map import NO_RETURN_RULES, ShadowMap
from viewshed.sensors import LidarModel
from viewshed_lab.data.presets import preset_named
from viewshed_lab.data.simulated import ScenePlan, simulate_frame
from viewshed_lab.sim import Box, Cylinder, Scene, cast, depth_image

MODEL = LidarModel("test", np.deg2rad(np.linspace(-25, 8, 32)), azimuth_columns=720, max_range_m=150.0)
GRID = BevGrid(128, 32.0)
HEIGHT_M = 1.8
SCENE = Scene(
    boxes=(
        Box(12, 3, 0.5, 14, 5), Box(-9, -8, 20, 0.5, 4), Box(8, -6, 4.2, 1.8, 1.5, yaw=0.3),
        Box(-12, 9, 4.2, 1.8, 1.5), Box(-30, 0, 1, 80, 6), Box(40, 0, 1, 90, 8), Box(5, 38, 90, 1, 8),
        Box(5, -38, 90, 1, 8), Box(3, 9, 0.6, 0.6, 1.0),
    ),
    cylinders=(Cylinder(4.0, -11.0, 0.3, 6.0),),
)  # fmt: skip


def _stands_on(x: float, y: float, box: Box, margin_m: float = 1.2) -> bool:
    c, s = np.cos(box.yaw), np.sin(box.yaw)
    u, v = c * (x - box.x_m) + s * (y - box.y_m), c * (y - box.y_m) - s * (x - box.x_m)
    return bool(abs(u) < box.length_m / 2 + margin_m and abs(v) < box.width_m / 2 + margin_m)


def _returns_of_probe(xy: NDArray[np.float64], target: Target, base: NDArray[np.float64]) -> int | None:
    """Returns of a target put up across the line of sight; None where something else already stands."""
    x, y = xy
    if np.hypot(x, y) < 3 or any(_stands_on(x, y, box) for box in SCENE.boxes):
        return None
    probe = Scene((Box(x, y, 0.05, target.width_m, target.height_m, yaw=float(np.arctan2(y, x))),))
    alone = depth_image(MODEL, probe, HEIGHT_M)
    hits = alone < depth_image(MODEL, Scene(), HEIGHT_M) - 1e-6
    return int((hits & (alone < base)).sum())


@pytest.mark.parametrize("target", [CAR, PEDESTRIAN])
def test_agrees_with_placed_targets(target: Target) -> None:
    rng = np.random.default_rng(7)
    base = depth_image(MODEL, SCENE, HEIGHT_M)
    estimate = ShadowMap(GRID, target).estimate(cast(MODEL, SCENE, HEIGHT_M))
    right, clear, total, clear_total = 0, 0, 0, 0
    for cell in rng.integers(0, GRID.cells, (220, 2)):
        returns = _returns_of_probe(GRID.centers[tuple(cell)], target, base)
        if returns is None:
            continue
        agrees = (returns >= target.min_returns) == bool(estimate.visible()[tuple(cell)])
        total += 1
        right += agrees
        if not target.min_returns / 2 <= returns <= 2 * target.min_returns:
            clear_total += 1
            clear += agrees
    assert total > 100
    assert right / total > 0.94
    assert clear / clear_total > 0.97


@pytest.mark.parametrize("glass", [0.3, 0.6, 0.9, 1.0])
def test_a_front_that_returns_less_or_nothing_opens_no_corridor_but_by_the_rule_that_says_so(glass: float) -> None:
    sweep = cast(MODEL, SCENE, HEIGHT_M)
    wall = (np.abs(sweep.points[:, 0] - 11.75) < 0.05) & (sweep.points[:, 1] > -4) & (sweep.points[:, 1] < 10)
    mirrored = wall & (np.random.default_rng(8).random(len(sweep)) < glass)
    behind = GRID.centers[(GRID.centers[..., 0] > 13) & (np.abs(GRID.centers[..., 1] - 3) < 3)]
    claimed = {
        rule: float((ShadowMap(GRID, no_return=rule).estimate(sweep.select(~mirrored)).at(behind) >= 0.5).mean())
        for rule in NO_RETURN_RULES
    }
    assert claimed["max_range"] > 0.9
    assert claimed["inferred"] <= claimed["unknown"] + 0.015 < 0.025
    assert ShadowMap(GRID).no_return == "inferred"


def test_explained_beams_see_far_more_of_simulated_streets_than_returns_alone() -> None:
    preset = replace(preset_named("nuscenes-small"), conditions=("clear",), condition_weights=(1.0,), seed=4)
    tally = {rule: np.zeros(3) for rule in ("inferred", "unknown")}
    for scene in range(4):
        frame = simulate_frame(ScenePlan(preset, 0, scene), 3)
        true, known = frame.truth.visible("car"), frame.known
        for rule, sums in tally.items():
            claimed = ShadowMap(frame.truth.grid, CAR, rule).estimate(frame.sweep).visible()  # type: ignore[arg-type]
            sums += [(claimed & true & known).sum(), (claimed & ~true & known).sum(), (~claimed & true & known).sum()]
    f1 = {rule: 2 * both / (2 * both + over + under) for rule, (both, over, under) in tally.items()}
    assert f1["inferred"] > f1["unknown"] + 0.04
    assert f1["inferred"] > 0.88
    assert tally["inferred"][0] / tally["inferred"][:2].sum() > 0.93


def test_unknown_rules_are_refused() -> None:
    with pytest.raises(ValueError, match="no_return must be one of inferred, unknown, max_range, fill, got 'open'"):
        ShadowMap(GRID, no_return="open")  # type: ignore[arg-type]
