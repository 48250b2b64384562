"""Statistical model of honest agents: how often they report an object, what their views show of it, how views compare.

Detectors miss cars, detect hedges, and place centers half a meter off; views differ at every crest. A contradiction
between agents is evidence only to the extent that honest agents hardly ever contradict each other in that way. The
tables are fitted on scenes without liars, on all kinds of ground:

- ``found``: P(report | object, probability of visible, range, size), for true objects;
- *reported*: log-odds that an agent reports what others report, given its own view, its nearest other detection, and
  whether it reported the object before;
- *alone*, *shared*: log-ratio of a made-up place (one where nobody reports anything) over a place that one honest agent
  (alone) or several (shared) report, given the views of the agents that could report it and do not;
- *invented*: the same given the reporter's own view, which may be forged;
- *withheld*: log-ratio that an agent withholds an object that it had reported over honest silence, given the duration,
  its own view and the others' reports; *withheld_forged*: the same without its own view, which may be forged;
- *displaced*: log-ratio of a moved box over an honest one, given the cells in and around it;
- *real*: log-odds that a reported object exists, given the same cells;
- ``views``: how rare each value of a view comparison is.

Fitting needs no attacks: honest boxes are put elsewhere, moved, or left out.
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

MIN_SEEN, SEEN_AT_0_M, SEEN_PER_M = 0.5, 0.43, 0.008
"""Minimum probability of visible to expect a report: maximum of a constant and a line (at 0 m, per meter of range)."""

NO_DETECTION_M = 99.0
"""Distance to the next detection of an agent without another one."""

MAX_BEFORE, MAX_SILENT = 3, 2
"""Caps of *reported*: on looks with a report of an object, and on consecutive looks without one since."""

KNOWN = 2
"""An agent knows, and can withhold, an object that it reported at this many looks."""

WITHHELD_SHARES, WITHHELD_PRIOR = (0.05, 0.2, 0.5), 0.03
"""Equally likely shares of withheld objects, and prior probability that an object is withheld."""

MAX_OTHERS, MAX_DENIERS = 4, 2
"""Caps on the numbers of other agents that report an object and that deny it."""

SMALL_M = 2.4
"""Shorter objects are people and bicycles, which give few returns."""

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
"""Bin edges of each feature."""

_SINGLE_FEATURES = ("hidden", "ring", "near_free", "first_m", "ring_free")
"""Cell features that get weights by themselves."""

_MIN_SURFACE = 0.03
"""Minimum share of surface in a box to ask whether the surface is still there."""

_PRIOR_COUNT = 20.0
"""Prior count of each bin, at the share of all similar bins."""

_FILE = "honest.json"


@dataclass(frozen=True, slots=True, eq=False)
class ObjectReports:
    """Reports of A agents about J objects at one time, and what their views claim there."""

    seen: Mask  # (J, A) bool, agents that report the object
    able: Mask  # (J, A) bool, agents that report now, with the object near, on their level, not their own vehicle
    visible: F64  # (J, A) probability that the object could be seen, by the agent's view
    range_m: F64  # (J, A) from the agent's sensor
    height: NDArray[np.int64]  # (A,) height class of its sensor: 0 among the traffic, 1 above it, 2 on a tall mast
    size_m: F64  # (J,) longer side of the object
    cells: F64  # (J, A, 8) ``BoxCells`` of the object's box in the agent's view
    own_cells: F64  # (J, A, 8) the same of the box that the agent itself reports; 0 for none
    apart_m: F64  # (J, A) distance from the object to the agent's nearest other detection
    before: NDArray[np.int64]  # (J, A) earlier looks at which the agent reported the object
    silent: NDArray[np.int64]  # (J, A) consecutive looks at which it could and did not, since its last report if any
    surface: F64  # (J, A) share of surface in its view at its last report; NaN before the first one
    returns: F64  # (J, A) of the object at its last report; NaN before the first one

    @property
    def sizes_m(self) -> F64:
        """(J, A) longer side of the object, equal for all agents."""
        return np.broadcast_to(self.size_m[:, None], self.seen.shape)

    @property
    def sees(self) -> Mask:
        """(J, A) bool, agents that could report the object and claim to see it, or its place without it.

        An agent that is silent although its view holds a surface there does not deny the object.
        """
        holds = self.cells[..., _COLUMNS["surface"]] > _MIN_SURFACE
        return self.able & is_expected(self.visible, self.range_m) & (self.seen | ~holds)

    def others(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the numbers (J, A) of other agents that report each object, and that deny it."""
        reporters, deniers = self.seen.astype(np.int64), (self.sees & ~self.seen).astype(np.int64)
        return reporters.sum(axis=1, keepdims=True) - reporters, deniers.sum(axis=1, keepdims=True) - deniers

    @property
    def withheld(self) -> Mask:
        """(J, A) bool, agents that know the object, could report it as others do, and do not."""
        return self.silent_now & (self.before >= KNOWN) & self.seen.any(axis=1, keepdims=True)

    @property
    def repeats(self) -> NDArray[np.int8]:
        """(J, A) 1 where an agent repeats its last look (report or silence), -1 where it does not, 0 at the first."""
        same = np.where(self.seen == (self.silent == 0), 1, -1)
        return np.where(self.before + self.silent > 0, same, 0).astype(np.int8)

    @property
    def silent_now(self) -> Mask:
        """(J, A) bool, agents that could report the object and do not."""
        return self.able & ~self.seen

    @property
    def bins(self) -> tuple[NDArray[np.intp], ...]:
        """Index of each agent's share (J, A) in ``found``."""
        small = np.broadcast_to((self.size_m < SMALL_M)[:, None], self.range_m.shape)
        height = np.broadcast_to(self.height, self.range_m.shape)
        return _share_bins(height, small, self.range_m, self.visible)


def is_expected(visible: F64, range_m: F64) -> Mask:
    """Return where silence at visibility (…,) and range (…,) denies an object, because an honest agent would see it.

    >>> is_expected(np.array([0.6, 0.6]), np.array([10.0, 40.0])).tolist()
    [True, False]
    """
    return np.asarray(visible >= np.maximum(MIN_SEEN, SEEN_AT_0_M + SEEN_PER_M * range_m))


def _share_bins(height: Any, small: Any, range_m: F64, visible: F64) -> tuple[NDArray[np.intp], ...]:
    of = Bins((), _BOUNDS).of
    return (
        np.asarray(height, np.intp), np.asarray(small, np.intp), of("range_m", range_m)[0], of("visible", visible)[0],
    )  # fmt: skip


_SHARES = (HEIGHTS, 2, len(_BOUNDS["range_m"]) + 1, len(_BOUNDS["visible"]) + 1)


def fit_shares(bins: Sequence[NDArray[np.intp]], reported: NDArray[Any]) -> F64:
    """Return the reported share of N cases by bin; it never falls with the probability of visible."""
    total, hits = np.zeros(_SHARES), np.zeros(_SHARES)
    np.add.at(total, tuple(bins), 1.0)
    np.add.at(hits, tuple(bins), np.asarray(reported, np.float64))
    # Shrink each bin toward the share over all heights, and that one toward the share over all ranges too.
    usual = (hits.sum(axis=(0, 2), keepdims=True) + 1.0) / (total.sum(axis=(0, 2), keepdims=True) + 2.0)
    usual = (hits.sum(axis=0, keepdims=True) + _PRIOR_COUNT * usual) / (total.sum(axis=0, keepdims=True) + _PRIOR_COUNT)
    return np.asarray(np.maximum.accumulate((hits + _PRIOR_COUNT * usual) / (total + _PRIOR_COUNT), axis=-1))


def _cell_bins(reports: ObjectReports, cells: F64) -> tuple[Bins, tuple[NDArray[Any], int]]:
    """Return bins of the cells (J, A, 8) of boxes, and the bin of the sensor's height."""
    shape = reports.seen.shape
    bins = Bins(shape, _BOUNDS)
    surface, free = (bins.of(name, cells[..., _COLUMNS[name]]) for name in ("surface", "free"))
    ranges, size = (bins.of(*each) for each in (("range_m", reports.range_m), ("size_m", reports.sizes_m)))
    kind = (np.broadcast_to(reports.height, shape).astype(np.int32), HEIGHTS)
    for codes in ((ranges, size, kind), (surface, kind), (ranges, surface), (surface, free)):
        bins.add(*codes)
    for name in _SINGLE_FEATURES:
        bins.add(bins.of(name, cells[..., _COLUMNS[name]]))
    return bins, kind


def reported_columns(reports: ObjectReports) -> tuple[Columns, int]:
    """Return the columns (J, A, F) of *reported* without :func:`others_column`, and the number of columns."""
    bins, kind = _cell_bins(reports, reports.cells)
    before, silent = np.minimum(reports.before, MAX_BEFORE), np.clip(reports.silent, 0, MAX_SILENT)
    past = (before * (MAX_SILENT + 1) + silent, (MAX_BEFORE + 1) * (MAX_SILENT + 1))
    surface = bins.of("surface", reports.cells[..., _COLUMNS["surface"]])
    bins.add(bins.of("visible", reports.visible), surface)
    bins.add(past, kind)
    bins.add(past, surface)
    bins.add(past, _kept_bins(reports, bins))
    bins.add(past, bins.of("returns", np.nan_to_num(reports.returns)))
    bins.add(bins.of("apart_m", reports.apart_m), bins.of("size_m", reports.sizes_m))
    return bins.columns(), bins.size


def others_column(reporters: NDArray[Any], deniers: NDArray[Any]) -> NDArray[Any]:
    """Return the column for the numbers of other agents that report an object and that deny it."""
    column: NDArray[Any] = np.minimum(reporters, MAX_OTHERS) * (MAX_DENIERS + 1) + np.minimum(deniers, MAX_DENIERS)
    return column


def own_box_columns(reports: ObjectReports) -> tuple[Columns, int]:
    """Return the columns (J, A, F) of the box that each agent reports in its own view, and the number of columns."""
    bins, _ = _cell_bins(reports, reports.own_cells)
    return bins.columns(), bins.size


def withheld_columns(reports: ObjectReports, *, own_view: bool) -> tuple[Columns, int]:
    """Return the columns (J, A, F) of an agent's silence, with or without its own view, and the number of columns."""
    shape = reports.seen.shape
    bins = Bins(shape, _BOUNDS)
    height = (np.broadcast_to(reports.height, shape).astype(np.int32), HEIGHTS)
    looks, before = (bins.of("looks", count) for count in (reports.silent + 1, reports.before))
    others = bins.of("others", reports.others()[0])
    ranges, size = bins.of("range_m", reports.range_m), bins.of("size_m", reports.sizes_m)
    returns, distance = bins.of("returns", np.nan_to_num(reports.returns)), bins.of("apart_m", reports.apart_m)
    for other in (returns, others, ranges, before):
        bins.add(looks, other)
    for codes in ((ranges, returns), (ranges, size, height), (distance, size)):
        bins.add(*codes)
    if own_view:
        kept, visible = _kept_bins(reports, bins), bins.of("visible", reports.visible)
        surface = bins.of("surface", reports.cells[..., _COLUMNS["surface"]])
        for codes in ((looks, visible), (looks, kept), (looks, surface), (returns, kept), (visible, returns)):
            bins.add(*codes)
        for name in ("free", *_SINGLE_FEATURES):
            bins.add(bins.of(name, reports.cells[..., _COLUMNS[name]]))
    return bins.columns(), bins.size


def _kept_bins(reports: ObjectReports, bins: Bins) -> tuple[NDArray[Any], int]:
    """Return bins (J, A) of the current surface relative to that at the agent's last report, and their number."""
    now, before = reports.cells[..., _COLUMNS["surface"]], np.nan_to_num(reports.surface)
    bin_indices, count = bins.of("kept", now / np.maximum(before, 1e-3))
    return np.where(before > _MIN_SURFACE, bin_indices, count), count + 1


def place_columns(reports: ObjectReports) -> tuple[Columns, int]:
    """Return the columns (J, A, F) of an object's place in each agent's view, and the number of columns."""
    bins, kind = _cell_bins(reports, reports.cells)
    visible = bins.of("visible", reports.visible)
    bins.add(visible, kind)
    bins.add(visible, bins.of("free", reports.cells[..., _COLUMNS["free"]]))
    return bins.columns(), bins.size


def _summed(columns: Columns, size: int, chosen: Mask) -> Rows:
    """Return how often each column occurs (J, size) among the chosen agents of each object."""
    chosen_columns = np.where(chosen[..., None], columns, size)
    return counted(chosen_columns.reshape(len(chosen_columns), int(np.prod(chosen_columns.shape[1:]))), size)


@dataclass(frozen=True, slots=True, eq=False)
class HonestModel:
    """Fitted model of honest agents; see the module."""

    found: F64  # (heights, sizes, ranges, visibilities) probability that an agent reports an object
    reported: Weights  # log-odds that an agent reports what others report; last the columns of :func:`others_column`
    alone: Weights  # log-ratio of made-up places over those that one honest agent reports alone
    shared: Weights  # the same over those that several honest agents report
    invented: Weights  # the same by the reporter's own view
    real: Weights  # log-odds that a reported object exists
    displaced: Weights  # log-ratio of moved boxes over honest ones
    withheld: Weights  # log-ratio of withholding over honest silence
    withheld_forged: Weights  # the same without the agent's own view
    views: Surprises  # how rare each value of a view comparison is

    @classmethod
    def blank(cls) -> Self:
        """Return an uninformative model: a report is as likely as silence, and no comparison is rare."""
        weights = {name: Weights(np.zeros(count), 0.0) for name, count in _counts().items()}
        return cls(np.full(_SHARES, 0.5), views=Surprises.blank(), **weights)

    @property
    def of_others(self) -> F64:
        """(others, deniers) log-odds that their numbers add to *reported*."""
        count = (MAX_OTHERS + 1) * (MAX_DENIERS + 1)
        return self.reported.of_bins[-count:].reshape(MAX_OTHERS + 1, MAX_DENIERS + 1)

    def chance(self, visible: F64, boxes: F64, range_m: F64, *, height: int) -> F64:
        """Return the probability (K,) that an honest agent reports an object in each box, by visibility and range."""
        small = boxes[:, 3:5].max(axis=1, initial=0.0) < SMALL_M
        return np.asarray(self.found[_share_bins(np.full(len(boxes), height), small, range_m, visible)])

    def silent_views(self, columns: Columns, silent: Mask) -> F64:
        """Return the terms (2, J, A) of silent agents' views in *alone* and *shared*, without biases.

        Args:
            columns: of :func:`place_columns`.
            silent: (J, A) bool, agents that could report the object and do not.
        """
        return np.stack([np.where(silent, of(columns) - of.bias, 0.0) for of in (self.alone, self.shared)])

    def withheld_ratio(self, reports: ObjectReports) -> F64:
        """Return the log-ratio (J, A) that each agent withholds each object over honest silence.

        It is 0 where the agent does not know the object or reports it. Its own view is forged with probability 0.5.
        """
        of_view, forged = (
            of(withheld_columns(reports, own_view=own_view)[0])
            for of, own_view in ((self.withheld, True), (self.withheld_forged, False))
        )
        return np.where(reports.withheld, np.logaddexp(of_view, forged) - np.log(2.0), 0.0)

    def there(self, reports: ObjectReports, place: tuple[Columns, int], own: Columns, ratio: F64) -> F64:
        """Return the log-odds (J, A) that each agent's report or silence adds for the existence of an object.

        Withheld silence adds nothing. ``place``, ``own`` and ``ratio`` are the results of :func:`place_columns`,
        :func:`own_box_columns` and :meth:`withheld_ratio` for the reports.
        """
        (columns, size), of_bins = place, self.real.of_bins
        odds = np.log(WITHHELD_PRIOR / (1.0 - WITHHELD_PRIOR)) + ratio
        withheld = np.where(reports.withheld, 1.0 / (1.0 + np.exp(-odds)), 0.0)
        silence = np.log((1.0 - withheld) * np.exp(of_bins[columns].sum(axis=-1)) + withheld)
        return np.where(reports.seen, of_bins[size + own].sum(axis=-1), np.where(reports.silent_now, silence, 0.0))

    def to_json(self) -> str:
        """Return the model as JSON text."""
        table: dict[str, Any] = {"bounds": _BOUNDS, "views": self.views.to_json()}
        table["found"] = self.found.round(4).tolist()
        for name in _counts():
            weights = getattr(self, name)
            table[name] = {"of_bins": weights.of_bins.round(3).tolist(), "bias": round(weights.bias, 3)}
        return json.dumps(table) + "\n"

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Return the model from the text of :meth:`to_json`.

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
    """Return the shipped model, fitted with the default estimator and detector (docs/results/agents.md)."""
    return HonestModel.from_json(resources.files("viewshed.agents").joinpath(_FILE).read_text("utf-8"))


@dataclass(frozen=True, slots=True, eq=False)
class HonestExamples:
    """Training rows of a model, from one time of a scene without liars."""

    found: Rows  # bins (N, 4) of true objects near agents, then whether the agent reported them
    reported: Rows  # counts of columns (N, W), then whether the agent reported the object
    alone: Rows  # counts of columns, in others' views, of what one agent reports, then whether it is made up
    shared: Rows  # the same for what several agents report
    invented: Rows  # counts of columns, in its own view, of what one agent reports, then whether it is made up
    real: Rows  # counts of columns of what any agent reports, then whether it is an object
    displaced: Rows  # counts of columns, then whether the box was moved
    withheld: Rows  # counts of columns of silence about known objects, then whether the object was left out
    withheld_forged: Rows  # the same without its own view
    silent: Rows  # (N, 1) whether an agent is silent about an object that it knows and another one reports

    @classmethod
    def of(
        cls, reports: ObjectReports, is_object: Mask, objects: ObjectReports, elsewhere: ObjectReports,
        moved: ObjectReports, left_out: ObjectReports,
    ) -> HonestExamples:  # fmt: skip
        """Return the examples of one time.

        Args:
            reports: of honest agents, about all that is reported.
            is_object: (J,) bool, true objects.
            objects: of the same agents, about all true objects.
            elsewhere: places without any report, each as if one agent reported it (``seen``).
            moved: boxes of detections that were moved, as if reported there.
            left_out: the reports without some that are left out from some time on; nobody is ``able`` about the others.
        """
        reporters, deniers = reports.others()
        columns, count = reported_columns(reports)
        columns = np.concatenate([columns, count + others_column(reporters, deniers)[..., None]], axis=-1)
        judged = (reports.able | reports.seen) & (reporters > 0)
        places, reporter_count = _summed(*place_columns(reports), reports.silent_now), reports.seen.sum(axis=1)
        own = own_box_columns(reports)
        made_up = own_box_columns(elsewhere)[0][elsewhere.seen]
        made_up_places = _summed(*place_columns(elsewhere), elsewhere.silent_now)
        alone = reporter_count == 1
        silences = []
        for own_view in (True, False):
            honest, other = (withheld_columns(each, own_view=own_view) for each in (reports, left_out))
            pair = ((honest, reports.withheld), (other, left_out.withheld))
            silences.append(_contrasted(*(counted(columns[chosen], size) for (columns, size), chosen in pair)))
        is_known = (reports.able | reports.seen) & (reports.before >= KNOWN) & (reporters > 0)
        return cls(
            _labeled(np.stack(objects.bins, axis=-1)[objects.able], objects.seen[objects.able]),
            _labeled(counted(columns[judged], _counts()["reported"]), reports.seen[judged]),
            _contrasted(places[alone], made_up_places),
            _contrasted(places[reporter_count > 1], made_up_places),
            _contrasted(*(counted(rows, own[1]) for rows in (own[0][reports.seen & alone[:, None]], made_up))),
            _labeled(np.concatenate([places, _summed(*own, reports.seen)], axis=1), is_object),
            _contrasted(
                *(counted(rows, own[1]) for rows in (own[0][reports.seen], own_box_columns(moved)[0][moved.seen]))
            ),
            silences[0],
            silences[1],
            (~reports.seen[is_known][:, None]).astype(np.uint8),
        )


def fit_honest(examples: Sequence[HonestExamples], views: Surprises) -> HonestModel:
    """Return the model fitted on many scenes.

    Raises:
        ValueError: there are too few.
    """
    rows = {each.name: np.concatenate([getattr(one, each.name) for one in examples]) for each in fields(HonestExamples)}
    found = fit_shares(tuple(rows["found"][:, :-1].T), rows["found"][:, -1])
    fitted = {}
    for name in _counts():
        counts, label = rows[name][:, :-1], rows[name][:, -1]
        # The number of made-up rows is arbitrary, so both classes get the same weight.
        fitted[name] = Weights.fit(counts, label, None if name in ("reported", "real") else evenly(label))
    # Honest silence is rare, silence about withheld objects certain: add the log of their ratio.
    log_ratio = -float(np.log(rows["silent"].mean()))
    for name in ("withheld", "withheld_forged"):
        fitted[name] = replace(fitted[name], bias=fitted[name].bias + log_ratio)
    return HonestModel(found, views=views, **fitted)


def withholding(reports: ObjectReports, ratio: F64) -> F64:
    """Return the log-ratio (A,) that each agent withholds some of the objects that it knows over that it is honest.

    ``ratio`` (J, A) is the result of :meth:`HonestModel.withheld_ratio` for the reports.
    """
    share = np.array(WITHHELD_SHARES)[:, None, None]
    # A reported object is not withheld; an object that is not reported may or may not be.
    silent = np.logaddexp(np.log1p(-share), np.log(share) + ratio)
    is_known = reports.seen & (reports.before >= KNOWN)
    log_ratios = np.where(reports.withheld, silent, np.where(is_known, np.log1p(-share), 0.0))
    out: F64 = np.logaddexp.reduce(log_ratios.sum(axis=1), axis=0) - np.log(len(share))
    return out


def _contrasted(honest: NDArray[Any], other: NDArray[Any]) -> Rows:
    """Return labeled counts (N, W + 1) of honest rows (label 0) and of other rows (label 1)."""
    return _labeled(np.concatenate([honest, other]), np.repeat([0, 1], [len(honest), len(other)]))


def _labeled(counts: NDArray[Any], label: NDArray[Any]) -> Rows:
    return np.column_stack([counts, np.asarray(label, np.uint8)]).astype(np.uint8)


@lru_cache(maxsize=1)
def _counts() -> dict[str, int]:
    """Return the number of columns of each set of weights."""
    nothing = ObjectReports(
        *(np.zeros((0, 1), np.bool_),) * 2, *(np.zeros((0, 1)),) * 2, np.zeros(1, np.int64), np.zeros(0),
        *(np.zeros((0, 1, len(BoxCells._fields))),) * 2, np.zeros((0, 1)), *(np.zeros((0, 1), np.int64),) * 2,
        *(np.zeros((0, 1)),) * 2,
    )  # fmt: skip
    place, own = place_columns(nothing)[1], own_box_columns(nothing)[1]
    reported = reported_columns(nothing)[1] + (MAX_OTHERS + 1) * (MAX_DENIERS + 1)
    withheld, forged = (withheld_columns(nothing, own_view=own_view)[1] for own_view in (True, False))
    return {
        "reported": reported, "alone": place, "shared": place, "invented": own, "real": place + own, "displaced": own,
        "withheld": withheld, "withheld_forged": forged,
    }  # fmt: skip
