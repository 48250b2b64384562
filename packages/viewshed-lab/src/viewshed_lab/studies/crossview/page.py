"""The page of cross-view truth: over- and under-claim by sensor, also under attack, and the error of the metric."""

from __future__ import annotations

import contextlib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import isnan
from pathlib import Path

import numpy as np

from viewshed.fov.estimate import FovEstimator
from viewshed.io import read_index, read_indexed
from viewshed.sensors import lidar_model
from viewshed.sweep import Sweep
from viewshed_lab._page import facts
from viewshed_lab.studies.crossview.faults import BLOB_M, SmallestDifference, with_known_faults
from viewshed_lab.studies.crossview.rates import (
    STATIC_S,
    TOGETHER_S,
    ColumnRate,
    CrossViewRow,
    CrossViewTruth,
    OnStep,
    crossview_truth,
    rows_of,
)
from viewshed_lab.studies.crossview.simulated import evaluate_floor
from viewshed_lab.studies.formatting import format_number, lines
from viewshed_lab.studies.pages import Table, fill_template
from viewshed_lab.studies.plan import check_names, check_seed
from viewshed_lab.threats.attacks import ATTACKS, Knowledge

POINTS = 150
"""Number of points of an attacker."""


@dataclass(frozen=True, slots=True, eq=False)
class SensorScenes:
    """The scenes of one sensor, and the cross-view truth of its sweeps."""

    name: str  # of the sensor
    scenes: list[list[Sweep]]  # sweeps of each
    truth: CrossViewTruth
    difference: SmallestDifference | None  # that its columns can show; None if the metric's own error is unknown

    @property
    def title(self) -> str:
        """Name of the sensor with the numbers of scenes and sweeps."""
        return f"{self.name}, {len(self.scenes)} scene(s), {sum(map(len, self.scenes))} sweeps"

    @property
    def seen(self) -> str | None:
        """Sentence on the smallest differences that the columns would show; None if that was not measured."""
        if self.difference is None:
            return None
        least = self.difference
        over, under = (
            f"no {kind} at all" if isnan(share) else f"{kind} of {share:g} or more of the {ground} ground"
            for kind, share, ground in (("over-claim", least.over, "hidden"), ("under-claim", least.under, "visible"))
        )
        columns = f"({least.hidden_columns} columns of {least.hidden_sweeps} sweeps)"
        return f"Smallest differences that these columns would show: {over} {columns}; {under}."


def page_of(
    index: Path,
    estimators: Mapping[str, FovEstimator],
    attacks: Sequence[str],
    seed: int,
    on_step: OnStep,
    *,
    floor: bool = True,
) -> str:
    """Return the page of an index of posed sweeps as Markdown; each folder of the index is one scene.

    Estimators are also evaluated under ``attacks`` (names in ``ATTACKS``). With ``floor``, the metric's own error is
    measured in a simulation. ``seed`` is that of the bootstrap.
    """
    check_names("attacks", attacks, ATTACKS)
    check_seed("seed", seed)
    by_sensor, floor_rows = posed_scenes(index), list[CrossViewRow]()
    if floor:
        few = {one: estimators[one] for one in estimators if one in ("shadow_map", "majority_vote", "first_blocker")}
        on_step("floor")
        floor_rows = evaluate_floor(few, rng=np.random.default_rng(seed))
    sensors = [_sensor_scenes(sensor, scenes, floor_rows, seed, on_step) for sensor, scenes in by_sensor.items()]

    def rates(sensor: SensorScenes, rated: Mapping[str, FovEstimator]) -> Table:
        return _table(rows_of(sensor.truth, rated, rng=np.random.default_rng(seed), on_step=on_step))

    page = fill_template(
        "crossview/page.md", sensors=sensors, attacked=sensors if attacks else (), points=POINTS, blob_m=BLOB_M,
        floor=_table(floor_rows) if floor else None, estimators=estimators, rates=rates,
        faulty=_with_known_faults(estimators) if floor else None,
        attacked_rates=lambda sensor: _under_attack(sensor.truth, estimators, attacks, seed, on_step),
    )  # fmt: skip
    about = facts(seed=str(seed), grid="road (256 cells of 0.5 m)", target="car")
    return page.markdown(about)


def _sensor_scenes(
    sensor: str, scenes: list[list[Sweep]], floor: Sequence[CrossViewRow], seed: int, on_step: OnStep
) -> SensorScenes:
    """Return the scenes of a sensor with their truth; the first row of ``floor`` has the rates of the exact mask."""
    truth, difference = crossview_truth(scenes, on_step), None
    if floor:
        error = floor[0].over.high, floor[0].under.high
        difference = SmallestDifference.of(truth, error, np.random.default_rng(seed))
    return SensorScenes(sensor, scenes, truth, difference)


def _with_known_faults(estimators: Mapping[str, FovEstimator]) -> dict[str, FovEstimator]:
    """Return the shadow map, or without it the first estimator, bare and with each known fault."""
    name = "shadow_map" if "shadow_map" in estimators else next(iter(estimators))
    return with_known_faults(name, estimators[name])


def posed_scenes(index: Path) -> dict[str, list[list[Sweep]]]:
    """Return the sweeps by sensor and scene.

    A scene is a folder of the index with at least three posed sweeps over 0.7 s, or with several sensors at one time.
    """
    folders = defaultdict(list)
    for entry in read_index(index):
        if entry.world_from_sensor is not None and entry.t is not None:
            folders[entry.file.parent].append(entry)
    scenes: dict[str, list[list[Sweep]]] = defaultdict(list)
    for entries in folders.values():
        times, sensors = [entry.t or 0.0 for entry in entries], dict.fromkeys(entry.sensor for entry in entries)
        span_s = max(times) - min(times)
        together = len(sensors) > 1 and span_s <= TOGETHER_S
        if together or (len(entries) >= 3 and span_s >= STATIC_S):
            sweeps = [_with_beams(read_indexed(entry), entry.sensor) for entry in entries]
            scenes[" + ".join(sensors) if together else entries[0].sensor].append(sweeps)
    if not scenes:
        raise ValueError(
            f"{index} must have a folder of at least three posed sweeps over 0.7 s, or of several sensors at one time, "
            "got none"
        )
    return dict(scenes)


def _with_beams(sweep: Sweep, name: str) -> Sweep:
    """Return the sweep with a beam table: its own, else that named by the index, if it is known."""
    with contextlib.suppress(ValueError):
        return sweep if sweep.model is not None else sweep.replace(model=lidar_model(name.removeprefix("Velodyne ")))
    return sweep


def _under_attack(
    truth: CrossViewTruth, estimators: Mapping[str, FovEstimator], attacks: Sequence[str], seed: int, on_step: OnStep
) -> Table:
    """Return the table of over- and under-claim without and with each attack, by estimator."""
    by_method: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for name in ("", *attacks):
        rng = np.random.default_rng(seed)
        for row in rows_of(truth, estimators, rng=rng, on_step=on_step, shown=partial(_attacked, name, rng)):
            by_method[row.method].append((row.over.value, row.under.value))
    rows = []
    for method, rates in by_method.items():
        growth = [more for more in (np.array(rates) - rates[0]).ravel().tolist() if not isnan(more)]
        cells = [" / ".join(format_number(rate, 3) for rate in pair) for pair in rates]
        rows.append([method, *cells, f"{max(growth):+.3f}" if growth else "–"])
    return Table(["estimator", "untouched", *attacks, "grows by"], rows)


def _attacked(name: str, rng: np.random.Generator, sweep: Sweep) -> Sweep:
    """Return a sweep under an attack; unchanged if the attack is impossible on it."""
    if name:
        with contextlib.suppress(ValueError):
            return ATTACKS[name](POINTS, Knowledge(half_extent_m=64.0)).apply(sweep, rng).sweep
    return sweep


def _table(rows: Sequence[CrossViewRow]) -> Table:
    def rate(one: ColumnRate) -> str:
        return f"{one.value:.3f} [{one.low:.3f}, {one.high:.3f}] of {one.columns}" if one.columns else "no columns"

    return lines("estimator", {row.method: row for row in rows}, {
        "over": lambda row: rate(row.over),
        "under": lambda row: rate(row.under),
        "over, nothing dropped": lambda row: rate(row.over_unfiltered),
        "dropped": lambda row: f"{row.dropped_share:.2f}",
    })  # fmt: skip
