"""The page of the study of tracks: forged objects found by field of view, GOSPA, and targets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from viewshed.monitor.roc import auroc
from viewshed_lab._page import facts
from viewshed_lab.studies.formatting import by_name, commits, format_interval, format_number, format_rate, pivot
from viewshed_lab.studies.pages import Table, fill_template
from viewshed_lab.studies.plan import JobKey
from viewshed_lab.studies.statistics import NO_INTERVAL
from viewshed_lab.studies.store import ResultStore
from viewshed_lab.studies.tracks.evaluate import RANGE_M, SURE, WITHIN_S
from viewshed_lab.studies.tracks.jobs import STONE_SOUP
from viewshed_lab.studies.tracks.plan import BENIGN_CASE, TracksPlan
from viewshed_lab.studies.tracks.stone_soup import CONFIRM_UPDATES

NAMES = {
    "none": "none", "published": "published tracker", "polygon": "published polygon, our tracker",
    "default": "default, probability",
}  # fmt: skip
"""Labels of the fields of view in the tables."""

MAIN = "default"
"""The field of view of the targets."""

FAMILIES = {"fabricate": "ghosts", "remove": "removed", "translate": "moved", "shift": "moved"}
"""Kinds of forged objects by family of attacks."""

_DRAWS, _SEED = 2000, 35
"""Number of bootstrap samples of worlds for an interval, and their seed."""

Outcomes = Sequence[Mapping[str, Any]]


@dataclass(frozen=True, eq=False)
class TracksResults:
    """Test drives of a study."""

    plan: TracksPlan  # of the study
    drives: Mapping[JobKey, Mapping[str, Any]]  # by job: outcomes of the drive by field of view and case
    sweeps: Mapping[JobKey, Mapping[str, Any]]  # the same for drives with attacked sweeps

    def outcomes(self, fov: str, case: str = BENIGN_CASE) -> Outcomes:
        """Return the outcomes of all drives in a case, for drives with this field of view."""
        return [one[fov][case] for one in self.drives.values() if fov in one]

    def family(self, family: str) -> Outcomes:
        """Return the outcomes of all drives under all attacks of a family, with the main field of view."""
        names = [name for name in self.plan.attacks if name.startswith(family)]
        return [one for name in names for one in self.outcomes(MAIN, name)]

    def target_table(self) -> Table:
        """Return the table of targets and reached figures; ratios of GOSPA have 95 % intervals over worlds."""
        rows = []
        for (what, sign, target), value in zip(TARGETS, self._reached(), strict=True):
            figure, bounds = (value[0], value[1:]) if isinstance(value, tuple) else (value, None)
            met = figure <= target + 1e-9 if sign == "≤" else figure >= target - 1e-9
            reached = format_rate(figure) if bounds is None else format_interval(figure, bounds)
            rows.append((what, f"{sign} {format_rate(target, 2)}", reached, "–" if np.isnan(figure) else _MET[met]))
        return Table(("what", "target", "reached", ""), rows)

    def _reached(self) -> list[float | tuple[float, float, float]]:
        """Return the figures of ``TARGETS``; NaN without results."""
        ours = np.array([one["gospa_m"][0] for one in self.outcomes(MAIN)])
        worlds, ratios = [key[3] for key in self.drives], []
        for fov in ("published", "polygon", "none"):
            theirs = np.array([one["gospa_m"][0] for one in self.outcomes(fov)])
            ratios.append(_ratio_of_drives(ours, theirs, worlds))
        attacked = [one for family in ("fabricate", "remove", "translate") for one in self.family(family)]
        benign, removed = self.outcomes(MAIN), _forged(self.family("remove"), "removed")
        dropped = [_share(self.outcomes(fov), "occluded") for fov in (MAIN, "published")]
        lidar = [one for attack in self.plan.lidar_attacks for one in self._lidar(attack, MAIN)]
        return [
            _ratio_of_drives(ours, self._stone_soup(), worlds), *ratios,
            dropped[0] / dropped[1] if dropped[1] > 0.0 else np.nan,
            _ratio(attacked),
            _share(benign, "honest"),
            _found(_forged(self.family("fabricate"), "ghosts"), WITHIN_S),
            _found(_forged(lidar, "ghosts")),
            _found(removed, WITHIN_S), _found(removed),
            _found(_forged(self.family("translate"), "moved")),
            _found(_forged(self.family("shift"), "moved")),
            _ece(benign), _ece(attacked),
        ]  # fmt: skip

    def _stone_soup(self) -> NDArray[np.float64]:
        """Return the GOSPA (D,) of Stone Soup on each drive in meters."""
        return np.array([one[STONE_SOUP] for one in self.drives.values()])

    def benign_table(self) -> Table:
        """Return the table of benign drives by field of view: GOSPA, accused tracks, calibration, dropped tracks."""
        rows = [("Stone Soup, none", format_number(float(self._stone_soup().mean()), 2), "–", "–", "–")]
        for fov in self.plan.fovs:
            outcomes = self.outcomes(fov)
            honest = np.sum([one["honest"] for one in outcomes], axis=0)
            lost, hidden = np.sum([one["occluded"] for one in outcomes], axis=0)
            rows.append((
                NAMES[fov], _both_gospa(outcomes), f"{format_rate(_share(outcomes, 'honest'))} of {honest[1]}",
                format_rate(_ece(outcomes)), f"{lost} of {hidden}",
            ))  # fmt: skip
        return Table(("field of view", "GOSPA, m", "accused", "ECE", "dropped while occluded"), rows)

    def found_table(self) -> Table:
        """Return the table of the shares of found objects by attack and field of view."""
        return pivot("attack", by_name(self.plan.attacks), {NAMES[fov]: fov for fov in self.plan.fovs},
                     lambda name, fov: _shares(self.outcomes(fov, name)))  # fmt: skip

    def missed_table(self) -> Table:
        """Return the table of found removed objects, by whether they were tracked before and visible."""
        removed, rows = _forged(self.family("remove"), "removed", min_visible=0.0), []
        for known, name in ((1.0, "tracked before"), (0.0, "never, or hardly, tracked")):
            for sure, seen in ((True, f"p ≥ {format_rate(SURE, 1)}"), (False, "less visible")):
                part = removed[(removed["known"] == known) & ((removed["visible"] >= SURE) == sure)]
                shares = [format_rate(_found(part, within_s), 2) for within_s in (WITHIN_S, np.inf)]
                rows.append((name, seen, str(len(part)), *shares))
        return Table(("object", "visible", "removed", "found within 1 s", "found"), rows)

    def gospa_table(self) -> Table:
        """Return the table of GOSPA by attack and field of view."""

        def cell(name: str, fov: str) -> str:
            outcomes = self.outcomes(fov, name)
            return f"{_both_gospa(outcomes)}, {format_rate(_ratio(outcomes), 2)}"

        return pivot("attack", by_name(self.plan.attacks), {NAMES[fov]: fov for fov in self.plan.fovs}, cell)

    def auroc_table(self) -> Table:
        """Return the table of AUROC of the evidence against tracks, forged against honest, by family of attacks."""
        honest, rows = [value for one in self.outcomes(MAIN) for value in one["highest"]], []
        for family, kind in FAMILIES.items():
            forged = _forged(self.family(family), kind)["highest"]
            area = auroc(honest, forged) if honest and len(forged) else float("nan")
            rows.append((family, str(len(forged)), format_rate(area)))
        return Table(("attack", "forged objects", "AUROC"), rows)

    def lidar_table(self) -> Table:
        """Return the table of objects created or removed by attacks on the sweep: found, or why they were missed."""
        rows = []
        fovs = [fov for fov in self.plan.fovs if any(fov in one for one in self.sweeps.values())]
        for attack in self.plan.lidar_attacks:
            for fov in fovs:
                outcomes = self._lidar(attack, fov)
                kind = "ghosts" if attack.startswith("ghost") else "removed"
                forged = _forged(outcomes, kind)
                found = forged["found_s"] >= 0.0
                alarmed = ~found & (forged["alarmed"] > 0.0)
                unknown = ~found & ~alarmed & (forged["known"] == 0.0)
                counts = [len(forged), found.sum(), alarmed.sum(), unknown.sum()]
                rest = counts[0] - sum(counts[1:])
                rows.append((attack, NAMES[fov], *map(str, (*counts, rest)), _both_gospa(outcomes)))
        header = ("attack", "field of view", "objects", "accused", "only under alarm", "never tracked", "missed",
                  "GOSPA, m")  # fmt: skip
        return Table(header, rows)

    def _lidar(self, attack: str, fov: str) -> Outcomes:
        return [one[fov][attack] for key, one in self.sweeps.items() if key[-1] == attack and fov in one]


TARGETS: tuple[tuple[str, str, float], ...] = (
    ("GOSPA benign, against Stone Soup", "≤", 0.88),
    ("GOSPA benign, against the published tracker", "≤", 0.85),
    ("GOSPA benign, against the published polygon in our tracker", "≤", 0.85),
    ("GOSPA benign, against none", "≤", 0.75),
    ("tracks dropped while occluded, against the published tracker", "≤", 0.25),
    ("GOSPA under attack, after fusion against no fusion", "≤", 0.60),
    ("honest tracks accused", "≤", 0.03),
    ("fabricated found within 1 s", "≥", 0.95),
    ("ghosts made in the sweep found", "≥", 0.85),
    ("removed found within 1 s", "≥", 0.70),
    ("removed found", "≥", 0.85),
    ("translated by ≥ 2 m found", "≥", 0.80),
    ("shifted by ≤ 1 m found", "≥", 0.40),
    ("existence, ECE benign", "≤", 0.03),
    ("existence, ECE attacked", "≤", 0.08),
)
"""Targets: description, sign and bound."""

_MET = {True: "met", False: "missed"}


def _ratio_of_drives(
    ours: NDArray[np.float64], theirs: NDArray[np.float64], worlds: Sequence[str]
) -> tuple[float, float, float]:
    """Return the ratio of the means of two trackers (D,) on the same drives, with its 95 % interval over worlds (D,).

    Worlds are resampled with all their drives; one world has no interval.
    """
    if not len(theirs):
        return np.nan, *NO_INTERVAL
    ratio, world_of = float(ours.mean() / theirs.mean()), np.unique(worlds, return_inverse=True)[1]
    sums = [np.bincount(world_of, distances_m) for distances_m in (ours, theirs)]
    count = len(sums[0])
    if count < 2:
        return ratio, *NO_INTERVAL
    sampled = np.random.default_rng(_SEED).integers(count, size=(_DRAWS, count))
    low, high = np.quantile(sums[0][sampled].sum(axis=1) / sums[1][sampled].sum(axis=1), (0.025, 0.975))
    return ratio, float(low), float(high)


def _forged(outcomes: Outcomes, kind: str, min_visible: float = SURE) -> pd.DataFrame:
    """Return a table with one row of :meth:`Forgery.row` per forged object of a kind; removed ones must be visible.

    ``found_s`` is -1 for objects that were never accused.
    """
    rows = [row for one in outcomes for row in one[kind] if kind != "removed" or row[1] >= min_visible]
    return pd.DataFrame(rows, columns=["found_s", "visible", "known", "highest", "alarmed"])


def _found(forged: pd.DataFrame, within_s: float = np.inf) -> float:
    """Return the share of forged objects that were accused in time; NaN without any."""
    return float(forged["found_s"].between(0.0, within_s + 1e-6).mean())


def _shares(outcomes: Outcomes) -> str:
    """Return the shares of found objects in a case as text: fabricated ones in time and ever, others ever."""
    words = []
    for kind in ("ghosts", "removed", "moved"):
        forged = _forged(outcomes, kind)
        if len(forged):
            within_s = (WITHIN_S, np.inf) if kind == "ghosts" else (np.inf,)
            shares = " / ".join(format_rate(_found(forged, limit_s), 2) for limit_s in within_s)
            words.append(f"{shares} of {len(forged)}")
    return ", ".join(words) or "–"


def _gospa(outcomes: Outcomes) -> tuple[float, float]:
    """Return the mean GOSPA without fusion and after it, in meters; NaN without any."""
    if not outcomes:
        return float("nan"), float("nan")
    before, after = np.mean([one["gospa_m"] for one in outcomes], axis=0)
    return float(before), float(after)


def _both_gospa(outcomes: Outcomes) -> str:
    return " / ".join(format_number(distance_m, 2) for distance_m in _gospa(outcomes))


def _ratio(outcomes: Outcomes) -> float:
    before, after = _gospa(outcomes)
    return after / before


def _share(outcomes: Outcomes, name: str) -> float:
    """Return the share of two summed counts of drives, part and whole; NaN if the whole is 0."""
    part, whole = np.sum([one[name] for one in outcomes], axis=0) if outcomes else (0, 0)
    return float(part / whole) if whole else float("nan")


def _ece(outcomes: Outcomes) -> float:
    """Return the expected calibration error of existence over ten bins, each weighted by its tracks."""
    if not outcomes:
        return float("nan")
    count, existence, is_object = np.sum([one["existence"] for one in outcomes], axis=0)
    return float(np.abs(existence - is_object).sum() / max(count.sum(), 1))


def files_of(store: ResultStore[TracksPlan]) -> dict[str, bytes]:
    """Return the page by file name.

    Raises:
        ValueError: there are no attacked drives yet.
    """
    plan, tested = store.plan, store.results("test")
    if not tested.facts:
        raise ValueError(f"{store.folder} must hold attacked drives, got none; run the study")
    results = TracksResults(plan, tested.facts, store.results("lidar").facts)
    values = {
        "seconds": f"{plan.seconds:g}", "objects": plan.objects, "accused": f"{plan.accused:.0%}",
        "range_m": f"{RANGE_M:g}", "confirm": CONFIRM_UPDATES,
    }  # fmt: skip
    page = fill_template("tracks/page.md", results=results, **values)
    about = facts(
        plan=f"{plan.name}: {plan.about}", seed=str(plan.seed), sensors=", ".join(plan.sensors),
        weather=", ".join(plan.conditions),
        drives=f"{plan.count} counted, {plan.limit} for limits, {len(tested.facts)} with forged detections,"
        f" {len(results.sweeps)} with forged sweeps", commits=commits(tested),
    )  # fmt: skip
    return page.files("tracks.md", about)
