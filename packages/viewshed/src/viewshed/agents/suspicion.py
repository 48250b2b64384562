"""How suspicious an agent is: what it reports and what its view claims, on one scale of honest agents.

Evidence of reports (:mod:`viewshed.agents.trust`) and checks of views (:mod:`viewshed.agents.view_checks`) have no unit
in common but how rare they are where nobody lies. The rarer of both counts: a lie about objects leaves the view as it
was, and the other way round.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import Any, Self

import numpy as np

from viewshed.agents.view_checks import ViewScale, view_doubt
from viewshed.arrays import F64, Mask

_FILE = "suspicion.json"


@dataclass(frozen=True, slots=True, eq=False)
class Tail:
    """How rare a number is among honest ones: as counted, and straight on beyond what half of the scenes reach.

    So that what is far beyond all honest numbers is ever more surprising, in whichever unit it is measured. The unit is
    the distance from the median of the scenes' largest numbers to one in ten of them: no single scene decides on it.

    Attributes:
        values: (N,) honest numbers, ascending.
        begin: median of the largest ones of each scene.
        unit: from there to what one scene in ten reaches.
    """

    values: F64
    begin: float
    unit: float

    @classmethod
    def fit(cls, values: F64) -> Self:
        """Return the tail of the honest numbers (S, A) of several scenes."""
        begin, tenth = np.quantile(values.max(axis=1), (0.5, 0.9))
        return cls(np.sort(values, axis=None), float(begin), max(float(tenth - begin), 1e-6))

    def __call__(self, values: F64) -> F64:
        """Return -log10 of the share of honest numbers that are as large as each of the values (…,), at most 1, ...

        ... and a unit more for each unit beyond.
        """
        share = (1.0 + len(self.values) - np.searchsorted(self.values, values, "left")) / (1.0 + len(self.values))
        beyond = np.maximum(values - self.begin, 0.0) / self.unit
        surprise: F64 = np.minimum(-np.log10(share), 1.0) + beyond
        return surprise

    def to_json(self) -> dict[str, Any]:
        """Return it as plain values."""
        return {"values": self.values.round(4).tolist(), "begin": round(self.begin, 4), "unit": round(self.unit, 6)}

    @classmethod
    def from_json(cls, table: dict[str, Any]) -> Self:
        """Return the tail in plain values."""
        return cls(np.array(table["values"], np.float64), float(table["begin"]), float(table["unit"]))


@dataclass(frozen=True, slots=True, eq=False)
class Suspicion:
    """Makes one number of the evidence against an agent and of the checks of its view; larger is more suspicious.

    Attributes:
        views: how rare numbers of checks are among honest views.
        of_reports: tails of the evidence, of sensors among the traffic and of elevated ones.
        of_views: the same of the doubt of views.
    """

    views: ViewScale
    of_reports: tuple[Tail, Tail]
    of_views: tuple[Tail, Tail]

    @classmethod
    def fit(cls, evidence: F64, checks: F64, elevated: Mask) -> Self:
        """Return what S scenes say in which nobody lies.

        Args:
            evidence: (S, T, A) at T times.
            checks: (S, T, A, C).
            elevated: (A,) whose sensors look over the traffic.
        """
        kinds = (~elevated, elevated)
        low, high = (checks[:, :, kind].reshape(-1, checks.shape[-1]) for kind in kinds)
        views = ViewScale.fit(low, high)
        doubt = _doubt(views, checks, elevated)
        largest = [one.max(axis=1) for one in (evidence, doubt)]
        of_reports, of_views = ((Tail.fit(one[:, kinds[0]]), Tail.fit(one[:, kinds[1]])) for one in largest)
        return cls(views, of_reports, of_views)

    def doubt(self, checks: F64, elevated: Mask) -> F64:
        """Return the doubt (…, A) of checks (…, A, C) of views."""
        return _doubt(self.views, checks, elevated)

    def __call__(self, evidence: F64, checks: F64, elevated: Mask) -> F64:
        """Return how suspicious agents are (…, A).

        Args:
            evidence: (…, A) of their reports.
            checks: (…, A, C) of their views, NaN where there is none.
            elevated: (A,) whose sensors look over the traffic.
        """
        doubt = self.doubt(checks, elevated)
        reports, views = (
            np.where(elevated, high(values), low(values))
            for (low, high), values in ((self.of_reports, evidence), (self.of_views, doubt))
        )
        return np.asarray(np.maximum(reports, views))

    def to_json(self) -> str:
        """Return it as text."""
        tails = {name: [tail.to_json() for tail in getattr(self, name)] for name in ("of_reports", "of_views")}
        return json.dumps({"views": self.views.to_json()} | tails) + "\n"

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Return what is in a text of :meth:`to_json`."""
        table = json.loads(text)
        (low, high), (low_view, high_view) = (map(Tail.from_json, table[name]) for name in ("of_reports", "of_views"))
        return cls(ViewScale.from_json(table["views"]), (low, high), (low_view, high_view))


def _doubt(views: ViewScale, checks: F64, elevated: Mask) -> F64:
    low, high = (view_doubt(views(checks, elevated=flag)) for flag in (False, True))
    return np.where(elevated, high, low)


@lru_cache(maxsize=1)
def suspicion_in_box() -> Suspicion:
    """Return the shipped one, of the default estimate and our detector (docs/results/agents.md)."""
    return Suspicion.from_json(resources.files("viewshed.agents").joinpath(_FILE).read_text("utf-8"))
