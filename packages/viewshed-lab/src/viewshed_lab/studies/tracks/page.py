"""The page of the study: what was found with each field of view, what it cost, and what was aimed at."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from viewshed.monitor.roc import auroc
from viewshed_lab._page import facts
from viewshed_lab.studies.formatting import commits, format_number, format_rate
from viewshed_lab.studies.pages import Table, fill_template
from viewshed_lab.studies.plan import JobKey
from viewshed_lab.studies.store import ResultStore
from viewshed_lab.studies.tracks.evaluate import RANGE_M, SURE, WITHIN_S
from viewshed_lab.studies.tracks.plan import BENIGN_CASE, LIDAR_DETECTOR, TracksPlan

NAMES = {
    "none": "none", "published": "published tracker", "polygon": "published polygon, our tracker",
    "default_hard": "default, hard", "default": "default, probability", "exact": "exact",
}  # fmt: skip
"""Fields of view by name, as the tables call them."""

DETECTOR_NAMES = {"simulated": "simulated", "perception": "of the package"}

FAMILIES = {"fabricate": "ghosts", "remove": "removed", "translate": "moved", "shift": "moved"}
"""Families of attacks, and what they forge."""

Outcomes = Sequence[Mapping[str, Any]]

Place = tuple[str, str]


@dataclass(frozen=True, eq=False)
class TracksResults:
    """Test drives of a study."""

    plan: TracksPlan  # of the study
    drives: Mapping[JobKey, Mapping[str, Any]]  # by job what became of the drive with each field of view in each case
    sweeps: Mapping[JobKey, Mapping[str, Any]]  # the same of the drives whose sweeps were attacked

    def outcomes(self, detector: str, fov: str, case: str, place: Place | None = None) -> Outcomes:
        """Return what became of all drives in a case, or of those of one sensor and weather."""
        return [one[fov][case] for key, one in self.drives.items() if key[1] == detector and place in (None, key[2:4])]

    def family(self, detector: str, fov: str, family: str, place: Place | None = None) -> Outcomes:
        """Return what became of all drives under all attacks of a family."""
        names = [name for name in self.plan.attacks if name.startswith(family)]
        return [one for name in names for one in self.outcomes(detector, fov, name, place)]

    @cached_property
    def detectors(self) -> list[str]:
        """The detectors whose drives were attacked."""
        return [name for name in self.plan.detectors if any(key[1] == name for key in self.drives)]

    @cached_property
    def main(self) -> str:
        """The field of view that targets are held against."""
        return "default" if "default" in self.plan.fovs else self.plan.fovs[-1]

    def target_table(self) -> Table:
        """Return what was aimed at beside what was reached with each detector."""
        reached = [self._reached(detector) for detector in self.detectors]
        rows = []
        for number, (what, sign, aim) in enumerate(TARGETS):
            cells = []
            for values in reached:
                value = values[number]
                met = value <= aim + 1e-9 if sign == "≤" else value >= aim - 1e-9
                cells.append("–" if np.isnan(value) else f"{format_rate(value)}{'' if met else ' **missed**'}")
            rows.append((what, f"{sign} {format_rate(aim, 2)}", *cells))
        return Table(("what", "target", *(DETECTOR_NAMES[name] for name in self.detectors)), rows)

    def _reached(self, detector: str) -> list[float]:
        """Return the values of ``TARGETS`` with a detector; NaN where nothing was run."""
        fov = self.main
        benign = {name: _gospa(self.outcomes(detector, name, BENIGN_CASE))[0] for name in self.plan.fovs}
        attacked = [
            one for family in ("fabricate", "remove", "translate") for one in self.family(detector, fov, family)
        ]
        quiet = self.outcomes(detector, fov, BENIGN_CASE)
        dropped = {name: _share(self.outcomes(detector, name, BENIGN_CASE), "occluded") for name in self.plan.fovs}
        lidar = [one for key in self.sweeps for one in self._lidar(key[5], fov)] if detector == LIDAR_DETECTOR else []
        loss = self._auroc(detector, "exact", "fabricate") - self._auroc(detector, fov, "fabricate")
        return [
            benign[fov] / benign.get("published", np.nan),
            benign[fov] / benign.get("polygon", np.nan),
            benign[fov] / benign.get("none", np.nan),
            dropped[fov] / dropped["published"] if dropped.get("published") else np.nan,
            _ratio(attacked),
            _share(quiet, "honest"),
            _found(self.family(detector, fov, "fabricate"), "ghosts", WITHIN_S),
            _found(lidar, "ghosts"),
            _found(self.family(detector, fov, "remove"), "removed"),
            _found(self.family(detector, fov, "translate"), "moved"),
            _found(self.family(detector, fov, "shift"), "moved"),
            _ece(quiet), _ece(attacked), loss,
        ]  # fmt: skip

    def benign_table(self) -> Table:
        """Return GOSPA, honest tracks accused, calibration and tracks dropped of benign drives by field of view."""
        rows = []
        for detector in self.detectors:
            for fov in self.plan.fovs:
                every = self.outcomes(detector, fov, BENIGN_CASE)
                before, after = _gospa(every)
                honest = np.sum([one["honest"] for one in every], axis=0)
                lost, hidden = np.sum([one["occluded"] for one in every], axis=0)
                rows.append((
                    DETECTOR_NAMES[detector], NAMES[fov], f"{format_number(before, 2)} / {format_number(after, 2)}",
                    f"{format_rate(_share(every, 'honest'))} of {honest[1]}", format_rate(_ece(every)),
                    f"{lost} of {hidden}",
                ))  # fmt: skip
        return Table(("detector", "field of view", "GOSPA, m", "accused", "ECE", "dropped while occluded"), rows)

    def found_table(self) -> Table:
        """Return the shares found by attack and field of view."""
        rows = [
            (DETECTOR_NAMES[detector], name, *(_shares(self.outcomes(detector, fov, name)) for fov in self.plan.fovs))
            for detector in self.detectors for name in self.plan.attacks
        ]  # fmt: skip
        return Table(("detector", "attack", *(NAMES[fov] for fov in self.plan.fovs)), rows)

    def known_table(self) -> Table:
        """Return what was found of removed objects, by whether they had been known."""
        rows = []
        for detector in self.detectors:
            every = [row for one in self.family(detector, self.main, "remove") for row in one["removed"]]
            for is_known, name in ((1.0, "tracked before"), (0.0, "never, or hardly, tracked")):
                for sure, seen in ((True, f"p ≥ {format_rate(SURE, 1)}"), (False, "less visible")):
                    rows_of = [row[0] >= 0.0 for row in every if row[3] == is_known and (row[1] >= SURE) == sure]
                    share = format_rate(float(np.mean(rows_of)), 2) if rows_of else "–"
                    rows.append((DETECTOR_NAMES[detector], name, seen, str(len(rows_of)), share))
        return Table(("detector", "object", "visible", "removed", "found"), rows)

    def gospa_table(self) -> Table:
        """Return GOSPA by attack and field of view."""
        rows = []
        for detector in self.detectors:
            for name in self.plan.attacks:
                cells = []
                for fov in self.plan.fovs:
                    every = self.outcomes(detector, fov, name)
                    before, after = _gospa(every)
                    cells.append(f"{before:.2f} / {after:.2f}, {format_rate(_ratio(every), 2)}")
                rows.append((DETECTOR_NAMES[detector], name, *cells))
        return Table(("detector", "attack", *(NAMES[fov] for fov in self.plan.fovs)), rows)

    def lidar_table(self) -> Table:
        """Return what was found of objects that attacks on the sweep made or took, and why not."""
        rows = []
        fovs = [fov for fov in self.plan.fovs if any(fov in one for one in self.sweeps.values())]
        for attack in self.plan.lidar_attacks:
            for fov in fovs:
                every = self._lidar(attack, fov)
                kind = "ghosts" if attack.startswith("ghost") else "removed"
                forged = [row for one in every for row in one[kind] if kind == "ghosts" or row[1] >= SURE]
                found = [row[0] >= 0.0 for row in forged]
                alarmed = [not is_found and row[5] > 0.0 for row, is_found in zip(forged, found, strict=True)]
                unknown = [
                    not (is_found or is_alarmed) and row[3] == 0.0
                    for row, is_found, is_alarmed in zip(forged, found, alarmed, strict=True)
                ]
                rest = len(forged) - sum(found) - sum(alarmed) - sum(unknown)
                before, after = _gospa(every)
                rows.append((
                    attack, NAMES[fov], str(len(forged)), str(sum(found)), str(sum(alarmed)), str(sum(unknown)),
                    str(rest), f"{before:.2f} / {after:.2f}",
                ))  # fmt: skip
        return Table(
            (
                "attack",
                "field of view",
                "objects",
                "accused",
                "only under alarm",
                "never tracked",
                "missed",
                "GOSPA, m",
            ),
            rows,
        )

    def auroc_table(self) -> Table:
        """Return how well what speaks against tracks tells forged objects from honest ones, whatever the limit."""
        rows = []
        for detector in self.detectors:
            for fov in self.plan.fovs:
                cells = (format_rate(self._auroc(detector, fov, family)) for family in FAMILIES)
                rows.append((DETECTOR_NAMES[detector], NAMES[fov], *cells))
        return Table(("detector", "field of view", *FAMILIES), rows)

    def place_table(self) -> Table:
        """Return what was found by sensor and weather."""
        rows = []
        for detector, *place in sorted({key[1:4] for key in self.drives}):
            found = [
                _found(
                    self.family(detector, self.main, family, (place[0], place[1])), kind,
                    WITHIN_S if kind == "ghosts" else np.inf,
                )
                for family, kind in FAMILIES.items()
            ]  # fmt: skip
            rows.append((DETECTOR_NAMES[detector], *place, *(format_rate(share, 2) for share in found)))
        return Table(("detector", "sensor", "weather", "fabricated", "removed", "translated", "shifted"), rows)

    def _lidar(self, attack: str, fov: str) -> Outcomes:
        return [one[fov][attack] for key, one in self.sweeps.items() if key[5] == attack and fov in one]

    def _auroc(self, detector: str, fov: str, family: str) -> float:
        """Return the area under the curve of forged objects against the honest tracks of benign drives; NaN of none."""
        if fov not in self.plan.fovs:
            return float("nan")
        honest = [value for one in self.outcomes(detector, fov, BENIGN_CASE) for value in one["highest"]]
        kind = FAMILIES[family]
        forged = [
            row[4] for one in self.family(detector, fov, family) for row in one[kind]
            if kind != "removed" or row[1] >= SURE
        ]  # fmt: skip
        return auroc(honest, forged) if honest and forged else float("nan")


TARGETS: tuple[tuple[str, str, float], ...] = (
    ("GOSPA benign, against the published tracker", "≤", 0.85),
    ("GOSPA benign, against the published polygon in our tracker", "≤", 0.85),
    ("GOSPA benign, against none", "≤", 0.75),
    ("tracks dropped while occluded, against the published tracker", "≤", 0.25),
    ("GOSPA under attack, after fusion against no fusion", "≤", 0.60),
    ("honest tracks accused", "≤", 0.03),
    ("fabricated found within 1 s", "≥", 0.90),
    ("ghosts made in the sweep found", "≥", 0.85),
    ("removed found", "≥", 0.85),
    ("translated by ≥ 2 m found", "≥", 0.80),
    ("shifted by ≤ 1 m found", "≥", 0.40),
    ("existence, ECE benign", "≤", 0.03),
    ("existence, ECE attacked", "≤", 0.08),
    ("AUROC of fabricated, exact field of view before the default", "≤", 0.02),
)
"""What was aimed at."""


def _rows(outcomes: Outcomes, kind: str) -> Iterator[float]:
    """Yield seconds until accused (-1: never) of the forged objects of a kind; of removed ones the visible ones."""
    for one in outcomes:
        for row in one[kind]:
            if kind != "removed" or row[1] >= SURE:
                yield row[0]


def _found(outcomes: Outcomes, kind: str, within_s: float = np.inf) -> float:
    """Return the share of the forged objects of a kind that were accused in time; NaN of none."""
    found = [0.0 <= found_s <= within_s + 1e-6 for found_s in _rows(outcomes, kind)]
    return float(np.mean(found)) if found else float("nan")


def _shares(outcomes: Outcomes) -> str:
    """Return what was found in a case as words: of fabricated objects in time and at all, of others at all."""
    words = []
    for kind in ("ghosts", "removed", "moved"):
        count = len(list(_rows(outcomes, kind)))
        if count:
            early = [format_rate(_found(outcomes, kind, WITHIN_S), 2)] if kind == "ghosts" else []
            words.append(f"{' / '.join([*early, format_rate(_found(outcomes, kind), 2)])} of {count}")
    return ", ".join(words) or "–"


def _gospa(outcomes: Outcomes) -> tuple[float, float]:
    """Return the mean GOSPA without fusion and after it, in meters; NaN of none."""
    if not outcomes:
        return float("nan"), float("nan")
    before, after = np.mean([one["gospa_m"] for one in outcomes], axis=0)
    return float(before), float(after)


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
        "range_m": f"{RANGE_M:g}",
        "detectors": " and ".join(plan.detectors),
    }  # fmt: skip
    page = fill_template("tracks/page.md", results=results, **values)
    about = facts(
        plan=f"{plan.name}: {plan.about}", seed=str(plan.seed), sensors=", ".join(plan.sensors),
        weather=", ".join(plan.conditions),
        drives=f"{plan.count} counted, {plan.limit} for limits, {len(found.facts)} with forged detections,"
        f" {len(results.sweeps)} with forged sweeps", commits=commits(found),
    )  # fmt: skip
    return page.files("tracks.md", about)
