"""How messages get from agent to agent: within a process with the faults of a radio, or by zenoh over a network.

A transport carries bytes and believes nothing. What arrives goes to a :class:`viewshed.agents.receiver.Receiver`.
"""

from __future__ import annotations

import heapq
import json
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from viewshed._extras import needed_for
from viewshed.agents.signing import require_private
from viewshed.agents.view_message import MAX_BYTES, require_name

QUEUE = 256
"""Messages that wait to be taken; the oldest give way."""

_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Delivery:
    """Bytes that arrived."""

    data: bytes  # as they were sent, if nobody changed them
    at_ns: int  # when they arrived, nanoseconds of the clock that :meth:`Transport.take` was given
    link: str = ""  # who brought them, empty where the transport does not know for sure


class Transport(Protocol):
    """Sends to all others, and gives what has arrived."""

    def send(self, data: bytes, now_ns: int) -> None:
        """Send bytes to all others."""
        ...

    def take(self, now_ns: int) -> list[Delivery]:
        """Return what has arrived until now, in the order of arrival, each once."""
        ...

    def close(self) -> None:
        """Send and receive no more."""
        ...


@dataclass(frozen=True, slots=True)
class RadioFaults:
    """What a radio does to messages, to each copy on its own."""

    loss: float = 0.0  # probability in [0, 1] that a copy does not arrive
    delay_s: float = 0.0  # least time on the way
    jitter_s: float = 0.0  # mean of the exponential time that comes on top; copies overtake each other
    doubled: float = 0.0  # probability that a copy arrives twice, each at its own time
    reordered: float = 0.0  # probability that a copy is held up by ``reordered_s`` more
    reordered_s: float = 0.1  # by how much

    def __post_init__(self) -> None:
        for name in ("loss", "doubled", "reordered"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name} must lie in [0, 1], got {getattr(self, name)}")
        for name in ("delay_s", "jitter_s", "reordered_s"):
            if not 0.0 <= getattr(self, name) < float("inf"):
                raise ValueError(f"{name} must be finite and not negative, got {getattr(self, name)}")


class Radio:
    """A medium within the process that several agents share; time is what they say it is.

    >>> radio = Radio(np.random.default_rng(0), RadioFaults(delay_s=0.1))
    >>> car, mast = radio.join("car"), radio.join("mast")
    >>> car.send(b"hello", now_ns=0)
    >>> mast.take(now_ns=50_000_000), mast.take(now_ns=100_000_000)[0].data
    ([], b'hello')
    """

    def __init__(self, rng: np.random.Generator, faults: RadioFaults | None = None) -> None:
        self.faults = RadioFaults() if faults is None else faults
        self._rng = rng
        self._ends: dict[str, RadioEnd] = {}
        self._sent = 0

    def join(self, name: str) -> RadioEnd:
        """Return a new end of the medium.

        Raises:
            ValueError: the name is taken.
        """
        require_name("an end of a radio", name)
        if name in self._ends:
            raise ValueError(f"an end of a radio must have a name of its own, got {name!r} again")
        self._ends[name] = RadioEnd(self, name)
        return self._ends[name]

    def _spread(self, sender: str, data: bytes, now_ns: int) -> None:
        for name, end in self._ends.items():
            if name != sender:
                for _ in range(1 + int(self._rng.random() < self.faults.doubled)):
                    self._carry(end, data, now_ns, sender)

    def _carry(self, end: RadioEnd, data: bytes, now_ns: int, sender: str) -> None:
        # The same draws whatever the faults are, so that one fault does not change what others hit.
        lost, held, wait = self._rng.random(), self._rng.random(), self._rng.exponential()
        if lost < self.faults.loss:
            return
        late_s = self.faults.delay_s + self.faults.jitter_s * wait
        late_s += self.faults.reordered_s * (held < self.faults.reordered)
        self._sent += 1
        end.push(now_ns + round(late_s * _NS), self._sent, data, sender)

    def _leave(self, name: str) -> None:
        self._ends.pop(name, None)


@dataclass(slots=True, eq=False)
class RadioEnd:
    """One agent's end of a :class:`Radio`."""

    radio: Radio
    name: str
    dropped: int = 0
    _waiting: list[tuple[int, int, bytes, str]] = field(default_factory=list)

    def send(self, data: bytes, now_ns: int) -> None:
        """Send bytes to all other ends."""
        self.radio._spread(self.name, data, now_ns)

    def push(self, at_ns: int, number: int, data: bytes, sender: str) -> None:
        """Let bytes arrive at a time."""
        heapq.heappush(self._waiting, (at_ns, number, data, sender))
        if len(self._waiting) > QUEUE:
            heapq.heappop(self._waiting)
            self.dropped += 1

    def take(self, now_ns: int) -> list[Delivery]:
        """Return what has arrived until now, in the order of arrival."""
        found = []
        while self._waiting and self._waiting[0][0] <= now_ns:
            at_ns, _, data, sender = heapq.heappop(self._waiting)
            found.append(Delivery(data, at_ns, sender))
        return found

    def close(self) -> None:
        """Leave the medium."""
        self.radio._leave(self.name)
        self._waiting.clear()


@dataclass(frozen=True, slots=True)
class Tls:
    """Certificates for links by TLS, as files in PEM."""

    authority: Path  # of whom certificates are believed
    certificate: Path  # our own
    key: Path  # the private key of our own certificate, which only its owner may read or write


class ZenohTransport:
    """Sends by zenoh: each agent publishes under its name, and subscribes to all names.

    Links are not reported: who publishes under which name is not known for sure. Agents find each other by multicast
    only where ``multicast`` says so; otherwise by the endpoints that are given.

    Args:
        name: of the agent.
        topic: what messages are published under, for example ``viewshed/views``.
        connect: endpoints to connect to, for example ``tcp/10.0.0.2:7447`` or ``tls/mast:7447``.
        listen: endpoints to listen at.
        multicast: look for others by multicast.
        tls: certificates, for endpoints that begin with ``tls``; both sides must show theirs.

    Raises:
        ImportError: eclipse-zenoh is not installed.
        ValueError: the name or the topic is none, or others than its owner may read or write the private key.
        OSError: the private key cannot be read, or zenoh could not open a session with these endpoints.
    """

    def __init__(
        self,
        name: str,
        topic: str = "viewshed/views",
        connect: tuple[str, ...] = (),
        listen: tuple[str, ...] = (),
        *,
        multicast: bool = False,
        tls: Tls | None = None,
    ) -> None:
        require_name("agent", name)
        for part in topic.split("/"):
            require_name("each part of a topic", part)
        if tls is not None:
            require_private(tls.key)
        with needed_for("sending by zenoh"):
            import zenoh
        self.dropped = 0
        self._waiting: deque[bytes] = deque(maxlen=QUEUE)
        try:
            self._session = zenoh.open(_zenoh_config(zenoh, connect, listen, multicast, tls))
            # What cannot be sent at once is old by the time it could: it gives way.
            self._publisher = self._session.declare_publisher(
                f"{topic}/{name}",
                congestion_control=zenoh.CongestionControl.DROP,
                allowed_destination=zenoh.Locality.REMOTE,
            )
            self._subscriber = self._session.declare_subscriber(
                f"{topic}/*", self._arrive, allowed_origin=zenoh.Locality.REMOTE
            )
        except zenoh.ZError as error:
            raise OSError(f"zenoh: {error}") from error

    def _arrive(self, sample: Any) -> None:
        """Keep what arrived; zenoh calls this from a thread of its own, and a deque takes it without a lock."""
        is_too_large = len(sample.payload) > MAX_BYTES
        self.dropped += is_too_large or len(self._waiting) == QUEUE
        if not is_too_large:
            self._waiting.append(sample.payload.to_bytes())

    def send(self, data: bytes, now_ns: int) -> None:
        """Publish bytes; when it is now does not matter."""
        self._publisher.put(data)

    def take(self, now_ns: int) -> list[Delivery]:
        """Return what has arrived, in the order of arrival."""
        return [Delivery(self._waiting.popleft(), now_ns) for _ in range(len(self._waiting))]

    def close(self) -> None:
        """Close the session."""
        self._session.close()


def _zenoh_config(
    zenoh: Any, connect: tuple[str, ...], listen: tuple[str, ...], multicast: bool, tls: Tls | None
) -> Any:
    settings: dict[str, Any] = {
        "mode": "peer",
        "connect/endpoints": list(connect),
        "listen/endpoints": list(listen),
        "scouting/multicast/enabled": multicast,
    }
    if tls is not None:
        settings["transport/link/tls"] = _tls_settings(tls)
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config


def _tls_settings(tls: Tls) -> Mapping[str, Any]:
    return {
        "root_ca_certificate": str(tls.authority),
        "listen_certificate": str(tls.certificate),
        "listen_private_key": str(tls.key),
        "connect_certificate": str(tls.certificate),
        "connect_private_key": str(tls.key),
        "enable_mtls": True,
    }
