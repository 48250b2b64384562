"""Velodyne packets: a capture (pcap) or concatenated payloads of 1206 bytes, decoded by velodyne-decoder.

Also extracts the UDP payloads of a capture (libpcap's classic format) and reassembles IPv4 fragments.
"""

from __future__ import annotations

import struct
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed._extras import needed_for
from viewshed.geometry import Rigid
from viewshed.io._columns import IDENTITY, Columns
from viewshed.io._input import InputFile
from viewshed.sensors import lidar_model

_MAGICS = {
    b"\xd4\xc3\xb2\xa1": ("<", 1e-6), b"\xa1\xb2\xc3\xd4": (">", 1e-6),
    b"\x4d\x3c\xb2\xa1": ("<", 1e-9), b"\xa1\xb2\x3c\x4d": (">", 1e-9),
}  # fmt: skip

PCAP_BEGINS = tuple(_MAGICS)
"""First bytes of the supported captures."""

_LINK_HEADER_BYTES = {0: 4, 1: 14, 101: 0, 113: 16, 228: 0, 276: 20}

_MAX_OPEN_DATAGRAMS = 64

_MAX_FRAGMENTS = 512

_MAX_DATAGRAM_BYTES = 65_535


@dataclass(slots=True)
class _Datagram:
    """A fragmented datagram: offset → bytes, number of bytes received, and total length once known."""

    parts: dict[int, bytes] = field(default_factory=dict)
    received: int = 0
    length: int | None = None


_UDP = 17


def udp_payloads(content: bytes) -> Iterator[tuple[float, bytes]]:
    """Yield (seconds since 1970, payload) of every UDP datagram of a capture; errors as :func:`_udp_datagrams`."""
    return ((seconds, payload) for seconds, _, payload in _udp_datagrams(content))


def _udp_datagrams(content: bytes) -> Iterator[tuple[float, bytes, bytes]]:
    """Yield (seconds since 1970, sender, payload) of every UDP datagram of a capture, in order.

    The sender is its address of four bytes and the port that it sends to, of two bytes.

    Raises:
        ValueError: it is no capture, has an unsupported link type, or is cut off within a packet.
    """
    if content[:4] not in _MAGICS or len(content) < 24:
        raise ValueError("is not a packet capture or is cut off")
    order, unit = _MAGICS[content[:4]]
    link = struct.unpack_from(order + "I", content, 20)[0] & 0xFFFF
    if link not in _LINK_HEADER_BYTES:
        raise ValueError(f"packet capture must be of Ethernet or raw IP, got link type {link}")
    record = struct.Struct(order + "IIII")
    fragments: dict[bytes, _Datagram] = {}
    offset = 24
    while offset < len(content):
        if offset + 16 > len(content):
            raise ValueError("packet capture is cut off within a packet header")
        seconds, fraction, captured, _ = record.unpack_from(content, offset)
        offset += 16
        if captured > len(content) - offset:
            raise ValueError(f"packet capture is cut off: a packet of {captured} bytes, {len(content) - offset} left")
        datagram = _datagram(content[offset : offset + captured], link, fragments)
        offset += captured
        if datagram is not None:
            yield seconds + fraction * unit, *datagram


def _datagram(packet: bytes, link: int, fragments: dict[bytes, _Datagram]) -> tuple[bytes, bytes] | None:
    """Return sender and payload of the UDP datagram that is, or is completed by, a packet; None if there is none."""
    ip = _ip_packet(packet, link)
    if len(ip) < 20 or ip[0] >> 4 != 4 or ip[9] != _UDP:
        return None
    header, total = 4 * (ip[0] & 15), int.from_bytes(ip[2:4], "big")
    body = ip[header : total if total >= header else None]
    flags = int.from_bytes(ip[6:8], "big")
    if flags & 0x3FFF:
        joined = _reassemble(ip[4:6] + ip[12:20], 8 * (flags & 0x1FFF), body, bool(flags & 0x2000), fragments)
        if joined is None:
            return None
        body = joined
    length = int.from_bytes(body[4:6], "big")
    return (ip[12:16] + body[2:4], body[8:length]) if 8 <= length <= len(body) else None


def _ip_packet(packet: bytes, link: int) -> bytes:
    start = _LINK_HEADER_BYTES[link]
    if link == 1:
        while packet[start - 2 : start] in (b"\x81\x00", b"\x88\xa8"):
            start += 4
        if packet[start - 2 : start] != b"\x08\x00":
            return b""
    return packet[start:]


def _reassemble(key: bytes, offset: int, body: bytes, more: bool, fragments: dict[bytes, _Datagram]) -> bytes | None:
    """Store a fragment; return the datagram once all its bytes are there, None before.

    Fragments are joined only once, so that hostile fragments that never fit cost no more than valid ones.
    """
    if key not in fragments and len(fragments) >= _MAX_OPEN_DATAGRAMS:
        fragments.pop(next(iter(fragments)))
    datagram = fragments.setdefault(key, _Datagram())
    if offset + len(body) > _MAX_DATAGRAM_BYTES or len(datagram.parts) >= _MAX_FRAGMENTS or not body:
        return None
    datagram.received += len(body) - len(datagram.parts.get(offset, b""))
    datagram.parts[offset] = body
    if not more:
        datagram.length = offset + len(body)
    if datagram.received != datagram.length:
        return None
    del fragments[key]
    joined = bytearray()
    while len(joined) in datagram.parts:
        joined += datagram.parts[len(joined)]
    return bytes(joined) if len(joined) == datagram.length else None


PACKET_BYTES = 1206

_BANKS = (b"\xff\xee", b"\xff\xdd", b"\xff\xcc", b"\xff\xbb")

_MODELS = {0x21: "HDL32E", 0x22: "VLP16", 0x24: "PuckHiRes", 0x28: "VLP32C", 0xA1: "VLS128"}

_TABLES = {"HDL32E": "HDL-32E", "VLP16": "VLP-16", "VLP32C": "VLP-32C"}

_WITHOUT_AZIMUTH_OFFSET = {"HDL32E", "VLP16", "PuckHiRes"}


def is_velodyne(payload: bytes) -> bool:
    """Return whether a UDP payload is a Velodyne data packet: 1206 bytes, twelve blocks that begin with a bank id.

    The first bank is ff ee; models with more lasers than fit in a block also use ff dd, ff cc and ff bb.
    """
    return len(payload) == PACKET_BYTES and payload[:2] == b"\xff\xee" and payload[1100:1102] in _BANKS


def looks_like_payloads(size: int, head: bytes) -> bool:
    """Return whether a file looks like bare payloads, by its size and first bytes."""
    return size % PACKET_BYTES == 0 and head[:2] == b"\xff\xee"


def read_velodyne(source: InputFile, frame: Rigid | None) -> Iterator[Columns]:
    """Yield the revolutions of a capture (of its first sensor) or a file of bare payloads.

    A revolution begins at the first packet's azimuth. An incomplete last one is dropped, unless it is the only one.
    """
    content = source.content()
    is_bare = looks_like_payloads(source.size, source.head)
    yield from _revolutions(_bare_payloads(content) if is_bare else _payloads_of_first(content, source.path), frame)


def _payloads_of_first(content: bytes, path: str) -> Iterator[tuple[float, bytes]]:
    """Yield (seconds since 1970, payload) of the packets of the first sensor in a capture; warn once of others."""
    first, other = b"", b""
    for seconds, sender, payload in _udp_datagrams(content):
        if not is_velodyne(payload):
            continue
        first = first or sender
        if sender == first:
            yield seconds, payload
        elif not other:
            other = sender
            line = f"holds packets of several Velodyne sensors; only {_named(first)} is read, not {_named(other)}"
            warnings.warn(f"{path}: {line}; write a capture of each, with tcpdump -r", stacklevel=2)


def _named(sender: bytes) -> str:
    return f"{'.'.join(map(str, sender[:4]))} to port {int.from_bytes(sender[4:], 'big')}"


def _bare_payloads(content: bytes) -> Iterator[tuple[float, bytes]]:
    """Yield (seconds since the full hour, payload); a bare payload has no absolute time."""
    for start in range(0, len(content), PACKET_BYTES):
        payload = content[start : start + PACKET_BYTES]
        yield int.from_bytes(payload[1200:1204], "little") * 1e-6, payload


def revolution_of_packets(packets: Sequence[tuple[float, bytes]]) -> Columns:
    """Decode packets (seconds, payload of 1206 bytes) to one revolution.

    Raises:
        ValueError: the models of the packets differ or are unknown, or the decoder fails.
    """
    library = _library()
    products = {payload[-1] for _, payload in packets}
    if len(products) > 1:
        raise ValueError(
            f"packets must be of one model, got products {', '.join(f'0x{product:02x}' for product in products)}"
        )
    name = _model_name(packets[0][1])
    decoder = library.ScanDecoder(_config(library, name))
    vector = library.PacketVector([library.VelodynePacket(*packet) for packet in packets])
    return _columns(_call(decoder.decode, vector), name, IDENTITY)


def _revolutions(packets: Iterable[tuple[float, bytes]], frame: Rigid | None) -> Iterator[Columns]:
    library, decoder, name = _library(), None, ""
    any_returns = False
    for seconds, payload in packets:
        if not is_velodyne(payload):
            continue
        if decoder is None:
            name = _model_name(payload)
            decoder = library.StreamDecoder(_config(library, name))
        scan = _call(decoder.decode, seconds, payload)
        if scan is not None and len(scan[1]):
            any_returns = True
            yield _columns(scan, name, frame)
    if decoder is None:
        raise ValueError("holds no Velodyne data packets (1206 bytes that begin with ff ee)")
    last_scan = _call(decoder.finish)
    if not any_returns and last_scan is not None:
        yield _columns(last_scan, name, frame)
    elif not any_returns:
        raise ValueError("holds no revolution with a return")


def _model_name(payload: bytes) -> str:
    product = payload[-1]
    if product not in _MODELS:
        raise ValueError(f"Velodyne product must be {', '.join(_MODELS.values())}, got id 0x{product:02x}")
    return _MODELS[product]


def _library() -> Any:
    with needed_for("reading Velodyne packets"):
        import velodyne_decoder
    return velodyne_decoder


def _config(library: Any, name: str) -> Any:
    return library.Config(model=getattr(library.Model, name))


def _call(function: Any, *arguments: Any) -> Any:
    try:
        return function(*arguments)
    except Exception as error:  # the compiled decoder has its own exception types
        raise ValueError(f"velodyne-decoder refuses the packets: {error}") from error


def _columns(scan: Any, name: str, frame: Rigid | None) -> Columns:
    """Convert one scan; its table has x, y, z, intensity, time, column, ring, return type."""
    stamp, table = scan
    table = _one_turn(np.asarray(table, dtype=np.float32))
    points = np.ascontiguousarray(table[:, :3])
    begin = float(table[:, 4].min()) if len(table) else 0.0
    return Columns(
        points, table[:, 3],
        ring=table[:, 6].astype(np.int16),
        azimuth=np.arctan2(points[:, 1], points[:, 0]) if name in _WITHOUT_AZIMUTH_OFFSET else None,
        time_s=table[:, 4] - np.float32(begin),
        t_ns=round((stamp.host + begin) * 1e9),
        model=lidar_model(_TABLES[name]) if name in _TABLES else None,
        frame=IDENTITY if frame is None else frame,
    )  # fmt: skip


def _one_turn(table: NDArray[np.float32]) -> NDArray[np.float32]:
    """Drop late points past the first azimuth: the decoder splits between packets, up to a few degrees too late."""
    if len(table) < 2:
        return table
    azimuth = np.arctan2(table[:, 1], table[:, 0])
    turned = np.mod(azimuth[0] - azimuth, 2 * np.pi)
    late = table[:, 5] > 0.75 * table[:, 5].max()
    one_turn: NDArray[np.float32] = table[~(late & (turned < np.pi / 2))]
    return one_turn
