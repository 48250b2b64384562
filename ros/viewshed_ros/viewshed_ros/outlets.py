"""State of a sensor while the node is configured: its topics, whose stale messages are replaced, and its frame."""

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

MAX_PERIOD_S = 1.5
"""Maximum interval that counts as the period of a sensor; longer ones are gaps."""

FRAME_CLOUDS, FRAME_S = 5, 2.0
"""The frame of a sensor is the majority over at least this many clouds and this time."""

MAX_CLOUDS = 1000
"""Maximum number of clouds whose frames are remembered."""


@dataclass(slots=True)
class Outlet:
    """A topic whose last message is replaced by a stop message when it is too old; thread-safe."""

    publisher: Any  # of the topic
    # makes the stop message; None if an old message is harmless
    stop: Callable[[], Any] | None = None
    # steady time at which the data of the last message arrived; None while there is nothing to replace
    seen_s: float | None = None
    is_stop: bool = False  # whether the last message is a stop message
    is_open: bool = True  # whether messages of answers are published
    _lock: Lock = field(default_factory=Lock, repr=False)

    def publish(self, make: Callable[[], Any], seen_s: float, *, always: bool = False) -> None:
        """Make and publish a message about data that arrived at ``seen_s``, if there are subscribers or ``always``."""
        with self._lock:
            if self.is_open and (always or self.publisher.get_subscription_count()):
                self.publisher.publish(make())
                self.seen_s, self.is_stop = seen_s, False

    def stop_if_older(self, limit_s: float, now_s: float) -> None:
        """Publish the stop message if the last message is older than a limit; repeat it while there are subscribers.

        Without subscribers once is enough, because late ones receive the last message.
        """
        if self.stop is None:
            return
        with self._lock:
            is_old = self.seen_s is not None and now_s - self.seen_s > limit_s
            if is_old and not (self.is_stop and not self.publisher.get_subscription_count()):
                self.publisher.publish(self.stop())
                self.seen_s, self.is_stop = now_s, True

    def close(self, now_s: float) -> None:
        """Publish a stop message if anything was published, and no messages of answers after that."""
        with self._lock:
            self.is_open = False
        self.stop_if_older(-1.0, now_s)


@dataclass(slots=True)
class Pace:
    """Period of events: the median of the last intervals."""

    _last_s: float = -MAX_PERIOD_S
    _intervals: deque[float] = field(default_factory=lambda: deque(maxlen=5))

    def note(self, now_s: float) -> None:
        """Note an event."""
        interval_s, self._last_s = now_s - self._last_s, now_s
        if interval_s <= MAX_PERIOD_S:
            self._intervals.append(interval_s)

    def period_s(self) -> float:
        """Return the period in seconds; 0 while it is unknown."""
        return statistics.median(self._intervals) if self._intervals else 0.0


@dataclass(slots=True)
class FrameVote:
    """The frame of a sensor's clouds: a given one, or the majority over the last 2 s and at least five clouds.

    Before five clouds have come it is the frame of the first.
    """

    given: str = ""
    frame: str = ""
    _votes: deque[tuple[float, str]] = field(default_factory=lambda: deque(maxlen=MAX_CLOUDS))

    def add(self, frame: str, now_s: float) -> None:
        """Count the frame of a cloud."""
        self._votes.append((now_s, frame))
        while len(self._votes) > FRAME_CLOUDS and now_s - self._votes[0][0] > FRAME_S:
            self._votes.popleft()
        if self.given or not self.frame:
            self.frame = self.given or frame
        elif len(self._votes) >= FRAME_CLOUDS:
            winner, count = Counter(vote for _, vote in self._votes).most_common(1)[0]
            self.frame = winner if 2 * count > len(self._votes) else self.frame

    def check(self, frame: str) -> None:
        """Raise a ValueError for a cloud in another frame."""
        if not frame:
            raise ValueError("header.frame_id must name the sensor's frame, got none; let the driver name it")
        if frame != self.frame:
            why = "as its parameter says" if self.given else f"like most of the last {FRAME_S:g} s"
            raise ValueError(
                f"a cloud must be in frame {self.frame!r} {why}, got {frame!r}; let one driver publish, or set frame"
            )


@dataclass(slots=True)
class Sensor:
    """State of a sensor while the node is configured."""

    settings: SensorSettings
    outlets: dict[str, Outlet]  # by topic
    heartbeat: Any  # publisher of the heartbeat for the watchdog
    frames: FrameVote
    counts: SensorCounts = field(default_factory=SensorCounts)
    pace: Pace = field(default_factory=Pace)
    area: MapMetaData = field(default_factory=everywhere)  # of its masks at the last pose; the whole map before
    # steady arrival time of the newest sweep that was answered completely, including its pose if poses are used
    newest_s: float | None = None
    last_view: PosedEstimate | None = None
    subscription: Any = None
    _arrivals: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=64))

    def arrived(self, t_ns: int, now_s: float) -> None:
        """Note when a sweep was put in, by its time stamp."""
        self.pace.note(now_s)
        self._arrivals.append((t_ns, now_s))

    def arrival_s(self, t_ns: int | None, otherwise_s: float) -> float:
        """Return the steady time at which the sweep with a time stamp was put in, or ``otherwise_s``."""
        arrivals = tuple(self._arrivals)  # a copy, because another thread adds to them
        return next((at_s for stamp_ns, at_s in reversed(arrivals) if stamp_ns == t_ns), otherwise_s)
