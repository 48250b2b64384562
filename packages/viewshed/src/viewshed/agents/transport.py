"""Transport of messages between agents by zenoh.

A transport carries bytes and verifies nothing: give what arrives to a :class:`viewshed.agents.receiver.Receiver`.
"""

from __future__ import annotations

import json
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from viewshed._extras import needed_for
from viewshed.agents.signing import require_private
from viewshed.agents.view_message import MAX_BYTES, require_name

QUEUE = 256
"""Capacity of the queue of received messages; the oldest are dropped."""


@dataclass(frozen=True, slots=True)
class Delivery:
    """One received message."""

    data: bytes  # bytes as received, not verified
    at_ns: int  # arrival time: the clock value given to :meth:`ZenohTransport.take`
    link: str = ""  # peer that delivered it; empty if the transport does not know it for sure


@dataclass(frozen=True, slots=True)
class Tls:
    """Certificate files for TLS links, in PEM."""

    authority: Path  # certificate authority to trust
    certificate: Path  # own certificate
    key: Path  # private key of the own certificate, which only its owner may read or write


class ZenohTransport:
    """Publish/subscribe by zenoh: each agent publishes under its name and subscribes to all names.

    ``link`` stays empty, because zenoh does not authenticate who publishes under a name. Agents connect by the given
    endpoints, and discover each other by multicast only with ``multicast``.

    Args:
        name: of the agent.
        topic: prefix of the key under which messages are published, for example ``viewshed/views``.
        connect: endpoints to connect to, for example ``tcp/10.0.0.2:7447`` or ``tls/mast:7447``.
        listen: endpoints to listen at.
        multicast: discover others by multicast.
        tls: certificates, for endpoints that begin with ``tls``; both sides must present theirs.

    Raises:
        ImportError: eclipse-zenoh is not installed.
        ValueError: the name or the topic is invalid, or users other than its owner may access the private key.
        OSError: the private key cannot be read, or zenoh cannot open a session with these endpoints.
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
            # Drop what cannot be sent at once: it would be out of date later.
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
        """Queue a received message. Called from a zenoh thread; appending to a deque needs no lock."""
        is_too_large = len(sample.payload) > MAX_BYTES
        self.dropped += is_too_large or len(self._waiting) == QUEUE
        if not is_too_large:
            self._waiting.append(sample.payload.to_bytes())

    def send(self, data: bytes, now_ns: int) -> None:
        """Publish bytes; ``now_ns`` is not used."""
        self._publisher.put(data)

    def take(self, now_ns: int) -> list[Delivery]:
        """Return all messages received since the last call, in order of arrival."""
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
        settings["transport/link/tls"] = {
            "root_ca_certificate": str(tls.authority), "enable_mtls": True,
            **dict.fromkeys(("listen_certificate", "connect_certificate"), str(tls.certificate)),
            **dict.fromkeys(("listen_private_key", "connect_private_key"), str(tls.key)),
        }  # fmt: skip
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config
