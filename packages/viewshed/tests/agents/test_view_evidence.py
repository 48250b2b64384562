"""What views say of each other: honest ones nearly nothing, lies about views what each gives away."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from viewshed import _core
from viewshed.agents.report import AgentReport
from viewshed.agents.view_evidence import OWN as OF_ONE
from viewshed.agents.view_evidence import PAIR, Comparisons, Surprises, compare_views
from viewshed.detections import Detections
from viewshed.fov.estimate import Basis, CellState, FovEstimate
from viewshed.fov.height_map import HeightMap
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed_lab.threats.view_attacks import VIEW_LIES, ViewLie

GRID = BevGrid(128, 32.0)

WALLS = np.array([[10.0, -6.0, 6.0], [-14.0, -10.0, 8.0], [4.0, 12.0, 12.0]])
"""x, and y from and to, of walls across the x axis."""


def honest(
    agent: str, x_m: float, y_m: float, yaw: float = 0.0, rng: np.random.Generator | None = None, grid: BevGrid = GRID
) -> FovEstimate:
    """Return the view of three walls from a place: surfaces, free before them, hidden behind."""
    pose = Rigid(Rigid.from_yaw(yaw).rotation, np.array([x_m, y_m, 0.0]))
    world = grid.centers @ pose.rotation[:2, :2].T + pose.translation[:2]
    state = np.full(grid.shape, CellState.FREE, np.uint8)
    away = world - pose.translation[:2]
    for wall_x, low, high in WALLS:
        with np.errstate(divide="ignore", invalid="ignore"):
            along = (wall_x - x_m) / away[..., 0]
        meets = y_m + along * away[..., 1]
        behind = (along > 0) & (along < 1) & (meets > low) & (meets < high)
        state[behind] = CellState.HIDDEN
    for wall_x, low, high in WALLS:
        on = (np.abs(world[..., 0] - wall_x) < 0.4) & (world[..., 1] > low) & (world[..., 1] < high)
        state[on] = CellState.SURFACE
    prob = np.where(state == CellState.HIDDEN, 0.02, 0.97)
    if rng is not None:
        prob = np.clip(prob + rng.normal(0, 0.02, grid.shape), 0, 1)
    basis = Basis(1.8, "estimated", 0.9, 0.0, 0.0, 60.0)
    return FovEstimate(grid, prob, state, world_from_level=pose, agent=agent, basis=basis, t_ns=0)


OTHERS = (honest("b", 2.0, 5.0, 0.3), honest("c", -6.0, -3.0, 2.0))

OWN = honest("a", 0.0, 0.0, 1.0)


def compare(own: FovEstimate, last: FovEstimate | None = None, ground: HeightMap | None = None) -> Comparisons:
    """Return what the view of ``a`` and those of the others say, after its last view."""
    reports = {
        number: AgentReport(each, Detections.none(), ground=ground if number == 0 else None)
        for number, each in enumerate((own, *OTHERS))
    }
    seen = {} if last is None else compare_views({0: AgentReport(last, Detections.none())}, 3, {}, [0])[1]
    return compare_views(reports, 3, seen, [0, 1, 2])[0]


def number(compared: Comparisons, name: str) -> float:
    """Return the largest number of a name between ``a`` and others, or of ``a`` alone."""
    if name in PAIR:
        both = compared.pairs[..., PAIR.index(name)]
        return float(np.nanmax([both[0], both[:, 0]]))
    return float(compared.own[0, OF_ONE.index(name)])


@pytest.mark.parametrize("offset_m", [(0.0, 0.0), (24.0, -8.0), (0.0, 28.0)])
def test_honest_views_contradict_each_other_hardly(offset_m: tuple[float, float]) -> None:
    own = honest("a", 0.0, 0.0, 1.0, grid=BevGrid(128, 32.0, offset_m))
    compared = compare(own, own)
    for name, most in (("through", 0.15), ("denied", 0.2), ("misplaced", 0.2), ("opened", 0.01), ("closed", 0.01)):
        assert number(compared, name) < most, name
    assert np.isnan(compared.pairs[[0, 1, 2], [0, 1, 2]]).all()


@pytest.mark.parametrize(
    ("lie", "name"),
    [
        ("over_claim", "opened"),
        ("behind_own", "opened"),
        ("under_claim", "denied"),
        ("under_claim", "closed"),
        ("shifted_pose", "misplaced"),
        ("turned_pose", "misplaced"),
        ("stale", "through"),
    ],
)
def test_each_lie_raises_what_looks_for_it(lie: str, name: str) -> None:
    forge, amount = VIEW_LIES[lie]
    old = replace(honest("a", -5.0, 4.0, 0.2), t_ns=-2_000_000_000)
    false = forge([old, OWN], ViewLie(0.5, amount))
    assert number(compare(false, OWN), name) > number(compare(OWN, OWN), name) + 0.05


def test_who_claims_a_wall_free_is_seen_through_by_all_that_see_it() -> None:
    free = replace(OWN, state=np.full(GRID.shape, CellState.FREE, np.uint8), visible_prob=np.full(GRID.shape, 0.97))
    through = compare(free).pairs[..., PAIR.index("through")]
    assert (through[0, 1:] > 0.6).all()
    assert np.nanmax(through[1:]) < 0.2  # of the others nobody claims what it does not see


def test_views_over_other_ground_are_not_compared() -> None:
    """The same view from a deck 5 m above, or over a slope that rises by a meter in five."""
    raised = replace(OWN, world_from_level=Rigid(OWN.world_from_level.rotation, np.array([0.0, 0.0, 5.0])))
    assert np.isnan(compare(raised).pairs[0]).all()
    steps = BevGrid(64, 32.0).centers
    slope = HeightMap((0.2 * steps[..., 0]).astype(np.float32), 32.0, np.ones((64, 64), bool))
    flat, sloped = (compare(OWN, ground=ground).pairs[0, 1:, 0] for ground in (None, slope))
    assert np.isfinite(flat).all()
    assert not np.allclose(flat, sloped, equal_nan=True)


@pytest.mark.parametrize("from_above", [False, True])
def test_what_stands_in_the_way_hides_a_little_more_than_its_own_sector(from_above: bool) -> None:
    """Free places of another agent, one before a surface, one behind it half a degree off, one behind it far off."""
    places = np.array([[5.0, 0.1], [20.0, 0.2], [20.0, 9.0], [20.0, 20.0]])
    counts = _core.compare_view(
        states=np.full((128, 128), CellState.HIDDEN, np.uint8), x_m=-32.0, y_m=-32.0, cell_m=0.5,
        heights_m=np.zeros((8, 8), np.float32), half_extent_m=32.0, pose=np.zeros(4), places_m=places,
        ground_m=np.array([0.0, 0.0, 0.0, 1.0]), owner=np.ones(4, np.int32), is_free=np.ones(4, np.bool_), own=0,
        agents=2, blockers=np.array([[10.0, -0.05]]), from_above=from_above, nearest_m=2.0, farthest_m=30.0,
        same_ground_m=0.4,
    )  # fmt: skip
    assert counts.tolist() == [[0, 0], [0, 0], [0, 3 if from_above else 2], [0, 3 if from_above else 2]]


def test_surprises_are_what_is_rare_of_each_kind() -> None:
    rng = np.random.default_rng(2)
    elevated = np.array([False, False, True])
    said = [Comparisons(rng.random((3, 3, 2)), rng.random((3, 3)) + 10.0 * elevated[:, None]) for _ in range(900)]
    surprises = Surprises.fit(said, [elevated] * 900)
    pairs, own = np.full((3, 3, 2), 0.5), np.full((3, 3), 0.5)
    pairs[0, 1, 0], own[1, 2], own[2, 2] = 0.99, 5.0, 5.0
    pairs[1, 0, 0] = np.nan
    of_pairs, of_own = surprises(Comparisons(pairs, own), elevated)
    assert of_pairs[0, 1, 0] == pytest.approx(-np.log(0.01) - Surprises.USUAL, abs=0.4)
    assert of_own[1, 2] > 3.0
    assert of_own[2, 2] == of_pairs[0, 2, 0] == 0.0
    assert np.isnan(of_pairs[1, 0, 0])
    again = Surprises.from_json(surprises.to_json())
    assert again(Comparisons(pairs, own), elevated)[0] == pytest.approx(of_pairs, nan_ok=True, abs=0.1)
    assert np.nanmax(Surprises.blank()(Comparisons(pairs, own), elevated)[1]) == 0.0
