"""What honest agents do: how often they report an object, what their views show of it, how their views compare.

Detectors miss cars, find hedges, and put centers half a meter off; views differ at every crest. So that one agent
contradicts another is evidence only as far as honest agents hardly ever do so. Tables from scenes in which nobody lies,
on ground of all kinds:

- ``found``: P(report | object, probability of visible, range, size), of an object in truth;
- *reported*: log-odds that an agent reports what others report, by all that its own view shows of it, by its next own
  detection, and by whether it reported the object before;
- *alone*, *shared*: log-ratio that a report is put at a place where nobody reports anything, over one that an honest
  agent makes alone, or several together, by what the views of those show there who could report it and do not;
- *invented*: the same by what the reporter's own view shows, which may be forged;
- *withheld*: log-ratio that an agent is silent about an object that it had reported because it withholds it, over
  honest silence, by how long, by what its own view shows and by what others report; *withheld_forged*: the same without
  its own view, which may be forged;
- *displaced*: log-ratio that the cells of a box are those of one that was moved, over those of an honest one;
- *real*: log-odds that what is reported is an object, by the same cells;
- ``views``: how rare numbers of comparisons of views are.

No lie is needed to fit them: an honest box is put elsewhere, moved, or left out.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from importlib import resources
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from viewshed.agents.report import HEIGHTS
from viewshed.agents.view_evidence import Surprises
from viewshed.arrays import F64, Mask
from viewshed.objects.cells import BoxCells
from viewshed.objects.log_ratios import CELL_BOUNDS, Bins, Columns, Weights, counted, evenly

LEAST_SEEN, SEEN_AT_0_M, SEEN_PER_M = 0.5, 0.43, 0.008
"""From these probabilities of visible on an agent is expected to see an object: at least, by a line in range."""

NO_DETECTION_M = 99.0
"""Distance to the next detection of an agent that has none."""

MOST_BEFORE, MOST_SILENT = 3, 2
"""Most looks with a report of an object, and most in a row without one since, that count for *reported*."""

KNOWN = 2
"""An agent withholds only what it reported at this many looks."""

WITHHELD_SHARES, WITHHELD_PRIOR = (0.05, 0.2, 0.5), 0.03
"""Shares of the objects that who withholds some may withhold, all as likely; chance that any one is withheld."""

MOST_OTHERS, MOST_DENIERS = 4, 2
"""More agents that report an object, or see its place and are silent, are as good as these."""

SMALL_M = 2.4
"""Objects shorter than this are people and bicycles, which give few returns."""

Rows = NDArray[np.uint8]

_COLUMNS = {name: column for column, name in enumerate(BoxCells._fields)}

_BOUNDS: dict[str, tuple[float, ...]] = {
    "visible": (0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98),
    "range_m": (6.0, 10.0, 15.0, 25.0, 35.0, 43.0),
    "size_m": (1.3, SMALL_M, 6.0),
    "kept": (0.3, 0.7, 1.4),
    "returns": (8.0, 20.0, 60.0, 150.0),
    "looks": (1.5, 2.5, 3.5, 4.5, 5.5),
    "others": (1.5, 2.5, 3.5),
    "apart_m": (1.5, 2.5, 3.5, 5.0, 8.0),
} | CELL_BOUNDS
"""Bounds of the bins of each measure."""

_ASKED_ALONE = ("hidden", "ring", "near_free", "first_m", "ring_free")
"""Measures of cells that count by themselves."""

_LEAST_SURFACE = 0.03
"""Whether a surface still stands is asked of those that filled such a share of a box."""

_FEW = 20.0
"""A bin counts as if this number more had been seen, at the share of all like bins."""

_FILE = "honest.json"


@dataclass(frozen=True, slots=True, eq=False)
class ObjectReports:
    """What A agents say of J objects at one time, and what their views claim there."""

    seen: Mask  # (J, A) bool, who reports the object
    able: Mask  # (J, A) bool, who could: it speaks now, and the object is near, on its level and not its own vehicle
    visible: F64  # (J, A) probability that the object could be seen, as the agent claims
    range_m: F64  # (J, A) from the agent's sensor
    height: NDArray[np.int64]  # (A,) where its sensor is: 0 among the traffic, 1 above it, 2 on a tall mast
    size_m: F64  # (J,) longer side of the object
    cells: F64  # (J, A, 8) ``BoxCells`` of the object's box in the agent's view
    own_cells: F64  # (J, A, 8) the same of the agent's own box; 0 where it reports none
    apart_m: F64  # (J, A) from the object to the agent's next detection of another object
    before: NDArray[np.int64]  # (J, A) looks at which the agent reported the object before
    silent: NDArray[np.int64]  # (J, A) looks in a row at which it could and did not, since its last report if any
    surface: F64  # (J, A) share of surface that its view held there at its last report; NaN before the first one
    returns: F64  # (J, A) of the object at its last report; NaN before the first one

    @property
    def sizes_m(self) -> F64:
        """(J, A) longer side of the object, for each agent alike."""
        return np.broadcast_to(self.size_m[:, None], self.seen.shape)

    @property
    def sees(self) -> Mask:
        """(J, A) bool, who could report the object and claims to see it: its view shows it, or the place without it.

        Who is silent though its view holds a surface there does not deny what others report.
        """
        holds = self.cells[..., _COLUMNS["surface"]] > _LEAST_SURFACE
        return self.able & is_expected(self.visible, self.range_m) & (self.seen | ~holds)

    def others(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return how many others report each object, and how many deny it: (J, A) each."""
        reporters, deniers = self.seen.astype(np.int64), (self.sees & ~self.seen).astype(np.int64)
        return reporters.sum(axis=1, keepdims=True) - reporters, deniers.sum(axis=1, keepdims=True) - deniers

    @property
    def withheld(self) -> Mask:
        """(J, A) bool, who knows the object, could report it as others do, and does not."""
        return self.silent_now & (self.before >= KNOWN) & self.seen.any(axis=1, keepdims=True)

    @property
    def repeats(self) -> NDArray[np.int8]:
        """(J, A) 1 where an agent reports the object or not as at its last look, -1 where otherwise, 0 at the first."""
        same = np.where(self.seen == (self.silent == 0), 1, -1)
        return np.where(self.before + self.silent > 0, same, 0).astype(np.int8)

    @property
    def silent_now(self) -> Mask:
        """(J, A) bool, who could report the object and does not."""
        return self.able & ~self.seen

    @property
    def bins(self) -> tuple[NDArray[np.intp], ...]:
        """Where ``found`` holds each agent's share (J, A)."""
        small = np.broadcast_to((self.size_m < SMALL_M)[:, None], self.range_m.shape)
        height = np.broadcast_to(self.height, self.range_m.shape)
        return _share_bins(height, small, self.range_m, self.visible)


def is_expected(visible: F64, range_m: F64) -> Mask:
    """Return whether an honest agent that claims visibility (…,) at ranges (…,) sees an object; its silence denies it.

    >>> is_expected(np.array([0.6, 0.6]), np.array([10.0, 40.0])).tolist()
    [True, False]
    """
    return np.asarray(visible >= np.maximum(LEAST_SEEN, SEEN_AT_0_M + SEEN_PER_M * range_m))


def _share_bins(height: Any, small: Any, range_m: F64, visible: F64) -> tuple[NDArray[np.intp], ...]:
    of = Bins((), _BOUNDS).of
    return (
        np.asarray(height, np.intp), np.asarray(small, np.intp), of("range_m", range_m)[0], of("visible", visible)[0],
    )  # fmt: skip


_SHARES = (HEIGHTS, 2, len(_BOUNDS["range_m"]) + 1, len(_BOUNDS["visible"]) + 1)


def fit_shares(bins: Sequence[NDArray[np.intp]], reported: NDArray[Any]) -> F64:
    """Return the share of N cases that were reported, by their bins; it never falls with the claimed visibility."""
    total, hits = np.zeros(_SHARES), np.zeros(_SHARES)
    np.add.at(total, tuple(bins), 1.0)
    np.add.at(hits, tuple(bins), np.asarray(reported, np.float64))
    # A bin leans on all heights and ranges alike, and those on all.
    usual = (hits.sum(axis=(0, 2), keepdims=True) + 1.0) / (total.sum(axis=(0, 2), keepdims=True) + 2.0)
    usual = (hits.sum(axis=0, keepdims=True) + _FEW * usual) / (total.sum(axis=0, keepdims=True) + _FEW)
    return np.asarray(np.maximum.accumulate((hits + _FEW * usual) / (total + _FEW), axis=-1))


def _cell_bins(reports: ObjectReports, cells: F64) -> tuple[Bins, tuple[NDArray[Any], int]]:
    """Return bins of what the cells (J, A, 8) of boxes say, and those of the sensor's height."""
    shape = reports.seen.shape
    bins = Bins(shape, _BOUNDS)
    surface, free = (bins.of(name, cells[..., _COLUMNS[name]]) for name in ("surface", "free"))
    ranges, size = (bins.of(*each) for each in (("range_m", reports.range_m), ("size_m", reports.sizes_m)))
    kind = (np.broadcast_to(reports.height, shape).astype(np.int32), HEIGHTS)
    for codes in ((ranges, size, kind), (surface, kind), (ranges, surface), (surface, free)):
        bins.add(*codes)
    for name in _ASKED_ALONE:
        bins.add(bins.of(name, cells[..., _COLUMNS[name]]))
    return bins, kind


def reported_columns(reports: ObjectReports) -> tuple[Columns, int]:
    """Return the columns (J, A, F) of *reported*, without the numbers of others, and how many columns there are."""
    bins, kind = _cell_bins(reports, reports.cells)
    before, silent = np.minimum(reports.before, MOST_BEFORE), np.clip(reports.silent, 0, MOST_SILENT)
    past = (before * (MOST_SILENT + 1) + silent, (MOST_BEFORE + 1) * (MOST_SILENT + 1))
    surface = bins.of("surface", reports.cells[..., _COLUMNS["surface"]])
    bins.add(bins.of("visible", reports.visible), surface)
    bins.add(past, kind)
    bins.add(past, surface)
    bins.add(past, _kept_bins(reports, bins))
    bins.add(past, bins.of("returns", np.nan_to_num(reports.returns)))
    bins.add(bins.of("apart_m", reports.apart_m), bins.of("size_m", reports.sizes_m))
    return bins.columns(), bins.size


def others_column(reporters: NDArray[Any], deniers: NDArray[Any]) -> NDArray[Any]:
    """Return the column for the numbers of others that report an object and that deny it."""
    column: NDArray[Any] = np.minimum(reporters, MOST_OTHERS) * (MOST_DENIERS + 1) + np.minimum(deniers, MOST_DENIERS)
    return column


def own_box_columns(reports: ObjectReports) -> tuple[Columns, int]:
    """Return the columns (J, A, F) of what the agent's own view says of its own box, and how many there are."""
    bins, _ = _cell_bins(reports, reports.own_cells)
    return bins.columns(), bins.size


def withheld_columns(reports: ObjectReports, *, own_view: bool) -> tuple[Columns, int]:
    """Return the columns (J, A, F) of an agent's silence, with or without its own view, and how many there are."""
    shape = reports.seen.shape
    bins = Bins(shape, _BOUNDS)
    height = (np.broadcast_to(reports.height, shape).astype(np.int32), HEIGHTS)
    looks, before = (bins.of("looks", count) for count in (reports.silent + 1, reports.before))
    others = bins.of("others", reports.others()[0])
    ranges, size = bins.of("range_m", reports.range_m), bins.of("size_m", reports.sizes_m)
    returns, apart = bins.of("returns", np.nan_to_num(reports.returns)), bins.of("apart_m", reports.apart_m)
    for of in (returns, others, ranges, before):
        bins.add(looks, of)
    for codes in ((ranges, returns), (ranges, size, height), (apart, size)):
        bins.add(*codes)
    if own_view:
        kept, visible = _kept_bins(reports, bins), bins.of("visible", reports.visible)
        surface = bins.of("surface", reports.cells[..., _COLUMNS["surface"]])
        for codes in ((looks, visible), (looks, kept), (looks, surface), (returns, kept), (visible, returns)):
            bins.add(*codes)
        for name in ("free", *_ASKED_ALONE):
            bins.add(bins.of(name, reports.cells[..., _COLUMNS[name]]))
    return bins.columns(), bins.size


def _kept_bins(reports: ObjectReports, bins: Bins) -> tuple[NDArray[Any], int]:
    """Return whether the surface still stands (J, A) that was there when each agent reported the object last."""
    now, before = reports.cells[..., _COLUMNS["surface"]], np.nan_to_num(reports.surface)
    kept, count = bins.of("kept", now / np.maximum(before, 1e-3))
    return np.where(before > _LEAST_SURFACE, kept, count), count + 1


def place_columns(reports: ObjectReports) -> tuple[Columns, int]:
    """Return the columns (J, A, F) of what an agent's view says of the place of an object, and how many there are."""
    bins, kind = _cell_bins(reports, reports.cells)
    visible = bins.of("visible", reports.visible)
    bins.add(visible, kind)
    bins.add(visible, bins.of("free", reports.cells[..., _COLUMNS["free"]]))
    return bins.columns(), bins.size


def _summed(columns: Columns, size: int, chosen: Mask) -> Rows:
    """Return how often each column occurs (J, size) among the chosen agents of each object."""
    some = np.where(chosen[..., None], columns, size)
    return counted(some.reshape(len(some), int(np.prod(some.shape[1:]))), size)


@dataclass(frozen=True, slots=True, eq=False)
class HonestModel:
    """What honest agents do; see the module."""

    found: F64  # (heights, sizes, ranges, visibilities) chance that an agent reports an object
    reported: Weights  # log-odds that an agent reports what others report; the last columns are those of the others
    alone: Weights  # log-ratio of reports of places elsewhere over those that honest agents alone make
    shared: Weights  # the same over those that several honest agents make
    invented: Weights  # the same by the reporter's own view
    real: Weights  # log-odds that what is reported is an object
    displaced: Weights  # log-ratio of boxes that were moved over honest ones
    withheld: Weights  # log-ratio of silence that begins at will over honest silence
    withheld_forged: Weights  # the same without the agent's own view
    views: Surprises  # how rare numbers of comparisons of views are

    @classmethod
    def blank(cls) -> Self:
        """Return a model that knows nothing: reports are as likely as not, and no comparison is rare."""
        weights = {name: Weights(np.zeros(count), 0.0) for name, count in _counts().items()}
        return cls(np.full(_SHARES, 0.5), views=Surprises.blank(), **weights)

    @property
    def of_others(self) -> F64:
        """(others, deniers) log-odds that *reported* adds for them."""
        count = (MOST_OTHERS + 1) * (MOST_DENIERS + 1)
        return self.reported.of_bins[-count:].reshape(MOST_OTHERS + 1, MOST_DENIERS + 1)

    def chance(self, visible: F64, boxes: F64, range_m: F64, *, height: int) -> F64:
        """Return the chance (K,) that an honest agent reports an object in each box, by what it claims to see of it."""
        small = boxes[:, 3:5].max(axis=1, initial=0.0) < SMALL_M
        return np.asarray(self.found[_share_bins(np.full(len(boxes), height), small, range_m, visible)])

    def silent_views(self, columns: Columns, silent: Mask) -> F64:
        """Return what the views of those who are silent (J, A) add to *alone* and *shared*, (2, J, A), without biases.

        Args:
            columns: of :func:`place_columns`.
            silent: who could report each object and does not.
        """
        return np.stack([np.where(silent, of(columns) - of.bias, 0.0) for of in (self.alone, self.shared)])

    def withheld_ratio(self, reports: ObjectReports) -> F64:
        """Return the log-ratio (J, A) that each agent withholds each object over that its silence is honest.

        It is 0 where it does not know the object or reports it. Its own view is as likely to be forged as not.
        """
        of_view, forged = (
            of(withheld_columns(reports, own_view=own_view)[0])
            for of, own_view in ((self.withheld, True), (self.withheld_forged, False))
        )
        return np.where(reports.withheld, np.logaddexp(of_view, forged) - np.log(2.0), 0.0)

    def there(self, reports: ObjectReports, place: tuple[Columns, int], own: Columns, ratio: F64) -> F64:
        """Return the log-odds (J, A) that each agent's report or silence adds to those that an object is one.

        Silence that is withheld says nothing. ``place``, ``own`` and ``ratio`` are what :func:`place_columns`,
        :func:`own_box_columns` and :meth:`withheld_ratio` say of the reports.
        """
        (columns, size), of_bins = place, self.real.of_bins
        odds = np.log(WITHHELD_PRIOR / (1.0 - WITHHELD_PRIOR)) + ratio
        withheld = np.where(reports.withheld, 1.0 / (1.0 + np.exp(-odds)), 0.0)
        silence = np.log((1.0 - withheld) * np.exp(of_bins[columns].sum(axis=-1)) + withheld)
        return np.where(reports.seen, of_bins[size + own].sum(axis=-1), np.where(reports.silent_now, silence, 0.0))

    def to_json(self) -> str:
        """Return the model as text."""
        table: dict[str, Any] = {"bounds": _BOUNDS, "views": self.views.to_json()}
        table["found"] = self.found.round(4).tolist()
        for name in _counts():
            weights = getattr(self, name)
            table[name] = {"of_bins": weights.of_bins.round(3).tolist(), "bias": round(weights.bias, 3)}
        return json.dumps(table) + "\n"

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Return the model in a text of :meth:`to_json`.

        Raises:
            ValueError: it has other bins.
        """
        table = json.loads(text)
        if table["bounds"] != {name: list(bounds) for name, bounds in _BOUNDS.items()}:
            raise ValueError("bounds must be those of this version; fit the model again")
        weights = {
            name: Weights(np.array(table[name]["of_bins"]), float(table[name]["bias"])) for name in _counts()
        }  # fmt: skip
        return cls(np.array(table["found"]), views=Surprises.from_json(table["views"]), **weights)


@lru_cache(maxsize=1)
def honest_model() -> HonestModel:
    """Return the shipped model, of the default estimate and our detector (docs/results/agents.md)."""
    return HonestModel.from_json(resources.files("viewshed.agents").joinpath(_FILE).read_text("utf-8"))


@dataclass(frozen=True, slots=True, eq=False)
class HonestExamples:
    """Rows that a model is fitted on, of one time of a scene in which nobody lies."""

    found: Rows  # bins (N, 4) of objects in truth near agents, then whether the agent reported them
    reported: Rows  # counts of columns (N, W), then whether the agent reported the object
    alone: Rows  # counts of columns of what one agent reports, in views of others, then whether it is elsewhere
    shared: Rows  # the same of what several agents report
    invented: Rows  # counts of columns of what one agent reports, in its own view, then whether it is elsewhere
    real: Rows  # counts of columns of what anybody reports, then whether it is an object
    displaced: Rows  # counts of columns, then whether the box was moved
    withheld: Rows  # counts of columns of what an agent is silent about that it knows, then whether it was left out
    withheld_forged: Rows  # the same without its own view
    silent: Rows  # (N, 1) whether an agent is silent about an object that it knows and another one reports

    @classmethod
    def of(
        cls, reports: ObjectReports, is_object: Mask, objects: ObjectReports, elsewhere: ObjectReports,
        moved: ObjectReports, left_out: ObjectReports,
    ) -> HonestExamples:  # fmt: skip
        """Return the examples of one time.

        Args:
            reports: of honest agents, about what somebody reports.
            is_object: (J,) bool, which are objects in truth.
            objects: the same agents, about all objects in truth.
            elsewhere: places at which nobody reports anything, as if each were reported by one agent (``seen``).
            moved: boxes of detections that were moved, as if they were reported there.
            left_out: the reports without some that are left out from some time on; nobody is ``able`` about others.
        """
        reporters, deniers = reports.others()
        columns, count = reported_columns(reports)
        columns = np.concatenate([columns, count + others_column(reporters, deniers)[..., None]], axis=-1)
        judged = (reports.able | reports.seen) & (reporters > 0)
        places, number = _summed(*place_columns(reports), reports.silent_now), reports.seen.sum(axis=1)
        own = own_box_columns(reports)
        turned = own_box_columns(elsewhere)[0][elsewhere.seen]
        turned_places = _summed(*place_columns(elsewhere), elsewhere.silent_now)
        alone = number == 1
        silences = []
        for own_view in (True, False):
            honest, other = (withheld_columns(each, own_view=own_view) for each in (reports, left_out))
            pair = ((honest, reports.withheld), (other, left_out.withheld))
            silences.append(_contrasted(*(counted(some[chosen], size) for (some, size), chosen in pair)))
        is_known = (reports.able | reports.seen) & (reports.before >= KNOWN) & (reporters > 0)
        return cls(
            _labeled(np.stack(objects.bins, axis=-1)[objects.able], objects.seen[objects.able]),
            _labeled(counted(columns[judged], _counts()["reported"]), reports.seen[judged]),
            _contrasted(places[alone], turned_places),
            _contrasted(places[number > 1], turned_places),
            _contrasted(*(counted(some, own[1]) for some in (own[0][reports.seen & alone[:, None]], turned))),
            _labeled(np.concatenate([places, _summed(*own, reports.seen)], axis=1), is_object),
            _contrasted(
                *(counted(some, own[1]) for some in (own[0][reports.seen], own_box_columns(moved)[0][moved.seen]))
            ),
            silences[0],
            silences[1],
            (~reports.seen[is_known][:, None]).astype(np.uint8),
        )


def fit_honest(examples: Sequence[HonestExamples], views: Surprises) -> HonestModel:
    """Return the model of many scenes.

    Raises:
        ValueError: there are too few.
    """
    rows = {each.name: np.concatenate([getattr(one, each.name) for one in examples]) for each in fields(HonestExamples)}
    found = fit_shares(tuple(rows["found"][:, :-1].T), rows["found"][:, -1])
    fitted = {}
    for name in _counts():
        counts, label = rows[name][:, :-1], rows[name][:, -1]
        # Of what is made up there is as much as one likes: both classes weigh the same.
        fitted[name] = Weights.fit(counts, label, None if name in ("reported", "real") else evenly(label))
    # Honest silence is rare, silence of what is withheld is certain.
    rare = -float(np.log(rows["silent"].mean()))
    for name in ("withheld", "withheld_forged"):
        fitted[name] = replace(fitted[name], bias=fitted[name].bias + rare)
    return HonestModel(found, views=views, **fitted)


def withholding(reports: ObjectReports, ratio: F64) -> F64:
    """Return the log-ratio (A,) that each agent withholds some objects that it knows over that it is honest.

    ``ratio`` is what :meth:`HonestModel.withheld_ratio` says of the reports.
    """
    share = np.array(WITHHELD_SHARES)[:, None, None]
    # What is reported is not withheld; what an agent is silent about it withholds or not.
    silent = np.logaddexp(np.log1p(-share), np.log(share) + ratio)
    is_known = reports.seen & (reports.before >= KNOWN)
    each = np.where(reports.withheld, silent, np.where(is_known, np.log1p(-share), 0.0))
    out: F64 = np.logaddexp.reduce(each.sum(axis=1), axis=0) - np.log(len(share))
    return out


def _contrasted(honest: NDArray[Any], other: NDArray[Any]) -> Rows:
    """Return the labeled counts (N, W + 1) of some honest rows (label 0) and of some made-up ones (label 1)."""
    return _labeled(np.concatenate([honest, other]), np.repeat([0, 1], [len(honest), len(other)]))


def _labeled(counts: NDArray[Any], label: NDArray[Any]) -> Rows:
    return np.column_stack([counts, np.asarray(label, np.uint8)]).astype(np.uint8)


@lru_cache(maxsize=1)
def _counts() -> dict[str, int]:
    """Return how many columns each question has."""
    nothing = ObjectReports(
        *(np.zeros((0, 1), np.bool_),) * 2, *(np.zeros((0, 1)),) * 2, np.zeros(1, np.int64), np.zeros(0),
        *(np.zeros((0, 1, len(BoxCells._fields))),) * 2, np.zeros((0, 1)), *(np.zeros((0, 1), np.int64),) * 2,
        *(np.zeros((0, 1)),) * 2,
    )  # fmt: skip
    place, own = place_columns(nothing)[1], own_box_columns(nothing)[1]
    reported = reported_columns(nothing)[1] + (MOST_OTHERS + 1) * (MOST_DENIERS + 1)
    withheld, forged = (withheld_columns(nothing, own_view=own_view)[1] for own_view in (True, False))
    return {
        "reported": reported, "alone": place, "shared": place, "invented": own, "real": place + own, "displaced": own,
        "withheld": withheld, "withheld_forged": forged,
    }  # fmt: skip
