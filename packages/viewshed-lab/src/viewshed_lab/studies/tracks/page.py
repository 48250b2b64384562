"""The page of the study: what was found with each field of view, what it cost, and what was aimed at."""

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
from viewshed_lab.studies.store import ResultStore
from viewshed_lab.studies.tracks.evaluate import RANGE_M, SURE, WITHIN_S
from viewshed_lab.studies.tracks.jobs import STONE_SOUP
from viewshed_lab.studies.tracks.plan import BENIGN_CASE, TracksPlan
from viewshed_lab.studies.tracks.stone_soup import CONFIRM_UPDATES

NAMES = {
    "none": "none", "published": "published tracker", "polygon": "published polygon, our tracker",
    "default": "default, probability",
}  # fmt: skip
"""Fields of view by name, as the tables call them."""

MAIN = "default"
"""The field of view that targets are held against."""

FAMILIES = {"fabricate": "ghosts", "remove": "removed", "translate": "moved", "shift": "moved"}
"""Families of attacks, and what they forge."""

_DRAWS, _SEED = 2000, 35
"""Times that drives are drawn anew for an interval, and the seed of these draws."""

Outcomes = Sequence[Mapping[str, Any]]


@dataclass(frozen=True, eq=False)
class TracksResults:
    """Test drives of a study."""

    plan: TracksPlan  # of the study
    drives: Mapping[JobKey, Mapping[str, Any]]  # by job what became of the drive with each field of view in each case
    sweeps: Mapping[JobKey, Mapping[str, Any]]  # the same of the drives whose sweeps were attacked

    def outcomes(self, fov: str, case: str = BENIGN_CASE) -> Outcomes:
        """Return what became of all drives in a case; nothing where the field of view was not tried."""
        return [one[fov][case] for one in self.drives.values() if fov in one]

    def family(self, family: str) -> Outcomes:
        """Return what became of all drives under all attacks of a family, with the main field of view."""
        names = [name for name in self.plan.attacks if name.startswith(family)]
        return [one for name in names for one in self.outcomes(MAIN, name)]

    def target_table(self) -> Table:
        """Return what was aimed at beside what was reached; ratios of GOSPA with 95 % intervals over drives."""
        rows = []
        for (what, sign, aim), value in zip(TARGETS, self._reached(), strict=True):
            known, bounds = (value[0], value[1:]) if isinstance(value, tuple) else (value, None)
            met = known <= aim + 1e-9 if sign == "≤" else known >= aim - 1e-9
            reached = format_rate(known) if bounds is None else format_interval(known, bounds)
            rows.append((what, f"{sign} {format_rate(aim, 2)}", reached, "–" if np.isnan(known) else _MET[met]))
        return Table(("what", "target", "reached", ""), rows)

    def _reached(self) -> list[float | tuple[float, float, float]]:
        """Return the values of ``TARGETS``; NaN where nothing was run."""
        ours = np.array([one["gospa_m"][0] for one in self.outcomes(MAIN)])
        ratios = []
        for fov in ("published", "polygon", "none"):
            theirs = np.array([one["gospa_m"][0] for one in self.outcomes(fov)])
            ratios.append(_ratio_of_drives(ours, theirs))
        attacked = [one for family in ("fabricate", "remove", "translate") for one in self.family(family)]
        quiet, removed = self.outcomes(MAIN), _forged(self.family("remove"), "removed")
        dropped = [_share(self.outcomes(fov), "occluded") for fov in (MAIN, "published")]
        lidar = [one for attack in self.plan.lidar_attacks for one in self._lidar(attack, MAIN)]
        return [
            _ratio_of_drives(ours, self._stone_soup()), *ratios,
            dropped[0] / dropped[1] if dropped[1] > 0.0 else np.nan,
            _ratio(attacked),
            _share(quiet, "honest"),
            _found(_forged(self.family("fabricate"), "ghosts"), WITHIN_S),
            _found(_forged(lidar, "ghosts")),
            _found(removed, WITHIN_S), _found(removed),
            _found(_forged(self.family("translate"), "moved")),
            _found(_forged(self.family("shift"), "moved")),
            _ece(quiet), _ece(attacked),
        ]  # fmt: skip

    def _stone_soup(self) -> NDArray[np.float64]:
        """Return the GOSPA (D,) of Stone Soup on each drive in meters."""
        return np.array([one[STONE_SOUP] for one in self.drives.values()])

    def benign_table(self) -> Table:
        """Return GOSPA, honest tracks accused, calibration and tracks dropped of benign drives by field of view."""
        rows = [("Stone Soup, none", format_number(float(self._stone_soup().mean()), 2), "–", "–", "–")]
        for fov in self.plan.fovs:
            every = self.outcomes(fov)
            honest = np.sum([one["honest"] for one in every], axis=0)
            lost, hidden = np.sum([one["occluded"] for one in every], axis=0)
            rows.append((
                NAMES[fov], _both_gospa(every), f"{format_rate(_share(every, 'honest'))} of {honest[1]}",
                format_rate(_ece(every)), f"{lost} of {hidden}",
            ))  # fmt: skip
        return Table(("field of view", "GOSPA, m", "accused", "ECE", "dropped while occluded"), rows)

    def found_table(self) -> Table:
        """Return the shares found by attack and field of view."""
        return pivot("attack", by_name(self.plan.attacks), {NAMES[fov]: fov for fov in self.plan.fovs},
                     lambda name, fov: _shares(self.outcomes(fov, name)))  # fmt: skip

    def missed_table(self) -> Table:
        """Return what became of removed objects, by whether they had been tracked and could be seen."""
        every, rows = _forged(self.family("remove"), "removed", least=0.0), []
        for known, name in ((1.0, "tracked before"), (0.0, "never, or hardly, tracked")):
            for sure, seen in ((True, f"p ≥ {format_rate(SURE, 1)}"), (False, "less visible")):
                some = every[(every["known"] == known) & ((every["visible"] >= SURE) == sure)]
                shares = [format_rate(_found(some, within_s), 2) for within_s in (WITHIN_S, np.inf)]
                rows.append((name, seen, str(len(some)), *shares))
        return Table(("object", "visible", "removed", "found within 1 s", "found"), rows)

    def gospa_table(self) -> Table:
        """Return GOSPA by attack and field of view."""

        def cell(name: str, fov: str) -> str:
            every = self.outcomes(fov, name)
            return f"{_both_gospa(every)}, {format_rate(_ratio(every), 2)}"

        return pivot("attack", by_name(self.plan.attacks), {NAMES[fov]: fov for fov in self.plan.fovs}, cell)

    def auroc_table(self) -> Table:
        """Return how well what speaks against tracks tells forged objects from honest ones, whatever the limit."""
        honest, rows = [value for one in self.outcomes(MAIN) for value in one["highest"]], []
        for family, kind in FAMILIES.items():
            forged = _forged(self.family(family), kind)["highest"]
            area = auroc(honest, forged) if honest and len(forged) else float("nan")
            rows.append((family, str(len(forged)), format_rate(area)))
        return Table(("attack", "forged objects", "AUROC"), rows)

    def lidar_table(self) -> Table:
        """Return what was found of objects that attacks on the sweep made or took, and why not."""
        rows = []
        fovs = [fov for fov in self.plan.fovs if any(fov in one for one in self.sweeps.values())]
        for attack in self.plan.lidar_attacks:
            for fov in fovs:
                every = self._lidar(attack, fov)
                kind = "ghosts" if attack.startswith("ghost") else "removed"
                forged = _forged(every, kind)
                found = forged["found_s"] >= 0.0
                alarmed = ~found & (forged["alarmed"] > 0.0)
                unknown = ~found & ~alarmed & (forged["known"] == 0.0)
                counts = [len(forged), found.sum(), alarmed.sum(), unknown.sum()]
                rest = counts[0] - sum(counts[1:])
                rows.append((attack, NAMES[fov], *map(str, (*counts, rest)), _both_gospa(every)))
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
"""What was aimed at."""

_MET = {True: "met", False: "missed"}


def _ratio_of_drives(ours: NDArray[np.float64], theirs: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return the ratio of the means of two trackers (D,) on the same drives, with its 95 % interval over drives."""
    if not len(theirs):
        return np.nan, np.nan, np.nan
    drawn = np.random.default_rng(_SEED).integers(len(ours), size=(_DRAWS, len(ours)))
    low, high = np.quantile(ours[drawn].mean(axis=1) / theirs[drawn].mean(axis=1), (0.025, 0.975))
    return float(ours.mean() / theirs.mean()), float(low), float(high)


def _forged(outcomes: Outcomes, kind: str, least: float = SURE) -> pd.DataFrame:
    """Return one row for each forged object of a kind, as :meth:`Forgery.row`; of removed ones those that were visible.

    ``found_s`` is -1 for who was never accused.
    """
    rows = [row for one in outcomes for row in one[kind] if kind != "removed" or row[1] >= least]
    return pd.DataFrame(rows, columns=["found_s", "visible", "known", "highest", "alarmed"])


def _found(forged: pd.DataFrame, within_s: float = np.inf) -> float:
    """Return the share of forged objects that were accused in time; NaN of none."""
    return float(forged["found_s"].between(0.0, within_s + 1e-6).mean())


def _shares(outcomes: Outcomes) -> str:
    """Return what was found in a case as words: of fabricated objects in time and at all, of others at all."""
    words = []
    for kind in ("ghosts", "removed", "moved"):
        forged = _forged(outcomes, kind)
        if len(forged):
            within_s = (WITHIN_S, np.inf) if kind == "ghosts" else (np.inf,)
            shares = " / ".join(format_rate(_found(forged, each), 2) for each in within_s)
            words.append(f"{shares} of {len(forged)}")
    return ", ".join(words) or "–"


def _gospa(outcomes: Outcomes) -> tuple[float, float]:
    """Return the mean GOSPA without fusion and after it, in meters; NaN of none."""
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
    """Return the share of two counts that drives have, part and whole; NaN of none."""
    part, whole = np.sum([one[name] for one in outcomes], axis=0) if outcomes else (0, 0)
    return float(part / whole) if whole else float("nan")


def _ece(outcomes: Outcomes) -> float:
    """Return the expected calibration error of existence over ten bins, each weighed by its tracks."""
    if not outcomes:
        return float("nan")
    count, existence, is_object = np.sum([one["existence"] for one in outcomes], axis=0)
    return float(np.abs(existence - is_object).sum() / max(count.sum(), 1))


def files_of(store: ResultStore[TracksPlan]) -> dict[str, bytes]:
    """Return the page as a file by its name.

    Raises:
        ValueError: no drive was attacked yet.
    """
    plan, found = store.plan, store.results("test")
    if not found.facts:
        raise ValueError(f"{store.folder} must hold attacked drives, got none; run the study")
    results = TracksResults(plan, found.facts, store.results("lidar").facts)
    values = {
        "seconds": f"{plan.seconds:g}", "objects": plan.objects, "accused": f"{plan.accused:.0%}",
        "range_m": f"{RANGE_M:g}", "confirm": CONFIRM_UPDATES,
    }  # fmt: skip
    page = fill_template("tracks/page.md", results=results, **values)
    about = facts(
        plan=f"{plan.name}: {plan.about}", seed=str(plan.seed), sensors=", ".join(plan.sensors),
        weather=", ".join(plan.conditions),
        drives=f"{plan.count} counted, {plan.limit} for limits, {len(found.facts)} with forged detections,"
        f" {len(results.sweeps)} with forged sweeps", commits=commits(found),
    )  # fmt: skip
    return page.files("tracks.md", about)
