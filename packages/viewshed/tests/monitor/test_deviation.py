"""The detector on deviations that are known by hand, and its promise about false alarms on random ones."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.monitor.by_hand import GRID, estimate_of

from viewshed import BevGrid
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.grid import polar_of_cells
from viewshed.monitor import DeviationMonitor, Rule, load_monitor, save_monitor


def check_refusals(path: Path, load: Callable[[Path], object], step: int, flips: int) -> float:
    """Cut a file of a monitor and change its bytes; return the share that is refused, each in one line."""
    whole, rng, told = path.read_bytes(), np.random.default_rng(0), list[str]()
    damaged = [whole[:k] for k in range(0, len(whole), step)] + [b"", b"monitor"]
    places = rng.integers(0, len(whole), flips)
    damaged += [whole[:k] + bytes([whole[k] ^ int(rng.integers(1, 256))]) + whole[k + 1 :] for k in places]
    for content in damaged:
        path.write_bytes(content)
        try:
            load(path)
        except ValueError as error:
            told.append(str(error))
    assert all(line.startswith(f"{path} must be a whole monitor file") and "\n" not in line for line in told)
    return len(told) / len(damaged)


def _benign(count: int, seed: int) -> list[FovEstimate]:
    """Deviations that grow with x alone, so that a transposed map would show."""
    rng = np.random.default_rng(seed)
    level = np.linspace(0.05, 0.3, 8)[:, None]
    return [estimate_of(np.clip(level + rng.normal(0, 0.02, GRID.shape), 0, 0.5)) for _ in range(count)]


def _monitor() -> DeviationMonitor:
    return DeviationMonitor.fit(_benign(50, 0)).calibrated(_benign(39, 1), 0.05)


@pytest.mark.parametrize("count", [12, 40])
@pytest.mark.parametrize("rule", [Rule(), Rule(sigmas=5, rings=1), Rule(few=13, rings=3), Rule(least=0.3)], ids=str)
def test_thresholds_are_those_of_each_cell_and_where_its_sweeps_are_few_of_its_range_ring(
    rule: Rule, count: int
) -> None:
    rng = np.random.default_rng(count)
    stack = np.stack([np.asarray(each.std, np.float64) for each in _benign(count, 3)])
    seen = rng.integers(0, count + 1, GRID.shape)  # in how many sweeps a cell has a deviation
    seen[2, 3], seen[5, 6] = 0, min(rule.few, count)
    stack[np.arange(count)[:, None, None] >= seen] = np.nan
    found = DeviationMonitor.fit((estimate_of(std) for std in stack), rule)
    assert np.array_equal(found.watched, seen > 0)
    range_m, _ = polar_of_cells(GRID)
    ring = np.minimum(range_m * rule.rings // (range_m.max() + 1e-6), rule.rings - 1)
    for i, j in np.argwhere(seen > 0).tolist():
        values = stack[:, i, j] if seen[i, j] >= rule.few else stack[:, ring == ring[i, j]]
        values = values[np.isfinite(values)]
        spread = values.std(ddof=1) if len(values) > 1 else 0.0
        expected = max(values.mean() + rule.sigmas * spread, rule.least)
        assert found.thresholds[i, j] == pytest.approx(expected, abs=1e-6)


def test_score_is_the_share_of_watched_cells_that_are_suspect() -> None:
    right = np.full(GRID.shape, 0.1)
    right[:, :4] = np.nan
    monitor = DeviationMonitor.fit([estimate_of(right)] * 30)
    assert monitor.watched.tolist() == np.isfinite(right).tolist()
    std = np.full(GRID.shape, 0.1)
    std[2, 5], std[3, 6], std[3, 1] = 0.2, 0.11, 0.5
    assert np.argwhere(monitor.suspect(estimate_of(std))).tolist() == [[2, 5], [3, 6]]
    assert monitor.score(estimate_of(std)) == 2 / 32


def test_cells_do_not_leave_the_watch_by_turning_unknown() -> None:
    monitor = _monitor()
    unknown = np.full(GRID.shape, CellState.UNKNOWN, np.uint8)
    assert monitor.score(estimate_of(0.5, unknown)) == monitor.score(estimate_of(0.5)) == 1.0


def test_alarms_on_new_benign_sweeps_keep_to_the_rate_and_a_doubtful_corner_is_found() -> None:
    keen = DeviationMonitor.fit(_benign(60, 0), Rule(sigmas=1)).calibrated(_benign(199, 1), 0.1)
    assert 0.03 <= np.mean([keen.check(each).alarm for each in _benign(400, 2)]) <= 0.15
    monitor = DeviationMonitor.fit(_benign(60, 0)).calibrated(_benign(199, 1), 0.1)
    std = np.array(_benign(1, 9)[0].std)
    std[6:, :3] = 0.45
    report = monitor.check(estimate_of(std))
    assert report.alarm
    assert report.suspect_cells[6:, :3].all()
    assert report.suspect_cells.sum() <= 8
    assert (report.monitor, report.threshold, monitor.sweeps) == ("deviation", monitor.limit, (60, 199))
    assert report.suspect_m2 == report.suspect_cells.sum() * 4.0


def test_what_the_monitor_cannot_check_is_told() -> None:
    monitor = _monitor()
    with pytest.raises(ValueError, match=r"monitor's grid 8x8 at \(1, 0\), got 16x8"):
        monitor.check(estimate_of(0.1, grid=BevGrid(16, 8.0)))
    with pytest.raises(ValueError, match="must be of the monitor's method by_hand, got other; fit one for it"):
        monitor.check(estimate_of(0.1, method="other"))
    with pytest.raises(ValueError, match="must have a standard deviation, got none from by_hand; use Monte Carlo"):
        monitor.check(estimate_of(np.nan))
    with pytest.raises(ValueError, match="needs benign estimates, got none"):
        DeviationMonitor.fit([])
    with pytest.raises(ValueError, match="no benign sweep has a deviation"):
        DeviationMonitor(GRID, np.full(GRID.shape, np.inf, np.float32), "by_hand")
    with pytest.raises(ValueError, match=r"rate of 0\.01 needs at least 99 benign sweeps, got 30"):
        monitor.calibrated(_benign(30, 2), 0.01)
    with pytest.raises(ValueError, match="must be calibrated before it can alarm"):
        DeviationMonitor.fit(_benign(3, 0)).check(estimate_of(0.1))


@pytest.mark.parametrize(
    ("change", "match"),
    [({"sigmas": -1}, "sigmas"), ({"least": 0.6}, "least"), ({"few": 1}, "few"), ({"rings": 0}, "rings")],
)
def test_rules_are_checked(change: dict[str, float], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        Rule(**change)  # type: ignore[arg-type]


def test_a_file_gives_the_same_monitor_back_and_the_same_bytes(tmp_path: Path) -> None:
    monitor = replace(_monitor(), facts={"network": "a b"})
    save_monitor(monitor, tmp_path / "a.npz")
    save_monitor(load_monitor(tmp_path / "a.npz"), tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    again = load_monitor(tmp_path / "a.npz")
    assert np.array_equal(again.thresholds, monitor.thresholds)
    assert (again.grid, again.method, again.limit) == (monitor.grid, monitor.method, monitor.limit)
    assert (again.false_alarm_rate, again.sweeps, again.facts) == (0.05, (50, 39), {"network": "a b"})
    uncalibrated = DeviationMonitor.fit(_benign(3, 0))
    save_monitor(uncalibrated, tmp_path / "c.npz")
    assert load_monitor(tmp_path / "c.npz").limit is None


def test_every_damaged_file_is_refused_in_one_line(tmp_path: Path) -> None:
    monitor, path = _monitor(), tmp_path / "monitor.npz"
    save_monitor(monitor, path)

    def load(place: Path) -> None:
        assert np.array_equal(load_monitor(place).thresholds, monitor.thresholds)

    assert check_refusals(path, load, 29, 300) > 0.7, "a date or a flag that nobody reads is no damage"


def test_another_version_and_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("viewshed.monitor.deviation.FORMAT_VERSION", 2)
    save_monitor(_monitor(), tmp_path / "new.npz")
    monkeypatch.undo()
    with pytest.raises(ValueError, match=r"a monitor of format 2 \(this version reads 1\); make it again: .* fit "):
        load_monitor(tmp_path / "new.npz")
    np.savez(tmp_path / "other.npz", thresholds=np.zeros(3))
    with pytest.raises(ValueError, match="got: no monitor; make it again"):
        load_monitor(tmp_path / "other.npz")
    with pytest.raises(FileNotFoundError):
        load_monitor(tmp_path / "none.npz")
