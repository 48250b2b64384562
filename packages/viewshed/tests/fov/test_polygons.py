"""Masks to polygons and back; inner polygons and sectors never leave the mask."""

import itertools

import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray
from shapely import MultiPolygon, Polygon

from viewshed import _core
from viewshed.arrays import Mask
from viewshed.fov.polygons import (
    blind_spot,
    free_ranges,
    inner_polygon_of_mask,
    mask_of_polygon,
    polygon_of_mask,
    sectors_of_mask,
    star_ring,
    vertices_of,
)
from viewshed.grid import BevGrid

SIDES = st.integers(1, 9)
MASKS = SIDES.flatmap(lambda n: hnp.arrays(np.bool_, (n, n)))


def grid_of(mask: Mask) -> BevGrid:
    return BevGrid(len(mask), 0.37 * len(mask), (0.4, -1.3))


def union_of_cells(mask: Mask, grid: BevGrid) -> shapely.Geometry:
    half = grid.cell_m / 2
    centers = grid.centers[mask]
    return shapely.union_all(shapely.box(*(centers - half).T, *(centers + half).T))


def street(seed: int, cells: int = 96, noise: float = 0.0) -> tuple[Mask, BevGrid]:
    """An asymmetric star: range that differs by direction, shadows of boxes, some of them short, and noise."""
    rng, grid = np.random.default_rng(seed), BevGrid(cells, cells / 4)
    x, y = grid.centers[..., 0], grid.centers[..., 1]
    distance, angle = np.hypot(x, y), np.arctan2(y, x)
    mask = (distance < 22 + 3 * np.sin(angle)) & (y < 11) & (x > -15)
    for _ in range(12):
        near, at, width = rng.uniform(4, 18), rng.uniform(-np.pi, np.pi), rng.uniform(0.5, 3)
        off = np.abs((angle - at + np.pi) % (2 * np.pi) - np.pi)
        mask &= ~((off < width / near / 2) & (distance > near) & (distance < near + rng.uniform(2, 30)))
    return mask ^ (rng.random(mask.shape) < noise), grid


def outside_area(shape: shapely.Geometry, mask: Mask, grid: BevGrid) -> float:
    return float(shapely.difference(shape, polygon_of_mask(mask, grid)).area)


@given(MASKS)
def test_polygon_is_the_union_of_the_cells(mask: Mask) -> None:
    grid = grid_of(mask)
    polygon = polygon_of_mask(mask, grid)
    assert polygon.is_valid
    assert polygon.area == pytest.approx(mask.sum() * grid.cell_area_m2)
    difference = shapely.symmetric_difference(
        shapely.set_precision(polygon, 1e-9), shapely.set_precision(union_of_cells(mask, grid), 1e-9)
    )
    assert difference.area < 1e-7


@given(MASKS)
def test_mask_to_polygon_to_mask_is_exact(mask: Mask) -> None:
    grid = grid_of(mask)
    np.testing.assert_array_equal(mask_of_polygon(polygon_of_mask(mask, grid), grid), mask)


def test_empty_mask_gives_an_empty_polygon() -> None:
    grid = BevGrid(4, 2.0)
    empty = np.zeros((4, 4), bool)
    assert polygon_of_mask(empty, grid).is_empty
    assert inner_polygon_of_mask(empty, grid, 16).is_empty
    assert not mask_of_polygon(MultiPolygon(), grid).any()
    assert len(sectors_of_mask(empty, grid, 4).range_m) == 0


@given(st.integers(0, 10_000), st.floats(0, 6.3))
@settings(max_examples=50)
def test_mask_of_polygon_agrees_with_shapely(seed: int, turn: float) -> None:
    rng, grid = np.random.default_rng(seed), BevGrid(17, 6.0, (1.0, -2.0))
    shell = rng.uniform(-7, 7, (6, 2))
    polygon = shapely.difference(shapely.convex_hull(shapely.MultiPoint(shell)), shapely.Point(1, 0).buffer(1.5))
    polygon = shapely.affinity.rotate(polygon, turn, use_radians=True)
    if polygon.is_empty:
        return
    inside = shapely.contains_xy(polygon, grid.centers[..., 0], grid.centers[..., 1])
    np.testing.assert_array_equal(mask_of_polygon(polygon, grid), inside)


def test_mask_of_polygon_wants_an_area() -> None:
    with pytest.raises(ValueError, match="polygon must be a Polygon or MultiPolygon, got LineString"):
        mask_of_polygon(shapely.LineString([(0, 0), (1, 1)]), BevGrid(4, 2.0))


@pytest.mark.parametrize("function", [polygon_of_mask, lambda m, g: inner_polygon_of_mask(m, g, 9)])
def test_wrong_masks_are_refused(function: object) -> None:
    assert callable(function)
    with pytest.raises(ValueError, match=r"mask must be bool of the grid's shape \(4, 4\), got bool \(3, 4\)"):
        function(np.zeros((3, 4), bool), BevGrid(4, 2.0))
    with pytest.raises(ValueError, match="got float64"):
        function(np.zeros((4, 4)), BevGrid(4, 2.0))


@given(MASKS, st.sampled_from([3, 4, 7, 16]))
@settings(max_examples=60)
def test_inner_polygon_stays_inside_any_mask(mask: Mask, vertices: int) -> None:
    grid = grid_of(mask)
    inner = inner_polygon_of_mask(mask, grid, vertices)
    assert inner.is_valid
    assert vertices_of(inner) <= vertices
    assert outside_area(inner, mask, grid) < 1e-9
    exact = polygon_of_mask(mask, grid)
    assert inner_polygon_of_mask(mask, grid, max(vertices_of(exact), 3)) == exact


def test_inner_polygon_keeps_much_of_a_clean_mask_and_more_with_more_vertices() -> None:
    mask, grid = street(0)
    kept = [inner_polygon_of_mask(mask, grid, n).area / (mask.sum() * grid.cell_area_m2) for n in (8, 32, 128)]
    assert kept == sorted(kept)
    assert kept[1] > 0.6
    assert kept[2] > 0.8


def test_inner_polygon_keeps_the_blind_spot_out() -> None:
    mask, grid = np.ones((32, 32), bool), BevGrid(32, 16.0)
    mask[15:18, 15:17] = False
    mask[0, ::2] = False
    inner = inner_polygon_of_mask(mask, grid, 24)
    assert not inner.contains(shapely.Point(0, 0))
    assert inner.area > 0.85 * mask.sum()


@given(st.integers(0, 10_000), st.integers(1, 20), st.booleans())
@settings(max_examples=40)
def test_sectors_stay_inside(seed: int, count: int, whole_cells: bool) -> None:
    mask, grid = street(seed % 50, cells=64, noise=0.002)
    found = sectors_of_mask(mask, grid, count, whole_cells=whole_cells, range_step_m=0.1)
    assert len(found.range_m) <= count
    assert not (found.covers(grid.centers) & ~mask).any()
    if whole_cells:
        rng = np.random.default_rng(seed)
        points = rng.uniform(-16, 16, (4000, 2))
        cells, on_grid = grid.index(points)
        seen = np.where(on_grid, mask[cells[:, 0], cells[:, 1]], False)
        assert not (found.covers(points) & ~seen).any()


@given(st.lists(st.integers(0, 6), min_size=4, max_size=8), st.integers(1, 3), st.sampled_from([0.0, 1.5]))
def test_sectors_are_the_best_of_all(ranges: list[int], count: int, inner: float) -> None:
    bins = len(ranges)

    def cover(first: int, end: int, reach: float) -> NDArray[np.float64]:
        covered = np.full(bins, inner)
        covered[np.arange(first, end) % bins] = max(reach, inner)
        return covered

    def gains(covers: NDArray[np.float64]) -> NDArray[np.float64]:  # (choices, sectors, bins): sectors lie upon others
        most: NDArray[np.float64] = (covers.max(axis=1) ** 2 - inner**2).sum(axis=1)
        return most

    wrapped = np.array(ranges * 2, float)
    every = [cover(i, i + w, wrapped[i : i + w].min()) for i in range(bins) for w in range(1, bins + 1)]
    expected = gains(np.array(every)[list(itertools.combinations(range(len(every)), count))]).max()
    found = tuple(zip(*(part.tolist() for part in _core.best_sectors(wrapped[:bins], count, inner)), strict=True))
    assert len(found) <= count
    assert all(reach <= wrapped[first:end].min() for first, end, reach in found)
    said = gains(np.array([[np.full(bins, inner), *(cover(*sector) for sector in found)]]))
    assert said[0] == pytest.approx(expected)


def test_sectors_begin_beyond_the_blind_spot() -> None:
    mask, grid = np.ones((16, 16), bool), BevGrid(16, 8.0)
    mask[6:10, 7:9] = False
    hole = blind_spot(mask, grid)
    np.testing.assert_array_equal(hole, ~mask)
    found = sectors_of_mask(mask, grid, 4)
    assert found.inner_m >= np.hypot(2, 1)
    assert not (found.covers(grid.centers) & ~mask).any()
    assert found.area_m2 > 0.6 * mask.sum()


def test_blind_spot_of_an_open_or_absent_sensor_is_none() -> None:
    half = np.ones((8, 8), bool)
    half[:, :4] = False
    assert blind_spot(half, BevGrid(8, 4.0)) is None
    assert blind_spot(np.ones((8, 8), bool), BevGrid(8, 4.0, (50.0, 0.0))) is None
    seen = blind_spot(np.ones((8, 8), bool), BevGrid(8, 4.0))
    assert not seen.any()


@pytest.mark.parametrize("offset_m", [(50.0, 0.0), (4.1, 0.0), (0.0, -20.0)])
def test_a_sensor_off_the_grid_has_no_sectors(offset_m: tuple[float, float]) -> None:
    assert sectors_of_mask(np.ones((16, 8), bool)[::2], BevGrid(8, 4.0, offset_m), 4).area_m2 == 0.0


def wedges(apex: tuple[float, float], bins: int, wider: float) -> list[shapely.Polygon]:
    """The wedges of ``free_ranges`` but for their first 1e-6 m, each ``wider`` radians wider at either side."""
    begin = np.arange(bins) * (2 * np.pi / bins) - wider
    end = begin + 2 * np.pi / bins + 2 * wider
    corners = [(1e-6, begin), (60.0, begin), (60.0, end), (1e-6, end)]
    rings = np.stack([apex + r * np.stack([np.cos(a), np.sin(a)], axis=1) for r, a in corners], axis=1)
    return [shapely.Polygon(ring) for ring in rings]


@given(st.integers(0, 19), st.floats(-5, 5), st.floats(-5, 5), st.sampled_from([12, 72, 360]))
@example(386 % 20, -5.0, -0.99999, 360)  # on a border between cells: free on one side only
@example(0, 0.0, 1e-9, 360)  # beside a border: corners far along it
@settings(max_examples=15)
def test_free_ranges_are_the_distance_to_what_is_not_true_in_each_wedge(
    seed: int, x: float, y: float, bins: int
) -> None:
    mask, grid = street(seed, cells=64)
    ranges = free_ranges(mask, grid, (x, y), bins)
    blocked = shapely.difference(shapely.box(-17, -17, 17, 17), polygon_of_mask(mask, grid))
    narrow, wide = (
        shapely.distance(shapely.Point(x, y), shapely.intersection(wedges((x, y), bins, wider), blocked))
        for wider in (-1e-6, 1e-6)  # what only touches a wedge's border may count or not
    )
    assert (wide - 2e-6 <= ranges).all()
    assert (ranges <= narrow + 1e-9).all()


@pytest.mark.parametrize("apex", [(16.1, 0.0), (-3.0, 40.0), (0.0, -1e6)])
def test_from_off_the_grid_nothing_is_free(apex: tuple[float, float]) -> None:
    grid = BevGrid(64, 16.0)
    assert not free_ranges(np.ones(grid.shape, bool), grid, apex, 72).any()
    assert not sectors_of_mask(np.ones(grid.shape, bool), grid, 4, apex_m=apex).range_m.any()


@given(st.integers(5, 199), st.sampled_from([50.0, 64.0]), st.sampled_from(["right", "left", "ahead", "behind"]))
@example(100, 64.0, "right")
@settings(max_examples=25)
def test_half_of_an_even_grid_is_free_on_its_side_only(half: int, extent_m: float, side: str) -> None:
    grid = BevGrid(2 * half, extent_m)  # the apex is a corner of cells, whose sides are seldom exact in binary
    along = grid.centers[..., 0 if side in ("ahead", "behind") else 1] * (1 if side in ("ahead", "left") else -1)
    at = np.linspace(0, 2 * np.pi, 72, endpoint=False) + np.pi / 72
    toward = (np.cos(at) if side in ("ahead", "behind") else np.sin(at)) * (1 if side in ("ahead", "left") else -1)
    ranges = free_ranges(along > 0, grid, (0.0, 0.0), 72)
    assert not ranges[toward < 0].any()
    assert (ranges[toward > 0] > extent_m - 1e-6).all()
    assert (ranges < 1.5 * extent_m).all()
    assert not free_ranges(along > grid.cell_m, grid, (0.0, 0.0), 72).any()


@given(MASKS, st.sampled_from([8, 72, 360]))
def test_a_star_ring_claims_no_cell_that_the_mask_does_not(mask: Mask, bins: int) -> None:
    grid = grid_of(mask)
    ring = star_ring(mask, grid, bins)
    if len(ring):
        assert outside_area(shapely.make_valid(Polygon(ring)), mask, grid) < 1e-6


@pytest.mark.parametrize("seed", range(4))
def test_a_star_ring_of_a_street_claims_most_of_what_is_seen_from_the_sensor(seed: int) -> None:
    mask, grid = street(seed)
    shape = shapely.make_valid(Polygon(star_ring(mask, grid, 720)))
    assert outside_area(shape, mask, grid) < 1e-6
    assert shape.area > 0.6 * polygon_of_mask(mask, grid).area


def test_a_blind_spot_goes_on_across_corners() -> None:
    mask, grid = np.ones((8, 8), bool), BevGrid(8, 4.0)
    mask[3:5, 3:5] = mask[5, 5] = mask[6, 6] = False
    np.testing.assert_array_equal(blind_spot(mask, grid), ~mask)
    mask[7, 7] = False  # it leads out of the grid
    assert blind_spot(mask, grid) is None


def test_a_star_ring_leaves_out_the_blind_spot_and_what_lies_behind_a_wall() -> None:
    grid = BevGrid(64, 32.0)
    mask = np.ones(grid.shape, np.bool_)
    mask[30:34, 30:34] = False  # below the sensor
    mask[40:, 32:36] = False  # a wall ahead, and nothing behind it
    ring = Polygon(star_ring(mask, grid, 720))
    assert ring.is_valid
    assert 0.75 * mask.sum() < ring.area < mask.sum()
    inside = mask_of_polygon(ring, grid)
    assert not inside[30:34, 30:34].any()
    assert not (inside & ~mask).any()
