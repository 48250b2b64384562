"""A sensor while the node is configured: its topics, none of which lets an old message stand, and its frame."""

from __future__ import annotations

import statistics
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Lock
from typing import Any

from nav_msgs.msg import MapMetaData

from viewshed_ros.layers import PosedEstimate
from viewshed_ros.parameters import SensorSettings
from viewshed_ros.status import SensorCounts
from viewshed_ros.stops import everywhere

LONGEST_PERIOD_S = 1.5
"""Between two sweeps; more is a gap, and not the period of a sensor."""

FRAME_CLOUDS, FRAME_S = 5, 2.0
"""A sensor's frame is that of most clouds of this time, and of at least this number of clouds."""

MOST_CLOUDS = 1000
"""Whose frames are remembered."""


@dataclass(slots=True)
class Outlet:
    """A topic whose last message is replaced by a stop message when it is too old; several threads may publish."""

    publisher: Any  # of the topic
    # makes the stop message; None where an old message claims nothing that could harm
    stop: Callable[[], Any] | None = None
    # steady time at which came in what the last message shows; None while there is nothing to replace
    seen_s: float | None = None
    is_stop: bool = False  # whether the last message is a stop message
    is_open: bool = True  # whether messages of answers are let through
    _lock: Lock = field(default_factory=Lock, repr=False)

    def publish(self, make: Callable[[], Any], seen_s: float, *, always: bool = False) -> None:
        """Make and publish a message of what came in at a time, where somebody listens."""
        with self._lock:
            if self.is_open and (always or self.publisher.get_subscription_count()):
                self.publisher.publish(make())
                self.seen_s, self.is_stop = seen_s, False

    def stop_if_older(self, limit_s: float, now_s: float) -> None:
        """Publish the stop message in place of one that is older than a limit, again and again while it is so.

        Where nobody listens once is enough: who comes late is given it.
        """
        if self.stop is None:
            return
        with self._lock:
            is_old = self.seen_s is not None and now_s - self.seen_s > limit_s
            if is_old and not (self.is_stop and not self.publisher.get_subscription_count()):
                self.publisher.publish(self.stop())
                self.seen_s, self.is_stop = now_s, True

    def close(self, now_s: float) -> None:
        """Let nothing through any more, after a stop message in place of what was published."""
        with self._lock:
            self.is_open = False
        self.stop_if_older(-1.0, now_s)


@dataclass(slots=True)
class Pace:
    """How often something comes: the median of the last intervals."""

    _last_s: float = -LONGEST_PERIOD_S
    _intervals: deque[float] = field(default_factory=lambda: deque(maxlen=5))

    def note(self, now_s: float) -> None:
        """Note that it came."""
        interval_s, self._last_s = now_s - self._last_s, now_s
        if interval_s <= LONGEST_PERIOD_S:
            self._intervals.append(interval_s)

    def period_s(self) -> float:
        """Return the period; 0 while it is not known."""
        return statistics.median(self._intervals) if self._intervals else 0.0


@dataclass(slots=True)
class FrameVote:
    """The frame of a sensor's clouds: a given one, or that of most of the last 2 s, and of five clouds at least.

    Until five have come it is the frame of the first.
    """

    given: str = ""
    frame: str = ""
    _votes: deque[tuple[float, str]] = field(default_factory=lambda: deque(maxlen=MOST_CLOUDS))

    def add(self, frame: str, now_s: float) -> None:
        """Take the frame of a cloud."""
        self._votes.append((now_s, frame))
        while len(self._votes) > FRAME_CLOUDS and now_s - self._votes[0][0] > FRAME_S:
            self._votes.popleft()
        if self.given or not self.frame:
            self.frame = self.given or frame
        elif len(self._votes) >= FRAME_CLOUDS:
            most, count = Counter(each for _, each in self._votes).most_common(1)[0]
            self.frame = most if 2 * count > len(self._votes) else self.frame

    def check(self, frame: str) -> None:
        """Refuse a cloud in another frame."""
        if not frame:
            raise ValueError("header.frame_id must name the sensor's frame, got none; let the driver name it")
        if frame != self.frame:
            why = "as its parameter says" if self.given else f"like most of the last {FRAME_S:g} s"
            raise ValueError(
                f"a cloud must be in frame {self.frame!r} {why}, got {frame!r}; let one driver publish, or set frame"
            )


@dataclass(slots=True)
class Sensor:
    """A sensor while the node is configured."""

    settings: SensorSettings
    outlets: dict[str, Outlet]  # by the names of its topics
    heartbeat: Any  # publisher of what the watchdog listens to
    frames: FrameVote
    counts: SensorCounts = field(default_factory=SensorCounts)
    pace: Pace = field(default_factory=Pace)
    area: MapMetaData = field(default_factory=everywhere)  # where its masks lie, by the last pose; the whole map before
    # steady time at which the newest sweep came that was answered with all that is wanted, its pose too
    newest_s: float | None = None
    last_view: PosedEstimate | None = None
    subscription: Any = None
    _arrivals: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=64))

    def arrived(self, t_ns: int, now_s: float) -> None:
        """Note when the sweep of a time was put in."""
        self.pace.note(now_s)
        self._arrivals.append((t_ns, now_s))

    def arrival_s(self, t_ns: int | None, otherwise_s: float) -> float:
        """Return the steady time at which the sweep of a time was put in."""
        arrivals = tuple(self._arrivals)  # the thread that puts in may add one meanwhile
        return next((at_s for each, at_s in reversed(arrivals) if each == t_ns), otherwise_s)
