"""Collect Ouster packets, one per message, into revolutions."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from viewshed.io.messages.packets import sweep_of_ouster
from viewshed.io.ouster_packets import OusterDecoder, read_metadata
from viewshed.sweep import Sweep

_MAX_REVOLUTION_NS = 1_000_000_000
"""Maximum duration of a revolution; older packets are discarded, so that a repeated frame number fills no memory."""


@dataclass(frozen=True, slots=True)
class Packet:
    """One packet of an Ouster sensor, like ``PacketMsg``."""

    buf: bytes


@dataclass(frozen=True, slots=True)
class Revolution:
    """The packets of one revolution."""

    packets: tuple[Packet, ...]  # in order of arrival
    t_ns: int  # arrival of the first packet


@dataclass(slots=True)
class Revolutions:
    """Collects single packets into revolutions."""

    decoder: OusterDecoder  # of the sensor
    _packets: list[Packet] = field(default_factory=list)
    _begin_ns: int = 0
    _number: int | None = None
    _before: int | None = None

    @classmethod
    def of(cls, metadata: str | Path) -> Revolutions:
        """Return a collector for the sensor described by a metadata file."""
        return cls(OusterDecoder(read_metadata(Path(metadata))))

    def add(self, data: Any, t_ns: int) -> Revolution | None:
        """Add a packet; return the completed revolution if the packet begins a new one.

        Args:
            data: its bytes, an array of the message.
            t_ns: its arrival.
        """
        packet = Packet(bytes(data))
        if not 0 <= t_ns - self._begin_ns <= _MAX_REVOLUTION_NS:
            self._packets, self._number, self._before = [], None, None
        number = self.decoder.frame_number(packet.buf)
        if number is None:
            size = self.decoder.packet_bytes
            raise ValueError(f"a packet must be a lidar packet of {size} bytes of this sensor, got {len(packet.buf)}")
        if number == self._before:  # late
            return None
        completed = None
        if number != self._number:
            if self._packets:
                completed, self._before = Revolution(tuple(self._packets), self._begin_ns), self._number
            self._packets, self._number, self._begin_ns = [], number, t_ns
        self._packets.append(packet)
        return completed

    def sweep(self, revolution: Revolution) -> Sweep:
        """Return the sweep of a revolution, with the arrival of its first packet as time."""
        return sweep_of_ouster(revolution.packets, self.decoder).replace(t_ns=revolution.t_ns)
