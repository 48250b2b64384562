"""Ouster's packets, one a message, as the revolutions that they are of."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from viewshed.io.messages.packets import sweep_of_ouster
from viewshed.io.ouster_packets import OusterDecoder, read_metadata
from viewshed.sweep import Sweep

_LONGEST_NS = 1_000_000_000
"""Of a revolution; what was gathered before a longer gap is no view of now, and one number for ever fills no memory."""


@dataclass(frozen=True, slots=True)
class Packet:
    """One packet of an Ouster sensor, as ``PacketMsg`` holds it."""

    buf: bytes


@dataclass(frozen=True, slots=True)
class Revolution:
    """The packets of one revolution."""

    packets: tuple[Packet, ...]  # in the order in which they came
    t_ns: int  # when the first one came


@dataclass(slots=True)
class Revolutions:
    """Gathers packets, which come one by one, into revolutions."""

    decoder: OusterDecoder  # of the sensor
    _packets: list[Packet] = field(default_factory=list)
    _begin_ns: int = 0
    _number: int | None = None
    _before: int | None = None

    @classmethod
    def of(cls, metadata: str | Path) -> Revolutions:
        """Return what gathers the packets of the sensor that a file of its metadata describes."""
        return cls(OusterDecoder(read_metadata(Path(metadata))))

    def add(self, data: Any, t_ns: int) -> Revolution | None:
        """Take a packet; return the revolution before where it begins another.

        Args:
            data: its bytes, as the message's array holds them.
            t_ns: when it came.
        """
        packet = Packet(bytes(data))
        if not 0 <= t_ns - self._begin_ns <= _LONGEST_NS:
            self._packets, self._number, self._before = [], None, None
        number = self.decoder.frame_number(packet.buf)
        if number is None:
            size = self.decoder.packet_bytes
            raise ValueError(f"a packet must be a lidar packet of {size} bytes of this sensor, got {len(packet.buf)}")
        if number == self._before:  # late
            return None
        ended = None
        if number != self._number:
            if self._packets:
                ended, self._before = Revolution(tuple(self._packets), self._begin_ns), self._number
            self._packets, self._number, self._begin_ns = [], number, t_ns
        self._packets.append(packet)
        return ended

    def sweep(self, revolution: Revolution) -> Sweep:
        """Return the sweep of a revolution, at the time when it began to come."""
        return sweep_of_ouster(revolution.packets, self.decoder).replace(t_ns=revolution.t_ns)
