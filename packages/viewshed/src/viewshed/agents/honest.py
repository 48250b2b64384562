"""What honest agents report, and what they do not: likelihoods from scenes in which nobody lies.

Detectors miss cars, find hedges, and put centers half a meter off. So that one agent reports what another does not is
no contradiction by itself; it is one where an honest agent would hardly ever do so. There are five questions, each
answered by weights of bins that add up (logistic regression):

- *reported*: others report an object; would an honest agent with this view report it as well? What counts: how many
  report it and how many see the place and are silent, what the agent's view claims before and in the box, range, size,
  its next own detection, and whether it reported the object before.
- *invented*: only one agent reports an object; does its view look as at objects that honest agents alone report, or as
  at any place of that range?
- *contradicted*: the same of the views of all others. The two are apart, for an agent that lies may forge its own view.
- *displaced*: does the box of a report lie on the surfaces of the agent's own view, or as boxes do that were moved?
- *there*: given who reports an object and who does not, is it one?

No lie is needed to fit them: what is put elsewhere, or moved, is an honest box put elsewhere.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from viewshed.agents.view_checks import HEIGHTS
from viewshed.arrays import F64, Mask
from viewshed.objects.cells import BoxCells

Columns = NDArray[np.int32]

LEAST_SEEN, SEEN_AT_0_M, SEEN_PER_M = 0.5, 0.43, 0.008
"""From these probabilities of visible on an agent is expected to see an object: at least, by a line in range.

Claims err with the range. In the first set of scenes of docs/results/agents.md nine in ten objects that are claimed
with .5 or more are expected so, and .011 of them gave fewer than five returns. The best table by range, height and
probability, chosen on these very scenes, would reach .010.
"""

MOST_BEFORE = 3
"""Most earlier reports of an object that are counted; more say no more."""

NO_DETECTION_M = 99.0
"""Distance to the next detection of an agent that has none."""

_COLUMNS = {name: column for column, name in enumerate(BoxCells._fields)}
"""Where each measure of cells is."""

_BOUNDS: dict[str, tuple[float, ...]] = {
    "visible": (0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98),
    "range_m": (6.0, 10.0, 15.0, 25.0, 35.0, 43.0),
    "size_m": (1.3, 2.4, 6.0),
    "apart_m": (1.5, 2.5, 3.5, 5.0, 8.0),
    "surface": (0.001, 0.03, 0.08, 0.15, 0.25, 0.4),
    "free": (0.05, 0.15, 0.3, 0.5, 0.7, 0.9),
    "hidden": (0.05, 0.2, 0.5, 0.8, 0.95),
    "ring": (0.001, 0.03, 0.08, 0.15, 0.3),
    "ring_free": (0.2, 0.4, 0.6, 0.8, 0.95),
    "near_free": (0.05, 0.2, 0.4, 0.7, 0.95),
    "first_m": (0.3, 0.8, 1.5, 3.0, 9.0),
}
"""Bounds of the bins of each measure."""

MOST_OTHERS, MOST_DENIERS = 4, 2
"""More agents that report an object, or see its place and are silent, are as good as these."""

_RIDGE = 3.0
"""Prior of the weights: bins that are rarely seen stay near 0."""

_STEPS = 15

_FILE = "honest.json"

_CONTRASTS = ("invented", "contradicted", "displaced")
"""Questions whose examples of one class are made up, as many as one likes: both classes weigh the same."""


@dataclass(frozen=True, slots=True, eq=False)
class ObjectReports:
    """What A agents say of J objects at one time, and what their views claim there.

    Attributes:
        seen: (J, A) bool, who reports the object.
        able: (J, A) bool, who could: it speaks now, the object is near enough and is not its own vehicle.
        visible: (J, A) probability that the object could be seen, as the agent claims.
        range_m: (J, A) from the agent's sensor.
        height: (A,) where its sensor is: 0 among the traffic, 1 above it, 2 on a tall mast.
        size_m: (J,) longer side of the object.
        cells: (J, A, 8) ``BoxCells`` of the object's box in the agent's view.
        own_cells: (J, A, 8) the same of the agent's own box; 0 where it reports none.
        apart_m: (J, A) from the object to the agent's next detection of another object.
        before: (J, A) how often the agent reported the object before.
        existence: (J,) of the object's track.
    """

    seen: Mask
    able: Mask
    visible: F64
    range_m: F64
    height: NDArray[np.int64]
    size_m: F64
    cells: F64
    own_cells: F64
    apart_m: F64
    before: NDArray[np.int64]
    existence: F64

    @property
    def sees(self) -> Mask:
        """(J, A) bool, who could report the object and claims to see it."""
        return self.able & is_expected(self.visible, self.range_m)

    def others(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return how many others report each object, and how many deny it: (J, A) each."""
        reporters, deniers = self.seen.astype(np.int64), (self.sees & ~self.seen).astype(np.int64)
        return reporters.sum(axis=1, keepdims=True) - reporters, deniers.sum(axis=1, keepdims=True) - deniers

    def take(self, chosen: Mask) -> Self:
        """Return some of the objects, by a mask (J,)."""
        arrays = (getattr(self, name) if name == "height" else getattr(self, name)[chosen] for name in self.__slots__)
        return type(self)(*arrays)


def is_expected(visible: F64, range_m: F64) -> Mask:
    """Return whether an honest agent that claims visibility (…,) at ranges (…,) sees an object; its silence denies it.

    >>> is_expected(np.array([0.6, 0.6]), np.array([10.0, 40.0])).tolist()
    [True, False]
    """
    return np.asarray(visible >= np.maximum(LEAST_SEEN, SEEN_AT_0_M + SEEN_PER_M * range_m))


class _Bins:
    """Columns of features: each is a bin of one measure or of several together."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.shape, self.size = shape, 0
        self._columns: list[NDArray[Any]] = []

    def add(self, *codes: tuple[NDArray[Any], int]) -> None:
        """Add a feature: the bins of measures together, each with their number."""
        code: NDArray[Any] = np.zeros(self.shape, np.int32)
        count = 1
        for bins, of in codes:
            code, count = code * of + bins, count * of
        self._columns.append(code + self.size)
        self.size += count

    def columns(self) -> Columns:
        """Return the columns (…, F) of all features."""
        return np.stack(self._columns, axis=-1).astype(np.int32)


def _bin(name: str, values: F64) -> tuple[NDArray[np.intp], int]:
    bounds = _BOUNDS[name]
    return np.searchsorted(np.array(bounds), values, side="right"), len(bounds) + 1


def _add_cells(bins: _Bins, cells: F64, range_m: F64, size_m: F64, height: NDArray[np.int64]) -> None:
    """Add what the cells of a view say of a box."""
    surface, free = _bin("surface", cells[..., _COLUMNS["surface"]]), _bin("free", cells[..., _COLUMNS["free"]])
    ranges = _bin("range_m", range_m)
    kind = (np.broadcast_to(height, range_m.shape).astype(np.int32), HEIGHTS)
    bins.add(ranges, _bin("size_m", np.broadcast_to(size_m[:, None], range_m.shape)), kind)
    bins.add(surface, kind)
    bins.add(ranges, surface)
    bins.add(surface, free)
    for name in ("hidden", "ring", "near_free", "first_m", "ring_free"):
        bins.add(_bin(name, cells[..., _COLUMNS[name]]))


def reported_columns(reports: ObjectReports) -> tuple[Columns, int]:
    """Return the columns (J, A, F) of *reported*, without the numbers of others, and how many columns there are."""
    bins = _Bins(reports.seen.shape)
    _add_cells(bins, reports.cells, reports.range_m, reports.size_m, reports.height)
    kind = (np.broadcast_to(reports.height, reports.seen.shape).astype(np.int32), HEIGHTS)
    bins.add(_bin("visible", reports.visible), _bin("surface", reports.cells[..., _COLUMNS["surface"]]))
    bins.add((np.minimum(reports.before, MOST_BEFORE), MOST_BEFORE + 1), kind)
    bins.add(
        _bin("apart_m", reports.apart_m), _bin("size_m", np.broadcast_to(reports.size_m[:, None], reports.seen.shape))
    )
    return bins.columns(), bins.size


def others_column(reporters: NDArray[Any], deniers: NDArray[Any]) -> NDArray[Any]:
    """Return the column for the numbers of others that report an object and that deny it."""
    column: NDArray[Any] = np.minimum(reporters, MOST_OTHERS) * (MOST_DENIERS + 1) + np.minimum(deniers, MOST_DENIERS)
    return column


def own_box_columns(reports: ObjectReports) -> tuple[Columns, int]:
    """Return the columns (J, A, F) of *invented* and *displaced*: what the agent's own view says of its own box."""
    bins = _Bins(reports.seen.shape)
    _add_cells(bins, reports.own_cells, reports.range_m, reports.size_m, reports.height)
    return bins.columns(), bins.size


def contradicted_columns(reports: ObjectReports) -> tuple[Columns, int]:
    """Return the columns (J, A, F) of *contradicted*: what the views of others show where they claim to see."""
    bins = _Bins(reports.seen.shape)
    others = ~np.eye(reports.seen.shape[1], dtype=np.bool_)[None] & reports.sees[:, None]
    count = others.sum(axis=2)
    bins.add((np.minimum(count, 3), 4))
    for name in ("free", "surface", "near_free"):
        most = np.where(others, reports.cells[:, None, :, _COLUMNS[name]], 0.0).max(axis=2, initial=0.0)
        binned, size = _bin(name, most)
        bins.add((np.where(count > 0, 1 + binned, 0), size + 1))
    return bins.columns(), bins.size


def there_columns(reports: ObjectReports) -> tuple[Columns, int, Columns]:
    """Return the columns (J, A, F) of *there* for each agent, how many there are, and those (J, F') of the object.

    Those of agents that could not report the object are -1.
    """
    bins, seen = _Bins(reports.seen.shape), (reports.seen.astype(np.int32), 2)
    size = _bin("size_m", np.broadcast_to(reports.size_m[:, None], reports.seen.shape))
    kind = (np.broadcast_to(reports.height, reports.seen.shape).astype(np.int32), HEIGHTS)
    bins.add(seen, _bin("visible", reports.visible), kind)
    bins.add(seen, _bin("surface", reports.cells[..., _COLUMNS["surface"]]))
    bins.add(seen, _bin("range_m", reports.range_m), size)
    bins.add(seen, (np.minimum(reports.before, MOST_BEFORE), MOST_BEFORE + 1))
    bins.add(seen, _bin("near_free", reports.cells[..., _COLUMNS["near_free"]]))
    of_agents = np.where((reports.able | reports.seen)[..., None], bins.columns(), -1).astype(np.int32)
    count = bins.size
    whole = _Bins(reports.size_m.shape)
    whole.size = count
    whole.add(_bin("size_m", reports.size_m))
    whole.add((np.searchsorted([0.2, 0.5, 0.8, 0.95], reports.existence), 5))
    return of_agents, whole.size, whole.columns()


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """Log-odds that add up.

    Attributes:
        of_bins: (W,) weights.
        bias: that is always added.
    """

    of_bins: F64
    bias: float

    def __call__(self, columns: Columns) -> F64:
        """Return the log-odds (…,) of features with columns (…, F); columns of -1 add nothing."""
        padded = np.append(self.of_bins, 0.0)
        total: F64 = padded[columns].sum(axis=-1) + self.bias
        return total

    @classmethod
    def fit(cls, columns: Columns, count: int, label: NDArray[Any], share: F64 | None = None) -> Self:
        """Return the weights of N rows of columns (N, F) out of ``count``, by logistic regression with a ridge.

        Args:
            columns: -1 is no column.
            count: of all columns.
            label: (N,) bool.
            share: (N,) weights of the rows; None is 1 each.

        Raises:
            ValueError: there is no row of one of the classes.
        """
        label, rows = np.asarray(label, np.float64), np.asarray(columns)
        if not 0 < label.sum() < len(label):
            raise ValueError(f"rows must be of both classes, got {int(label.sum())} of {len(label)} of one")
        share = np.ones(len(label)) if share is None else share
        # A further column is that of the bias, the one after it stands for no column.
        rows = np.column_stack([np.where(rows < 0, count + 1, rows), np.full(len(rows), count)])
        size = count + 2
        ridge = np.full(size, _RIDGE)
        ridge[count], ridge[count + 1] = 1e-6, 1e12
        weights = np.zeros(size)
        for _ in range(_STEPS):
            prob = 1.0 / (1.0 + np.exp(-weights[rows].sum(axis=1)))
            error, worth = share * (label - prob), share * prob * (1.0 - prob)
            slope, curve = -ridge * weights, np.zeros(size * size)
            for place, one in enumerate(rows.T):
                slope += np.bincount(one, error, size)
                # Newton's matrix of one-hot rows: how often two columns occur together.
                for other in rows.T[place:]:
                    pair = np.bincount(one * size + other, worth, size * size).reshape(size, size)
                    curve += (pair if other is one else pair + pair.T).ravel()
            weights = weights + np.linalg.solve(curve.reshape(size, size) + np.diag(ridge), slope)
        return cls(weights[:count], float(weights[count]))


@dataclass(frozen=True, slots=True, eq=False)
class HonestModel:
    """What honest agents report; see the module.

    Attributes:
        reported: log-odds that an agent reports what others report; the last columns are those of the others.
        invented: log-ratio of places elsewhere over what honest agents alone report, in their own views.
        contradicted: the same in the views of others.
        displaced: log-ratio of boxes that were moved over honest ones.
        there: log-odds that an object is one.
    """

    reported: Weights
    invented: Weights
    contradicted: Weights
    displaced: Weights
    there: Weights

    @classmethod
    def blank(cls) -> Self:
        """Return a model that knows nothing: all weights are 0."""
        return cls(*(Weights(np.zeros(count), 0.0) for count in _counts().values()))

    @property
    def of_others(self) -> F64:
        """(others, deniers) log-odds that *reported* adds for them."""
        count = (MOST_OTHERS + 1) * (MOST_DENIERS + 1)
        return self.reported.of_bins[-count:].reshape(MOST_OTHERS + 1, MOST_DENIERS + 1)

    def to_json(self) -> str:
        """Return the model as text."""
        table = {
            name: {"of_bins": getattr(self, name).of_bins.round(3).tolist(), "bias": round(getattr(self, name).bias, 3)}
            for name in self.__slots__
        }
        return json.dumps({"bounds": _BOUNDS} | table) + "\n"

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Return the model in a text of :meth:`to_json`.

        Raises:
            ValueError: it has other bins.
        """
        table = json.loads(text)
        if table["bounds"] != {name: list(bounds) for name, bounds in _BOUNDS.items()}:
            raise ValueError("bounds must be those of this version; fit the model again")
        return cls(*(Weights(np.array(table[name]["of_bins"]), float(table[name]["bias"])) for name in cls.__slots__))


@lru_cache(maxsize=1)
def honest_model() -> HonestModel:
    """Return the shipped model, of the default estimate and our detector (docs/results/agents.md)."""
    return HonestModel.from_json(resources.files("viewshed.agents").joinpath(_FILE).read_text("utf-8"))


@dataclass(frozen=True, slots=True, eq=False)
class HonestExamples:
    """Rows that a model is fitted on, of one scene in which nobody lies.

    Attributes:
        reported: columns (N, F + 1) with those of others, then whether the agent reported the object.
        invented: columns (N, F), then whether the place is one elsewhere.
        contradicted: the same.
        displaced: columns (N, F), then whether the box was moved.
        there: columns (N, A F + F'), then whether the track is an object.
    """

    reported: Columns
    invented: Columns
    contradicted: Columns
    displaced: Columns
    there: Columns

    @classmethod
    def of(
        cls, reports: ObjectReports, is_object: Mask, elsewhere: ObjectReports, moved: ObjectReports
    ) -> HonestExamples:
        """Return the examples of one time.

        Args:
            reports: of honest agents, about the objects that somebody reports.
            is_object: (J,) bool, which are objects in truth.
            elsewhere: places at which nobody reports anything, as if each were reported by one agent (``seen``).
            moved: boxes of detections that were moved, as if they were reported there.
        """
        reporters, deniers = reports.others()
        columns, count = reported_columns(reports)
        chosen = reports.able & (reporters > 0)
        reported = np.concatenate([columns, count + others_column(reporters, deniers)[..., None]], axis=-1)
        alone = reports.seen & (reporters == 0)
        of_agents, _, whole = there_columns(reports)
        return cls(
            _labeled(reported[chosen], reports.seen[chosen]),
            _contrasted(own_box_columns, (reports, alone), (elsewhere, elsewhere.seen)),
            _contrasted(contradicted_columns, (reports, alone), (elsewhere, elsewhere.seen)),
            _contrasted(own_box_columns, (reports, reports.seen), (moved, moved.seen)),
            _labeled(np.concatenate([of_agents.reshape(len(whole), -1), whole], axis=1), is_object),
        )  # fmt: skip


def fit_honest(examples: Sequence[HonestExamples]) -> HonestModel:
    """Return the model of many scenes.

    Raises:
        ValueError: there are too few.
    """
    rows = {name: np.concatenate([getattr(one, name) for one in examples]) for name in HonestExamples.__slots__}
    fitted = {}
    for name, count in _counts().items():
        columns, label = rows[name][:, :-1], rows[name][:, -1]
        even = np.where(label == 1, 0.5 / max(label.sum(), 1), 0.5 / max((1 - label).sum(), 1)) * len(label)
        fitted[name] = Weights.fit(columns, count, label, even if name in _CONTRASTS else None)
    return HonestModel(**fitted)


def _contrasted(
    columns_of: Callable[[ObjectReports], tuple[Columns, int]], honest: tuple[ObjectReports, Mask],
    other: tuple[ObjectReports, Mask],
) -> Columns:  # fmt: skip
    """Return the labeled columns (N, F + 1) of some honest reports (label 0) and of some made-up ones (label 1)."""
    rows = (
        _labeled(columns_of(reports)[0][chosen], np.full(int(chosen.sum()), label))
        for label, (reports, chosen) in enumerate((honest, other))
    )
    return np.concatenate(list(rows))


def _labeled(columns: Columns, label: NDArray[Any]) -> Columns:
    return np.column_stack([columns, np.asarray(label, np.int32)]).astype(np.int32)


@lru_cache(maxsize=1)
def _counts() -> dict[str, int]:
    """Return how many columns each question has."""
    nothing = ObjectReports(
        *(np.zeros((0, 1), np.bool_),) * 2, *(np.zeros((0, 1)),) * 2, np.zeros(1, np.int64), np.zeros(0),
        *(np.zeros((0, 1, len(BoxCells._fields))),) * 2, np.zeros((0, 1)), np.zeros((0, 1), np.int64), np.zeros(0),
    )  # fmt: skip
    return {
        "reported": reported_columns(nothing)[1] + (MOST_OTHERS + 1) * (MOST_DENIERS + 1),
        "invented": own_box_columns(nothing)[1],
        "contradicted": contradicted_columns(nothing)[1],
        "displaced": own_box_columns(nothing)[1],
        "there": there_columns(nothing)[1],
    }
