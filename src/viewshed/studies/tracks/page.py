"""The page of the study: what was found with each field of view, what it cost, and what was aimed at."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from viewshed._page import Table, facts, to_markdown
from viewshed.studies.formatting import commits, format_number, format_rate
from viewshed.studies.plan import JobKey
from viewshed.studies.store import ResultStore
from viewshed.studies.templates import fill_template
from viewshed.studies.tracks.evaluate import RANGE_M, SURE, WITHIN_S
from viewshed.studies.tracks.plan import BENIGN_CASE, TracksPlan

NAMES = {
    "none": "none", "polygon": "published polygon", "default_hard": "default, hard", "default": "default, probability",
    "exact": "exact",
}  # fmt: skip
"""Fields of view by name, as the tables call them."""

FAMILIES = ("fabricate", "remove", "translate", "shift")

Outcomes = Sequence[Mapping[str, Any]]


@dataclass(frozen=True, eq=False)
class TracksResults:
    """Test drives of a study.

    Attributes:
        plan: of the study.
        drives: by job what became of the drive with each field of view in each case.
    """

    plan: TracksPlan
    drives: Mapping[JobKey, Mapping[str, Any]]

    def outcomes(self, fov: str, case: str, place: tuple[str, str] | None = None) -> Outcomes:
        """Return what became of all drives in a case, or of those of one sensor and weather."""
        return [one[fov][case] for key, one in self.drives.items() if place in (None, key[1:3])]

    def family(self, fov: str, family: str, place: tuple[str, str] | None = None) -> Outcomes:
        """Return what became of all drives under all attacks of a family."""
        names = [name for name in self.plan.attacks if name.startswith(family)]
        return [one for name in names for one in self.outcomes(fov, name, place)]

    @cached_property
    def main(self) -> str:
        """The field of view that targets are held against."""
        return "default" if "default" in self.plan.fovs else self.plan.fovs[-1]

    def target_table(self) -> Table:
        """Return what was aimed at beside what was reached."""
        fov = self.main
        benign = {name: _gospa(self.outcomes(name, BENIGN_CASE))[0] for name in self.plan.fovs}
        attacked = [one for family in FAMILIES[:3] for one in self.family(fov, family)]
        accused, honest = np.sum([one["honest"] for one in self.outcomes(fov, BENIGN_CASE)], axis=0)
        lines = [
            ("GOSPA benign, against the published polygon", "≤ .85", benign[fov] / benign.get("polygon", np.nan)),
            ("GOSPA benign, against none", "≤ .75", benign[fov] / benign.get("none", np.nan)),
            ("GOSPA under attack, after fusion against no fusion", "≤ .60", _ratio(attacked)),
            ("honest tracks accused", f"≤ {format_rate(self.plan.accused)}", accused / honest if honest else np.nan),
            ("fabricated found within 1 s", "≥ .90", _found(self.family(fov, "fabricate"), "ghosts", WITHIN_S)),
            ("removed found", "≥ .85", _found(self.family(fov, "remove"), "removed")),
            ("translated by ≥ 2 m found", "≥ .80", _found(self.family(fov, "translate"), "moved")),
            ("shifted by ≤ 1 m found", "≥ .40", _found(self.family(fov, "shift"), "moved")),
            ("existence, ECE benign", "≤ .03", _ece(self.outcomes(fov, BENIGN_CASE))),
            ("existence, ECE attacked", "≤ .08", _ece(attacked)),
        ]
        return Table(
            ("what", "target", "reached"), [(what, aim, format_rate(float(value))) for what, aim, value in lines]
        )

    def benign_table(self) -> Table:
        """Return GOSPA, honest tracks accused and calibration of benign drives by field of view."""
        rows = []
        for fov in self.plan.fovs:
            every = self.outcomes(fov, BENIGN_CASE)
            before, after = _gospa(every)
            accused, honest = (int(n) for n in np.sum([one["honest"] for one in every], axis=0))
            rows.append((
                NAMES[fov], f"{format_number(before, 2)} / {format_number(after, 2)}",
                f"{format_rate(accused / honest if honest else np.nan)} of {honest}", format_rate(_ece(every)),
            ))  # fmt: skip
        return Table(("field of view", "GOSPA, m", "accused", "ECE"), rows)

    def found_table(self) -> Table:
        """Return the shares found by attack and field of view."""
        rows = [(name, *(_shares(self.outcomes(fov, name)) for fov in self.plan.fovs)) for name in self.plan.attacks]
        return Table(("attack", *(NAMES[fov] for fov in self.plan.fovs)), rows)

    def gospa_table(self) -> Table:
        """Return GOSPA by attack and field of view."""
        rows = []
        for name in self.plan.attacks:
            cells = []
            for fov in self.plan.fovs:
                every = self.outcomes(fov, name)
                before, after = _gospa(every)
                cells.append(f"{before:.2f} / {after:.2f}, {format_rate(_ratio(every), 2)}")
            rows.append((name, *cells))
        return Table(("attack", *(NAMES[fov] for fov in self.plan.fovs)), rows)

    def place_table(self) -> Table:
        """Return what was found by sensor and weather."""
        rows = []
        for place in sorted({(key[1], key[2]) for key in self.drives}):
            found = [
                _found(self.family(self.main, family, place), kind, within_s)
                for family, kind, within_s in zip(
                    FAMILIES, ("ghosts", "removed", "moved", "moved"), (WITHIN_S, np.inf, np.inf, np.inf), strict=True
                )
            ]
            rows.append((*place, *(format_rate(share, 2) for share in found)))
        return Table(("sensor", "weather", "fabricated", "removed", "translated", "shifted"), rows)


def _rows(outcomes: Outcomes, kind: str) -> Iterator[tuple[float, float]]:
    """Yield seconds until accused (-1 for never) and visibility of the forged objects of a kind."""
    for one in outcomes:
        for found_s, _, visible, _ in one[kind]:
            if kind != "removed" or visible >= SURE:
                yield found_s, visible


def _found(outcomes: Outcomes, kind: str, within_s: float = np.inf) -> float:
    """Return the share of the forged objects of a kind that were accused in time; NaN of none."""
    found = [0.0 <= found_s <= within_s + 1e-6 for found_s, _ in _rows(outcomes, kind)]
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
    """Return the mean GOSPA without fusion and after it, in meters."""
    before, after = np.mean([one["gospa_m"] for one in outcomes], axis=0)
    return float(before), float(after)


def _ratio(outcomes: Outcomes) -> float:
    if not outcomes:
        return float("nan")
    before, after = _gospa(outcomes)
    return after / before


def _ece(outcomes: Outcomes) -> float:
    """Return the expected calibration error of existence over ten bins, each weighed by its tracks."""
    if not outcomes:
        return float("nan")
    count, existence, is_object = np.sum([one["existence"] for one in outcomes], axis=0)
    return float(np.abs(existence - is_object).sum() / max(count.sum(), 1))


def page_of(store: ResultStore[TracksPlan]) -> str:
    """Return the page as Markdown.

    Raises:
        ValueError: no drive was attacked yet.
    """
    plan, found = store.plan, store.results("test")
    if not found.facts:
        raise ValueError(f"{store.path} must hold attacked drives, got none; run the study")
    results = TracksResults(plan, found.facts)
    values = {
        "seconds": f"{plan.seconds:g}", "objects": plan.objects, "accused": f"{plan.accused:.0%}",
        "range_m": f"{RANGE_M:g}",
        "detector": plan.detector,
    }  # fmt: skip
    title, blocks = fill_template("tracks/page.md", values, {
        "targets": results.target_table,
        "benign": results.benign_table,
        "found": results.found_table,
        "gospa": results.gospa_table,
        "places": results.place_table,
    })  # fmt: skip
    about = facts(
        plan=f"{plan.name}: {plan.about}", seed=str(plan.seed), sensors=", ".join(plan.sensors),
        weather=", ".join(plan.conditions),
        drives=f"{plan.count} counted, {plan.limit} for limits, {len(found.facts)} attacked", commits=commits(found),
    )  # fmt: skip
    return to_markdown(title, about, blocks)
