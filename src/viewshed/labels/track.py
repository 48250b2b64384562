"""The sweeps of one sensor in time order, and what those around each of them tell about the ground."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from viewshed.labels.ground_map import Lows
from viewshed.labels.labeller import Mask, Rules, label_sweep, lows_of_sweep
from viewshed.labels.motion import Moment, drift_of, posts_of
from viewshed.sweep import Sweep
from viewshed.truth import Truth

R = TypeVar("R")
SPACING = 1 / 20
"""Sweeps that help are at least so far apart, in half sides of the grid: 3.2 m on roads."""
READ_AHEAD = 3
"""How many sweeps are looked at for each one that may help."""


@dataclass(frozen=True, slots=True, eq=False)
class Track(Generic[R]):
    """Sweeps of one sensor, looked through once.

    Attributes:
        sweep_of: reads one.
        refs: in time order.
        rules: how they are labelled.
        moments: where and when each was measured; None where it was not looked at or could not be read.
        lows: of those that help, by their place.
    """

    sweep_of: Callable[[R], Sweep]
    refs: Sequence[R]
    rules: Rules
    moments: Sequence[Moment | None]
    lows: dict[int, Lows]

    @classmethod
    def of(
        cls, sweep_of: Callable[[R], Sweep], refs: Sequence[R], rules: Rules, span: tuple[int, int] | None = None
    ) -> Track[R]:
        """Return the track of ``refs``, looked through as far as the labels of those in ``span`` (all) need it."""
        first, last = (0, len(refs)) if span is None else span
        ahead = READ_AHEAD * rules.neighbors
        moments: list[Moment | None] = [None] * len(refs)
        lows: dict[int, Lows] = {}
        last_post: Moment | None = None
        for place in range(max(first - ahead, 0), min(last + ahead, len(refs))):
            try:
                sweep = sweep_of(refs[place])
            except (ValueError, OSError):  # told when it is labelled
                continue
            moment = Moment(sweep.world_from_sensor, sweep.t_ns)
            moments[place] = moment
            helps = posts_of([last_post, moment], SPACING * rules.grid.half_extent_m)
            if rules.neighbors and helps and helps[-1] == 1:
                lows[place] = lows_of_sweep(sweep, rules)
                last_post = moment
        return cls(sweep_of, refs, rules, moments, lows)

    def label(self, place: int) -> tuple[Truth, Mask]:
        """Return the label of the sweep at ``place``, and where it is trusted.

        Raises:
            ValueError: the sweep is damaged.
            OSError: it cannot be read.
        """
        sweep = self.sweep_of(self.refs[place])
        moment = Moment(sweep.world_from_sensor, sweep.t_ns)
        before = self.moments[place - 1] if place else None
        after = self.moments[place + 1] if place + 1 < len(self.refs) else None
        near = [] if moment.world_from_sensor is None else self._helpers(place)
        drift = drift_of(before, moment, after) if self.rules.neighbors else drift_of(None, moment, None)
        return label_sweep(sweep, drift, near, self.rules)

    def _helpers(self, place: int) -> list[Lows]:
        """Return the lows of the nearest posts before and after ``place``, its own left out."""
        before = [k for k in self.lows if k < place][-self.rules.neighbors :]
        after = [k for k in self.lows if k > place][: self.rules.neighbors]
        return [self.lows[k] for k in (*before, *after)]
