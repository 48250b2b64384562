"""Checks of claimed views: what honest views pass, and lies about views do not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from viewshed.agents.view_checks import (
    LOOKS,
    VIEW_CHECKS,
    CheckedViews,
    ClaimedView,
    ViewScale,
    certainty,
    check_view,
    claims_behind_walls,
    claims_in_shadows,
    hidden_detections,
    misplaced,
    open_but_denied,
    surfaces_claimed_free,
    surfaces_seen_free,
    view_doubt,
)
from viewshed.detections import Detections
from viewshed.fov.estimate import Basis, CellState, FovEstimate
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed_lab.threats.view_attacks import VIEW_LIES, ViewLie, with_objects, without_objects

GRID = BevGrid(128, 32.0)

WALLS = np.array([[10.0, -6.0, 6.0], [-14.0, -10.0, 8.0], [4.0, 12.0, 12.0]])
"""x, and y from and to, of walls across the x axis."""


def honest(agent: str, x_m: float, y_m: float, yaw: float = 0.0, rng: np.random.Generator | None = None) -> FovEstimate:
    """Return the view of three walls from a place: surfaces, free before them, hidden behind."""
    pose = Rigid(Rigid.from_yaw(yaw).rotation, np.array([x_m, y_m, 0.0]))
    world = GRID.centers @ pose.rotation[:2, :2].T + pose.translation[:2]
    state = np.full(GRID.shape, CellState.FREE, np.uint8)
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
        prob = np.clip(prob + rng.normal(0, 0.02, GRID.shape), 0, 1)
    basis = Basis(1.8, "estimated", 0.9, 0.0, 0.0, 60.0)
    return FovEstimate(GRID, prob, state, world_from_level=pose, agent=agent, basis=basis, t_ns=0)


OTHERS = (honest("b", 2.0, 5.0, 0.3), honest("c", -6.0, -3.0, 2.0))

OWN = honest("a", 0.0, 0.0, 1.0)


def claimed(estimate: FovEstimate, boxes: np.ndarray | None = None) -> ClaimedView:
    rows = np.zeros((0, 7)) if boxes is None else boxes
    detections = Detections(rows, np.full(len(rows), 3, np.uint8), np.full(len(rows), 30, np.int32))
    return ClaimedView(estimate, detections, OTHERS)


def lied(name: str, azimuth: float = 0.5) -> ClaimedView:
    lie, amount = VIEW_LIES[name]
    old = replace(honest("a", -2.0, 1.0, 0.8), t_ns=-2_000_000_000)
    return claimed(lie([old, OWN], ViewLie(azimuth, amount)))


def test_an_honest_view_is_hardly_suspicious() -> None:
    view = claimed(OWN)
    assert claims_behind_walls(view) < 0.05
    assert open_but_denied(view) < 0.2  # rays are longer than the grid is wide
    assert surfaces_claimed_free(view) < 0.05
    assert misplaced(view) < 0.05


@pytest.mark.parametrize(
    ("lie", "check"),
    [
        ("over_claim", claims_behind_walls),
        ("behind_own", claims_behind_walls),
        ("under_claim", open_but_denied),
        ("shifted_pose", misplaced),
        ("turned_pose", misplaced),
        ("stale", misplaced),
        ("inflated_certainty", certainty),
    ],
)
def test_each_lie_raises_a_check_that_looks_for_it(lie: str, check: Callable[[ClaimedView], float]) -> None:
    assert check(lied(lie)) > check(claimed(OWN)) + 0.02


def test_own_objects_in_hidden_cells_and_free_shadows_are_suspicious() -> None:
    behind = OWN.grid.centers[np.nonzero(OWN.state == CellState.HIDDEN)]
    range_m = np.hypot(*behind.T)
    deep = behind[(range_m > 20) & (range_m < 30)]
    boxes = np.column_stack([deep[:1], [[0.8, 4.0, 2.0, 1.5, 0.0]]])
    assert hidden_detections(claimed(OWN, boxes)) == 1.0
    free = OWN.grid.centers[np.nonzero(OWN.state == CellState.FREE)]
    near = free[np.argmin(np.abs(np.hypot(*free.T) - 6.0))]
    boxes = np.array([[*near, 0.8, 2.0, 2.0, 1.5, 0.0]])
    assert hidden_detections(claimed(OWN, boxes)) == 0.0
    assert claims_in_shadows(claimed(OWN, boxes)) > 0.5  # nothing stands there, and yet it is reported


def test_surfaces_of_one_that_others_see_free_are_suspicious() -> None:
    state = OWN.state.copy()
    state[70:90, 40:60] = CellState.SURFACE
    assert surfaces_seen_free(claimed(replace(OWN, state=state))) > surfaces_seen_free(claimed(OWN)) + 0.1


def test_checks_abstain_where_there_is_nothing_to_look_at() -> None:
    alone = check_view(ClaimedView(OWN, Detections.none()))
    names = list(VIEW_CHECKS)
    for name in ("hidden_detections", "claims_in_shadows", "claims_behind_walls", "misplaced"):
        assert np.isnan(alone[names.index(name)]), name
    with pytest.raises(ValueError, match="must have a pose"):
        ClaimedView(replace(OWN, world_from_level=None), Detections.none())


def test_the_scale_counts_what_is_rare_and_nothing_else() -> None:
    rng = np.random.default_rng(2)
    scale = ViewScale.fit(rng.random((500, 2)), 10 + rng.random((500, 2)))
    usual, rare = scale(np.array([[0.5, 0.5], [0.999, 5.0]]), elevated=False)
    assert usual.max() < 0.5
    assert rare[0] > 2.0
    assert rare[1] > 3.0
    assert scale(np.array([np.nan, 0.5]), elevated=False)[0] == 0.0
    assert scale(np.array([5.0, 5.0]), elevated=True).max() < 0.1
    assert view_doubt(usual) < 0.2 < view_doubt(rare)
    again = ViewScale.from_json(scale.to_json())
    assert again(np.array([0.999, 5.0]), elevated=False) == pytest.approx(rare, abs=1e-3)


def test_views_are_checked_in_turn_and_say_nothing_before_the_second_look() -> None:
    checked, said = CheckedViews(3), {0: (OWN, Detections.none()), 2: (OTHERS[0], Detections.none())}
    found = [checked.add(said) for _ in range(4)]
    spoke = [np.isfinite(one).any(axis=1).tolist() for one in found]
    assert spoke == [[False] * 3, [False] * 3, [True, False, False], [True, False, True]]
    assert found[-1][0] == pytest.approx(
        check_view(ClaimedView(OWN, Detections.none(), (OTHERS[0],))), nan_ok=True
    )  # the mean of two looks at the same
    silent = checked.add({})
    assert np.array_equal(silent, found[-1], equal_nan=True)


def test_a_mast_taller_than_those_of_the_honest_scenes_is_not_checked() -> None:
    tall = replace(OWN, basis=Basis(30.0, "given", 0.9, 0.0, 0.0, 60.0))
    checked, said = CheckedViews(2), {0: (tall, Detections.none()), 1: (OTHERS[0], Detections.none())}
    found = [checked.add(said) for _ in range(4)][-1]
    assert np.isfinite(found).any(axis=1).tolist() == [False, True]


def test_a_view_is_compared_with_the_nearest_others_alone() -> None:
    far = [
        replace(OTHERS[0], agent=f"far{k}", world_from_level=Rigid(np.eye(3), np.array([500.0 + k, 0.0, 0.0])))
        for k in range(9)
    ]
    some, near = CheckedViews(12), CheckedViews(12)
    nothing = Detections.none()
    crowd = {k + 3: (one, nothing) for k, one in enumerate(far)}
    few = {0: (OWN, nothing), 1: (OTHERS[0], nothing), 2: (OTHERS[1], nothing)}
    for _ in range(LOOKS):
        some._last = near._last = [-1] + [99] * 11  # the first one is looked at
        with_crowd, without = some.add(few | crowd), near.add(few)
    assert with_crowd[0] == pytest.approx(without[0], nan_ok=True)


@pytest.mark.parametrize("name", VIEW_LIES)
def test_lies_are_valid_views_and_change_what_they_say(name: str) -> None:
    lie, amount = VIEW_LIES[name]
    old = replace(honest("a", -2.0, 1.0, 0.8), t_ns=-2_000_000_000)
    false = lie([old, OWN], ViewLie(0.7, amount))
    assert false.agent == "a"
    if name == "over_claim":
        assert false.visible().sum() / OWN.visible().sum() == pytest.approx(1.2, abs=0.03)
    if name == "under_claim":
        assert false.visible().sum() / OWN.visible().sum() == pytest.approx(0.7, abs=0.03)
    moved = np.linalg.norm(false.world_from_level.translation - OWN.world_from_level.translation)
    assert moved == pytest.approx(1.0 if name == "shifted_pose" else 0.0, abs=1e-9)
    visible = (false.state == CellState.FREE) | (false.state == CellState.SURFACE)
    assert (false.visible() == visible).all()


def test_a_forged_object_has_a_near_side_and_a_shadow_and_can_be_taken_away() -> None:
    view = FovEstimate(GRID, np.full(GRID.shape, 0.9, np.float32), np.full(GRID.shape, CellState.FREE, np.uint8))
    box = np.array([[10.0, 0.0, 0.8, 4.0, 2.0, 1.5, 0.0]])
    forged = with_objects(view, box)

    def at(x_m: float, y_m: float, of: FovEstimate = forged) -> int:
        cells, _ = GRID.index(np.array([x_m, y_m]))
        return int(of.state[cells[0], cells[1]])

    # It stands from x = 8 to 12 m: its near side is seen, the rest and what lies behind is not.
    assert at(8.2, 0.2) == CellState.SURFACE
    assert at(11.2, 0.2) == at(20.2, 0.2) == CellState.HIDDEN
    assert at(6.2, 0.2) == at(10.2, 4.2) == at(-10.2, 0.2) == CellState.FREE
    assert not forged.visible()[forged.state == CellState.HIDDEN].any()
    gone = without_objects(forged, box)
    assert at(8.2, 0.2, gone) == at(11.2, 0.2, gone) == CellState.FREE
    assert at(20.2, 0.2, gone) == CellState.HIDDEN  # nobody knows what it hid
