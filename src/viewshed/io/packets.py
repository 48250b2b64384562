"""Velodyne packets: a capture (pcap) or payloads of 1206 bytes one after the other, decoded by velodyne-decoder."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.io.columns import Columns
from viewshed.io.frames import IDENTITY
from viewshed.io.pcap import udp_payloads
from viewshed.io.source import Source
from viewshed.sensors import lidar_model

PACKET_BYTES = 1206
_MODELS = {0x21: "HDL32E", 0x22: "VLP16", 0x24: "PuckHiRes", 0x28: "VLP32C", 0x31: "AlphaPrime"}
_TABLES = {"HDL32E": "HDL-32E", "VLP16": "VLP-16", "VLP32C": "VLP-32C"}
_NO_AZIMUTH_OFFSET = {"HDL32E", "VLP16", "PuckHiRes"}
_INSTALL = "needs velodyne-decoder; install it with: pip install 'viewshed[packets]'"


def is_velodyne(payload: bytes) -> bool:
    """Return whether a UDP payload is a Velodyne data packet: 1206 bytes, twelve blocks that begin with ff ee."""
    return len(payload) == PACKET_BYTES and payload[:2] == b"\xff\xee" and payload[1100:1102] == b"\xff\xee"


def looks_like_payloads(size: int, head: bytes) -> bool:
    """Return whether a file holds bare payloads, by its size and first bytes."""
    return size % PACKET_BYTES == 0 and head[:2] == b"\xff\xee"


def read_velodyne(source: Source, frame: Rigid | None) -> Iterator[Columns]:
    """Yield the revolutions of a capture or a file of bare payloads.

    A revolution begins at the first packet's azimuth. The rest at the end is left out, unless it is all there is.
    """
    content = source.content()
    bare = looks_like_payloads(source.size, source.head)
    try:
        yield from _revolutions(_bare(content) if bare else udp_payloads(content), frame)
    except ImportError as error:
        raise ImportError(f"{source.path}: {_INSTALL}") from error
    except ValueError as error:
        raise source.error(error) from error


def _bare(content: bytes) -> Iterator[tuple[float, bytes]]:
    """Yield (seconds since the full hour, payload); a bare payload knows no more of time."""
    for start in range(0, len(content), PACKET_BYTES):
        payload = content[start : start + PACKET_BYTES]
        yield int.from_bytes(payload[1200:1204], "little") * 1e-6, payload


def _revolutions(packets: Iterable[tuple[float, bytes]], frame: Rigid | None) -> Iterator[Columns]:
    import velodyne_decoder

    decoder = name = None
    found = False
    for seconds, payload in packets:
        if not is_velodyne(payload):
            continue
        if decoder is None:
            name = _model_name(payload)
            decoder = _decoder(velodyne_decoder, name)
        scan = _call(decoder.decode, seconds, payload)
        if scan is not None and len(scan[1]):
            found = True
            yield _columns(scan, name or "", frame)
    if decoder is None:
        raise ValueError("holds no Velodyne data packets (1206 bytes that begin with ff ee)")
    rest = _call(decoder.finish)
    if not found and rest is not None:
        yield _columns(rest, name or "", frame)
    elif not found:
        raise ValueError("holds no revolution with a return")


def _model_name(payload: bytes) -> str:
    product = payload[-1]
    if product not in _MODELS:
        raise ValueError(f"Velodyne product must be {', '.join(_MODELS.values())}, got id 0x{product:02x}")
    return _MODELS[product]


def _decoder(library: Any, name: str) -> Any:
    return library.StreamDecoder(library.Config(model=getattr(library.Model, name)))


def _call(function: Any, *arguments: Any) -> Any:
    try:
        return function(*arguments)
    except Exception as error:  # the decoder is compiled code with exceptions of its own
        raise ValueError(f"velodyne-decoder refuses the packets: {error}") from error


def _columns(scan: Any, name: str, frame: Rigid | None) -> Columns:
    """Return the columns of one scan: x, y, z, intensity, time, column, ring, return type."""
    stamp, table = scan
    table = _one_turn(np.asarray(table, dtype=np.float32))
    points = np.ascontiguousarray(table[:, :3])
    begin = float(table[:, 4].min()) if len(table) else 0.0
    return Columns(
        points, table[:, 3],
        ring=table[:, 6].astype(np.int16),
        azimuth=np.arctan2(points[:, 1], points[:, 0]) if name in _NO_AZIMUTH_OFFSET else None,
        time_s=table[:, 4] - np.float32(begin),
        t_ns=round((stamp.host + begin) * 1e9),
        model=lidar_model(_TABLES[name]) if name in _TABLES else None,
        frame=IDENTITY if frame is None else frame,
    )  # fmt: skip


def _one_turn(table: NDArray[np.float32]) -> NDArray[np.float32]:
    """Leave out the late points past the first azimuth: the decoder cuts between packets, a few degrees too late."""
    if len(table) < 2:
        return table
    azimuth = np.arctan2(table[:, 1], table[:, 0])
    turned = np.mod(azimuth[0] - azimuth, 2 * np.pi)
    late = table[:, 5] > 0.75 * table[:, 5].max()
    kept: NDArray[np.float32] = table[~(late & (turned < np.pi / 2))]
    return kept
