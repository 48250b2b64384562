"""Statistics of sweeps whose answer is known by construction, and the agreement of hand-made sets."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from realism import HEIGHT_EDGES_M, RANGE_EDGES_M, SweepStatistics, agreement, range_noise, road_seen, sweep_statistics

from viewshed.grid import BevGrid
from viewshed.io import read_sweep
from viewshed.sensors import lidar_model
from viewshed.sweep import Sweep

GRID = BevGrid(256, 64.0)
MODEL = replace(lidar_model("vlp16"), azimuth_columns=720)


def yard() -> Sweep:
    """Flat ground out to 30 m, 1.5 m below a VLP-16, and a wall from 2 to 4 m height 20 m to the left, on one side."""
    azimuth = np.deg2rad(np.arange(720) / 2 - 180 + 0.25)
    points, rings = [], []
    for ring, elevation in enumerate(MODEL.elevation):
        if elevation < 0 and 1.5 / np.tan(-elevation) < 30:
            flat = np.full(720, 1.5 / np.tan(-elevation))
            points.append(np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.full(720, -1.5)]))
            rings.append(np.full(720, ring))
    ahead = azimuth[(azimuth > 1.2) & (azimuth < 1.9)]
    flat = 20.0 / np.sin(ahead)
    points.append(np.column_stack([flat * np.cos(ahead), np.full(len(ahead), 20.0), flat * np.tan(MODEL.elevation[9])]))
    rings.append(np.full(len(ahead), 9))
    return Sweep(
        np.concatenate(points).astype(np.float32), ring=np.concatenate(rings).astype(np.int16), model=MODEL,
        attitude=np.array([1.0, 0.0, 0.0, 0.0]), sensor_height_m=1.5,
    )  # fmt: skip


def statistics(returns: float = 0.5, ranges: tuple[float, ...] = (0.5, 0.5)) -> SweepStatistics:
    flat = np.array(ranges)
    return SweepStatistics(flat, flat, flat, np.array([100.0]), np.array([returns]))


def test_statistics_of_a_yard() -> None:
    sweep = yard()
    found = sweep_statistics(sweep, GRID)
    x, y, z = sweep.points.T
    away = ~((np.abs(x) < 2.7) & (np.abs(y) < 1.1))  # the box of the vehicle below the sensor
    assert found.rings[7] == 0
    assert found.rings[3] == 1.0
    assert found.rings[9] == pytest.approx(80 / 720, abs=0.003)  # 0.7 rad of 2π
    assert found.returns[0] == pytest.approx(np.sum(away) / (720 * 16))
    counts = np.histogram(np.hypot(x, y)[away], RANGE_EDGES_M)[0]
    assert found.ranges == pytest.approx(counts / np.sum(away), abs=1e-6)
    wall = np.sum(z > -1) / np.sum(away)
    assert found.heights[1] == pytest.approx(1 - wall, abs=1e-6)
    assert found.heights[4] == pytest.approx(wall, abs=1e-6)
    cells = {tuple(cell) for cell in np.floor(sweep.points[away, :2] / 0.5).astype(int)}
    assert found.occupied[0] == pytest.approx(len(cells), abs=2)


def test_bins_hold_every_return() -> None:
    found = sweep_statistics(yard(), GRID)
    assert (len(found.ranges), len(found.heights)) == (len(RANGE_EDGES_M) - 1, len(HEIGHT_EDGES_M) - 1)
    assert found.ranges.sum() == pytest.approx(1)
    assert found.heights.sum() == pytest.approx(1)


def test_noise_of_ranges_is_found_on_smooth_surfaces() -> None:
    sweep = yard()
    along = 1 + np.random.default_rng(4).normal(0, 0.012, len(sweep)) / np.linalg.norm(sweep.points, axis=1)
    noisy = sweep.replace(points=(sweep.points * along[:, None]).astype(np.float32))
    assert range_noise(noisy) == pytest.approx(0.012, rel=0.05)
    assert range_noise(sweep) < 0.002
    assert np.isnan(range_noise(sweep.select(np.zeros(len(sweep), bool))))


def test_road_is_seen_where_its_beams_return() -> None:
    """Rings meet the ground at 5.6 (-15°), 6.5 (-13°), 7.7 (-11°), 9.5 (-9°), 12.2 (-7°), 17.1 (-5°), 28.6 and 86 m."""
    sweep = yard()
    assert sweep.ring is not None
    gone = (sweep.ring == 4) & (np.arange(len(sweep)) % 2 == 0)
    found = road_seen([sweep.select(~gone)], MODEL, 1.5)
    assert found[:7] == pytest.approx([1, 1, 1, 0.5, np.nan, 1, np.nan], abs=0.01, nan_ok=True)
    assert found[7:9] == pytest.approx([1, np.nan], abs=0.01, nan_ok=True)


def test_an_empty_sweep_has_zeros() -> None:
    found = sweep_statistics(Sweep(np.zeros((0, 3), np.float32), model=MODEL), GRID)
    assert [float(getattr(found, name).sum()) for name in ("rings", "ranges", "heights", "occupied", "returns")] == [
        0.0, 0.0, 0.0, 0.0, 0.0,
    ]  # fmt: skip


def test_agreement_of_numbers_is_to_lie_among_the_real_ones() -> None:
    real = [statistics(0.4), statistics(0.5), statistics(0.9)]
    inside, outside = (agreement("returns", real, [statistics(value)]) for value in (0.7, 0.3))
    assert inside.within
    assert not outside.within
    assert (inside.low[0], inside.high[0]) == (0.4, 0.9)
    assert inside.distance == pytest.approx(0.1)
    assert inside.spread == pytest.approx(0.45)  # 0.9 from the mean of 0.4 and 0.5


def test_agreement_of_histograms_is_their_total_variation() -> None:
    real = [statistics(ranges=(0.5, 0.5)), statistics(ranges=(0.6, 0.4))]
    near = agreement("ranges", real, [statistics(ranges=(0.52, 0.48)), statistics(ranges=(0.54, 0.46))])
    far = agreement("ranges", real, [statistics(ranges=(0.9, 0.1))])
    assert near.distance == pytest.approx(0.02)
    assert far.distance == pytest.approx(0.35)
    assert near.spread == pytest.approx(0.1)
    assert (near.within, far.within) == (True, False)
    assert (near.inside_share, far.inside_share) == (1.0, 0.0)
    assert agreement("rings", real, [statistics(ranges=(0.9, 0.1))]).distance == pytest.approx(0.35)


def test_agreement_needs_both_sides() -> None:
    with pytest.raises(ValueError, match="needs sweeps on both sides, got 0 real and 1 simulated"):
        agreement("rings", [], [statistics()])


def test_a_real_sweep_has_the_rings_that_its_range_image_shows(real_data: Path) -> None:
    """Looked at by eye: the vehicle hides the lowest rings of nuScenes; rings from -19° to -12° are complete."""
    name = "n015-2018-07-24-11-22-45+0800__LIDAR_TOP__1532402927647951.pcd.bin"
    found = sweep_statistics(read_sweep(real_data / "nuscenes" / name, sensor="hdl32e"), GRID)
    assert found.rings[0] < 0.4
    assert found.rings[9:14].min() > 0.9
