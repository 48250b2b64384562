"""UDP payloads of a packet capture (libpcap's classic format), with IPv4 fragments put together."""

from __future__ import annotations

import struct
from collections.abc import Iterator

_MAGICS = {
    b"\xd4\xc3\xb2\xa1": ("<", 1e-6), b"\xa1\xb2\xc3\xd4": (">", 1e-6),
    b"\x4d\x3c\xb2\xa1": ("<", 1e-9), b"\xa1\xb2\x3c\x4d": (">", 1e-9),
}  # fmt: skip
PCAP_BEGINS = tuple(_MAGICS)
"""First bytes of captures that can be read."""
_LINK_HEADER_BYTES = {0: 4, 1: 14, 101: 0, 113: 16, 228: 0, 276: 20}
_DATAGRAMS_OPEN = 64
_PARTS_MAX = 512
_DATAGRAM_MAX = 65_535
_UDP = 17


def udp_payloads(content: bytes) -> Iterator[tuple[float, bytes]]:
    """Yield (seconds since 1970, payload) for every UDP datagram of a capture, in order.

    Raises:
        ValueError: it is no capture, of a link type that is not known, or cut off within a packet.
    """
    if content[:4] not in _MAGICS or len(content) < 24:
        raise ValueError("is not a packet capture or is cut off")
    order, unit = _MAGICS[content[:4]]
    link = struct.unpack_from(order + "I", content, 20)[0] & 0xFFFF
    if link not in _LINK_HEADER_BYTES:
        raise ValueError(f"packet capture must be of Ethernet or raw IP, got link type {link}")
    record = struct.Struct(order + "IIII")
    fragments: dict[bytes, dict[int, bytes]] = {}
    at = 24
    while at < len(content):
        if at + 16 > len(content):
            raise ValueError("packet capture is cut off within a packet header")
        seconds, fraction, captured, _ = record.unpack_from(content, at)
        at += 16
        if captured > len(content) - at:
            raise ValueError(f"packet capture is cut off: a packet of {captured} bytes, {len(content) - at} left")
        datagram = _datagram(content[at : at + captured], link, fragments)
        at += captured
        if datagram is not None:
            yield seconds + fraction * unit, datagram


def _datagram(packet: bytes, link: int, fragments: dict[bytes, dict[int, bytes]]) -> bytes | None:
    """Return the UDP payload that this packet holds or completes, else None."""
    ip = _ip_packet(packet, link)
    if len(ip) < 20 or ip[0] >> 4 != 4 or ip[9] != _UDP:
        return None
    header, total = 4 * (ip[0] & 15), int.from_bytes(ip[2:4], "big")
    body = ip[header : total if total >= header else None]
    flags = int.from_bytes(ip[6:8], "big")
    if flags & 0x3FFF:
        whole = _joined(ip[4:6] + ip[12:20], 8 * (flags & 0x1FFF), body, bool(flags & 0x2000), fragments)
        if whole is None:
            return None
        body = whole
    length = int.from_bytes(body[4:6], "big")
    return body[8:length] if 8 <= length <= len(body) else None


def _ip_packet(packet: bytes, link: int) -> bytes:
    start = _LINK_HEADER_BYTES[link]
    if link == 1:
        while packet[start - 2 : start] in (b"\x81\x00", b"\x88\xa8"):
            start += 4
        if packet[start - 2 : start] != b"\x08\x00":
            return b""
    return packet[start:]


def _joined(
    key: bytes, offset: int, body: bytes, more: bool, fragments: dict[bytes, dict[int, bytes]]
) -> bytes | None:  # fmt: skip
    """Keep a fragment; return the datagram once it is complete. The last fragment is kept under offset -1 too."""
    if key not in fragments and len(fragments) >= _DATAGRAMS_OPEN:
        fragments.pop(next(iter(fragments)))
    parts = fragments.setdefault(key, {})
    if offset + len(body) > _DATAGRAM_MAX or len(parts) > _PARTS_MAX or not body:
        return None
    parts[offset] = body
    if not more:
        parts[-1] = b""
    if -1 not in parts or 0 not in parts:
        return None
    whole = bytearray()
    while len(whole) in parts and parts[len(whole)]:
        whole += parts[len(whole)]
    if sum(map(len, parts.values())) != len(whole):
        return None
    del fragments[key]
    return bytes(whole)
