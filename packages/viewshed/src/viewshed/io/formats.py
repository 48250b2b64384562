"""The table of formats, and which of them a file is."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from viewshed._extras import load, plugins
from viewshed.geometry import Rigid
from viewshed.io._columns import Columns
from viewshed.io._input import InputFile
from viewshed.io.argoverse import read_argoverse2
from viewshed.io.las import read_las
from viewshed.io.numpy_files import read_npy, read_npz, write_npy, write_npz
from viewshed.io.ouster_packets import metadata_path, read_ouster
from viewshed.io.pcd import read_pcd, write_pcd
from viewshed.io.ply import read_ply, write_ply
from viewshed.io.raw_floats import columns_of_bin, read_kitti, read_nuscenes, write_kitti, write_nuscenes
from viewshed.io.text import read_text
from viewshed.io.velodyne import PCAP_BEGINS, is_velodyne, looks_like_payloads, read_velodyne, udp_payloads
from viewshed.sweep import Sweep

Reader = Callable[[InputFile, Rigid | None], Iterator[Columns]]

Writer = Callable[[Sweep], bytes]

_PACKETS_TRIED = 200


@dataclass(frozen=True, slots=True)
class Format:
    """One file format."""

    read: Reader  # yields the columns of each revolution in a source; None as frame is the format's own
    suffixes: tuple[str, ...]  # lower-case endings of file names, without ``.gz``; the first is the usual one
    begins: tuple[bytes, ...] = ()  # first bytes that tell the format, empty where it has none
    write: Writer | None = None  # turns a sweep into the bytes of a file, or None where the format is only read


FORMATS: dict[str, Format] = {
    "nuscenes": Format(read_nuscenes, (".pcd.bin",), (), write_nuscenes),
    "kitti": Format(read_kitti, (".bin",), (), write_kitti),
    "pcd": Format(read_pcd, (".pcd",), (b"# .PCD", b"VERSION ", b"FIELDS "), write_pcd),
    "ply": Format(read_ply, (".ply",), (b"ply\n", b"ply\r"), write_ply),
    "npy": Format(read_npy, (".npy",), (b"\x93NUMPY",), write_npy),
    "npz": Format(read_npz, (".npz",), (b"PK\x03\x04", b"PK\x05\x06"), write_npz),
    "argoverse2": Format(read_argoverse2, (".feather",), (b"ARROW1",)),
    "velodyne": Format(read_velodyne, (".pcap", ".bin")),
    "ouster": Format(read_ouster, (".pcap",)),
    "las": Format(read_las, (".las", ".laz"), (b"LASF",)),
    "text": Format(read_text, (".csv", ".xyz", ".asc")),
}
"""Name → format; docs/formats.md says what each keeps. To add one: write a module with a reader, add a line; or, in a
package of your own, an entry point of ``viewshed.formats``."""


@lru_cache(maxsize=1)
def _added() -> dict[str, Format]:
    """Return the formats that installed packages add, by entry points ``viewshed.formats``; skip those that fail."""
    added = {}
    for name, point in plugins("formats").items():
        if name in FORMATS:
            continue
        try:
            added[name] = load(point, lambda format_: isinstance(format_, Format), "a viewshed.io.Format")
        except ImportError as error:
            warnings.warn(f"format {name!r} is left out: {error}", stacklevel=2)
    return added


def all_formats() -> dict[str, Format]:
    """Return the formats by name, those that installed packages add after ours."""
    return FORMATS | _added()


_NOT_READ = {
    b"SQLite format 3": "is a ROS 2 bag (SQLite), a recording: open it with viewshed.open_recording",
    b"#ROSBAG V": "is a ROS 1 bag, a recording: open it with viewshed.open_recording",
    b"\x89MCAP0\r\n": "is an MCAP bag, a recording: open it with viewshed.open_recording",
    b"FEA1": "is feather version 1; write it again as version 2",
    b"\x0a\x0d\x0d\x0a": "is a pcapng capture; convert it with: editcap -F pcap",
    b"\x1f\x8b": "is gzipped twice; unpack it once",
}

_BEGINS = (*_NOT_READ, *PCAP_BEGINS, *(begins for known in FORMATS.values() for begins in known.begins))


def format_of(source: InputFile) -> str:
    """Return the name in :data:`FORMATS` of an opened file, by its first bytes, then its name, then its rows.

    Raises:
        ValueError: no format fits, or two do.
    """
    head = source.head
    if source.name.endswith(".pcd.bin") and not head.startswith(b"# .PCD"):
        return "nuscenes"
    if not head.startswith(_BEGINS):
        return _format_by_name(source)
    for begins, problem in _NOT_READ.items():
        if head.startswith(begins):
            raise ValueError(problem)
    for name, known in FORMATS.items():
        if known.begins and head.startswith(known.begins):
            return name
    return _maker_of_capture(source)


def _format_by_name(source: InputFile) -> str:
    for name, added in _added().items():
        if source.head.startswith(added.begins) or source.name.endswith(added.suffixes):
            return name
    if source.name.endswith(".bin"):
        if looks_like_payloads(source.size, source.head):
            return "velodyne"
        return "kitti" if columns_of_bin(source) == 4 else "nuscenes"
    for name, known in FORMATS.items():
        if source.name.endswith(known.suffixes):
            if name == "text":
                return name
            raise ValueError(f"is named like {name} but does not begin like it; it is damaged or of another format")
    raise ValueError(
        f"format is not known by name or content; name one of {', '.join(all_formats())} with --format, or save the"
        " points (N, 3) as NPY"
    )


def _maker_of_capture(source: InputFile) -> str:
    """Return "velodyne" where one of the first payloads is one, else "ouster"."""
    content = source.content()
    for index, (_, payload) in enumerate(udp_payloads(content)):
        if is_velodyne(payload):
            return "velodyne"
        if index >= _PACKETS_TRIED:
            break
    if metadata_path(source.path).is_file():
        return "ouster"
    raise ValueError(
        f"holds no Velodyne packets; if it is an Ouster capture, put its metadata beside it as "
        f"{metadata_path(source.path).name}"
    )


def writer_named(name: str, path: str) -> Writer:
    """Return what writes the format ``name``, or for "auto" the one that the suffix of ``path`` tells.

    Raises:
        ValueError: there is no such format, the suffix is not known, or the format is only read.
    """
    writers = {known: how.write for known, how in all_formats().items() if how.write is not None}
    if name == "auto":
        plain = path.lower().removesuffix(".gz")
        name = next((known for known in writers if plain.endswith(all_formats()[known].suffixes)), "")
        if not name:
            raise ValueError(f"{path}: format cannot be known by the name; name one of {', '.join(writers)}")
    if name not in writers:
        raise ValueError(f"{path}: format must be one of {', '.join(writers)} to write, got {name!r}")
    return writers[name]


BAG_SUFFIXES = tuple(kind + packed for kind in (".bag", ".mcap", ".db3") for packed in ("", ".zstd", ".zst"))
"""Endings of the names of bags, as they are or packed."""


def is_recording(path: str | os.PathLike[str]) -> bool:
    """Return whether a path is a folder or a bag; anything else is a file of sweeps."""
    place = Path(path)
    return place.is_dir() or place.name.lower().endswith(BAG_SUFFIXES)
