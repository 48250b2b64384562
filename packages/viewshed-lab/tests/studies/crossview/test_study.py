"""Cross-view truth in a scene whose answer is known."""

import numpy as np

from viewshed import BevGrid, FovEstimate, FovEstimator, Rigid, Sweep
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.sensors import LidarModel
from viewshed_lab.sim import Box, Scene, cast
from viewshed_lab.studies.crossview.page import _under_attack
from viewshed_lab.studies.crossview.rates import SeenColumns, crossview_truth, evaluate_crossview, rows_of

MODEL = LidarModel("test", np.deg2rad(np.linspace(-20, 8, 48)), azimuth_columns=900)
GRID = BevGrid(256, 64.0)
WALL = Box(10, 2, 0.4, 8, 3)
VAN = Box(20, 3, 5, 2.2, 2.2, yaw=1.2)
OPEN_VAN = Box(15, -12, 5, 2.2, 2.2, yaw=0.5)
SCENE = Scene((WALL, VAN, OPEN_VAN))


def _sweep(x_m: float, y_m: float, t_ns: int) -> Sweep:
    def moved(box: Box) -> Box:
        return Box(box.x_m - x_m, box.y_m - y_m, box.length_m, box.width_m, box.top_m, yaw=box.yaw)

    scene = Scene(tuple(moved(box) for box in SCENE.boxes))
    sweep = cast(MODEL, scene, 1.8, rng=np.random.default_rng(t_ns))
    return sweep.replace(world_from_sensor=Rigid(np.eye(3), np.array([x_m, y_m, 1.8])), t_ns=t_ns * 10**9)


SWEEPS = [_sweep(0, 0, 0), _sweep(28, 14, 1), _sweep(32, -3, 2), _sweep(24, 18, 3)]


def test_the_van_behind_the_wall_is_unseen_and_the_open_one_is_seen() -> None:
    _, columns = crossview_truth([SWEEPS])[0]
    hidden, shown = columns.xy[~columns.seen], columns.xy[columns.seen]
    assert len(hidden) > 3
    assert len(shown) > 3
    assert (np.hypot(hidden[:, 0] - VAN.x_m, hidden[:, 1] - VAN.y_m) < 4).all()
    near_open = np.hypot(shown[:, 0] - OPEN_VAN.x_m, shown[:, 1] - OPEN_VAN.y_m) < 4
    near_wall = np.abs(shown[:, 0] - WALL.x_m) < 1.5
    assert (near_open | near_wall).all()
    assert not columns.through.any()


class _Constant:
    def __init__(self, value: float) -> None:
        self.value = value
        self.grid = GRID

    def estimate(self, sweep: Sweep) -> FovEstimate:
        del sweep
        filled = np.full(GRID.shape, self.value, np.float32)
        return FovEstimate(GRID, filled, (filled > 0.5).astype(np.uint8))


def test_the_rates_of_all_nothing_and_the_shadow_map() -> None:
    estimators: dict[str, FovEstimator] = {
        "all": _Constant(1.0),
        "nothing": _Constant(0.0),
        "shadow_map": ShadowMap(GRID),
    }
    rows = {r.method: r for r in evaluate_crossview([SWEEPS], estimators, rng=np.random.default_rng(0))}
    assert (rows["all"].over.value, rows["all"].under.value) == (1.0, 0.0)
    assert (rows["nothing"].over.value, rows["nothing"].under.value) == (0.0, 1.0)
    assert rows["shadow_map"].over.value < 0.05
    assert rows["shadow_map"].under.value < 0.05
    assert rows["all"].over.low <= rows["all"].over.value <= rows["all"].over.high
    assert rows["all"].under.columns > 50


def test_an_attack_without_a_known_column_adds_nothing() -> None:
    nothing = SeenColumns(np.empty((0, 2)), np.empty(0, bool), np.empty(0, bool))
    table = _under_attack([(SWEEPS[0], nothing)], {"all": _Constant(1.0)}, ["uniform"], 0, lambda _: None)
    assert table.rows == [["all", "– / –", "– / –", "–"]]


def test_estimators_are_shown_what_the_attacker_left_and_the_truth_is_of_the_sweep_itself() -> None:
    def halved(sweep: Sweep) -> Sweep:
        return sweep.select(sweep.points[:, 1] > 0)

    estimators: dict[str, FovEstimator] = {"shadow_map": ShadowMap(GRID)}
    clean = evaluate_crossview([SWEEPS], estimators, rng=np.random.default_rng(0))[0]
    shown = rows_of(crossview_truth([SWEEPS]), estimators, rng=np.random.default_rng(0), shown=halved)[0]
    assert (shown.over.columns, shown.under.columns) == (clean.over.columns, clean.under.columns)
    assert shown.under.value > clean.under.value + 0.2
