"""What a page holds of a sweep, read back by a reader of the tests' own."""

import zlib
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from viewshed import BevGrid, CellState, FovEstimate, Sweep
from viewshed.monitor import IntegrityReport
from viewshed.preprocess.leveling import level
from viewshed.show.view import Frame, PackedFrame, pack_frame
from viewshed.show.view.frames import MAX_POINTS, POINT_CELLS, shown_points_cm

GRID = BevGrid(8, 8.0, (1.0, -2.0))


def _nothing() -> FovEstimate:
    """An estimate that knows nothing."""
    return FovEstimate(GRID, np.zeros(GRID.shape, np.float32), np.zeros(GRID.shape, np.uint8))


def _report(grid: BevGrid, suspect: NDArray[np.bool_]) -> IntegrityReport:
    return IntegrityReport("by hand", 0.25, 1.0, grid=grid, suspect_cells=suspect)


def _sweep(points: NDArray[np.float64]) -> Sweep:
    """A sweep whose sensor stands level and 2 m above the ground."""
    return Sweep(points.astype(np.float32), sensor_height_m=2.0, attitude=np.array([1.0, 0.0, 0.0, 0.0]))


class Unpacked(NamedTuple):
    """What a reader of the layout in ``viewshed.show.view.frames`` finds, point by point and bit by bit."""

    state: NDArray[np.uint8]
    is_visible: NDArray[np.bool_]
    is_suspect: NDArray[np.bool_]
    prob: NDArray[np.float64]
    deviation: NDArray[np.float64] | None
    points_m: NDArray[np.float64]


def unpack(frame: PackedFrame) -> Unpacked:
    content = zlib.decompress(frame.data, wbits=-15)
    side = frame.about["grid"]["cells"]
    cells, rest = np.frombuffer(content[: side**2], np.uint8).reshape(side, side), content[side**2 :]
    deviation = None
    if frame.about["deviation_top"] is not None:
        bytes_, rest = np.frombuffer(rest[: side**2], np.uint8).reshape(side, side), rest[side**2 :]
        deviation = np.where(bytes_ == 255, np.nan, bytes_ / 31 * frame.about["deviation_top"])
    count = frame.about["points"]
    assert len(rest) == 6 * count
    points, last = [], [0, 0, 0]
    for k in range(count):
        low_high = [(rest[2 * column * count + k], rest[(2 * column + 1) * count + k]) for column in range(3)]
        words = [int.from_bytes(pair, "little") for pair in low_high]
        sums = [words[0] + last[0], words[1] + last[1], words[2]]
        last = [(word + 2**15) % 2**16 - 2**15 for word in sums]
        points.append(last)
    return Unpacked(
        state=cells & np.uint8(3),
        is_visible=(cells >> 2 & 1).astype(bool),
        is_suspect=(cells >> 3 & 1).astype(bool),
        prob=((cells >> 4) + 0.5) / 16,
        deviation=deviation,
        points_m=np.array(points, np.float64).reshape(-1, 3) / 100,
    )


@given(st.data())
def test_any_estimate_comes_back(data: st.DataObject) -> None:
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    side = data.draw(st.integers(1, 6))
    grid = BevGrid(side, data.draw(st.floats(0.5, 400.0)))
    std = rng.random(grid.shape).astype(np.float32) * data.draw(st.floats(0.0, 3.0))
    std[rng.random(grid.shape) < 0.3] = np.nan
    prob = rng.choice([0.0, 0.5, 1.0, rng.random()], grid.shape).astype(np.float32)
    state = rng.integers(0, 4, grid.shape, np.uint8)
    threshold, t_ns = data.draw(st.sampled_from([0.5, 0.37, 1.0])), data.draw(st.integers(0, 2**62))
    estimate = FovEstimate(grid, prob, state, std=std, threshold=threshold, t_ns=t_ns)
    suspect = rng.random(grid.shape) < 0.5
    count = data.draw(st.integers(0, 20))
    leveled = level(_sweep(rng.uniform(-500, 500, (count, 3))), grid)
    frame = pack_frame(Frame("a", estimate, leveled, _report(grid, suspect)))
    back = unpack(frame)
    assert frame.about["visible_m2"] == pytest.approx(estimate.area_m2(), abs=0.01)
    assert frame.about["shares"][CellState.HIDDEN] == pytest.approx(estimate.share(CellState.HIDDEN), abs=1e-4)
    assert frame.about["t_ns"] == str(estimate.t_ns)
    assert (back.state == estimate.state).all()
    assert (back.is_visible == estimate.visible()).all()
    assert (back.is_suspect == suspect).all()
    assert np.abs(back.prob - prob).max() <= 1 / 32
    if back.deviation is None:
        assert np.isnan(std).all()
    else:
        assert (np.isnan(back.deviation) == np.isnan(std)).all()
        assert np.nanmax(np.abs(back.deviation - std), initial=0.0) <= max(np.nanmax(std), 1e-3) / 62 + 1e-6
    assert (np.abs(back.points_m[:, :2]) <= min(grid.half_extent_m, 327.67) + 0.01).all()
    # Each point is one of the sweep's, to a centimeter.
    measured = np.column_stack([leveled.points[:, :2], leveled.height_m]).astype(np.float64)
    assert all(np.abs(measured - point).max(axis=1).min() <= 0.0051 for point in back.points_m)


def test_the_highest_point_of_a_place_is_kept() -> None:
    estimate = _nothing()
    cell_m = 2 * GRID.half_extent_m / POINT_CELLS
    points = np.array([[5.001, 1.001, -1.9], [5.002, 1.002, -0.5], [5.003, 1.003, -1.0], [5 + 2 * cell_m, 1.0, -1.5]])
    leveled = level(_sweep(points), GRID)
    back = unpack(pack_frame(Frame("a", estimate, leveled)))
    assert sorted(back.points_m[:, 0].tolist()) == [5.0, 5.03]
    assert back.points_m[:, 2].max() == pytest.approx(leveled.height_m.max(), abs=0.0051)


def test_points_are_never_more_than_the_most() -> None:
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-8, 8, (60_000, 2)), rng.uniform(-2, 0, 60_000)])
    shown_cm = shown_points_cm(level(_sweep(points), BevGrid(64, 8.0)), BevGrid(64, 8.0))
    assert shown_cm.shape == (MAX_POINTS, 3)
    # Fair over the place: as many in each quarter, within chance.
    quarters = np.bincount((shown_cm[:, 0] > 0) * 2 + (shown_cm[:, 1] > 0))
    assert (np.abs(quarters - MAX_POINTS / 4) < 0.1 * MAX_POINTS).all()


def test_what_a_monitor_says_is_told() -> None:
    sectors = np.zeros(72, np.bool_)
    sectors[[3, 71]] = True
    report = IntegrityReport(
        "by hand", 1.25, 1.0, degraded=True, suspect=sectors, reasons=("a wall is missing", "rain"), notes=("no rings",)
    )
    about = pack_frame(Frame("a", _nothing(), None, report)).about
    assert (about["score"], about["limit"]) == (1.25, 1.0)
    assert about["sectors"] == [72, 3, 71]
    verdict = "inconsistent and degraded"
    assert about["alarms"] == [
        {"verdict": verdict, "reason": "a wall is missing"}, {"verdict": verdict, "reason": "rain"}
    ]  # fmt: skip
    assert about["notes"] == ["no rings"]


def test_a_report_must_be_on_the_grid() -> None:
    with pytest.raises(ValueError, match="report must be on the grid of the estimate"):
        Frame("a", _nothing(), None, _report(BevGrid(3, 8.0), np.zeros((3, 3), np.bool_)))
