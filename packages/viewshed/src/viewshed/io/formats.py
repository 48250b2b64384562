"""Table of file formats, and detection of the format of a file."""

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

_MAX_PACKETS_TRIED = 200


@dataclass(frozen=True, slots=True)
class Format:
    """One file format."""

    read: Reader  # yields the columns of each revolution; a frame of None means the format's default
    suffixes: tuple[str, ...]  # lower-case file suffixes, without ``.gz``; the first is the usual one
    begins: tuple[bytes, ...] = ()  # magic bytes, empty if the format has none
    write: Writer | None = None  # encodes a sweep as the bytes of a file; None if read-only


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
"""Name → format; docs/formats.md lists what each stores. To add one, write a module with a reader and add a line here,
or declare an entry point of ``viewshed.formats`` in your own package."""


@lru_cache(maxsize=1)
def _plugin_formats() -> dict[str, Format]:
    """Load the formats of installed plugins (entry points ``viewshed.formats``); warn about those that fail."""
    formats = {}
    for name, point in plugins("formats").items():
        if name in FORMATS:
            continue
        try:
            formats[name] = load(point, lambda format_: isinstance(format_, Format), "a viewshed.io.Format")
        except ImportError as error:
            warnings.warn(f"format {name!r} is left out: {error}", stacklevel=2)
    return formats


def all_formats() -> dict[str, Format]:
    """Return all formats by name: ours, then those of plugins."""
    return FORMATS | _plugin_formats()


_UNSUPPORTED = {
    b"SQLite format 3": "is a ROS 2 bag (SQLite), a recording: open it with viewshed.open_recording",
    b"#ROSBAG V": "is a ROS 1 bag, a recording: open it with viewshed.open_recording",
    b"\x89MCAP0\r\n": "is an MCAP bag, a recording: open it with viewshed.open_recording",
    b"FEA1": "is feather version 1; write it again as version 2",
    b"\x0a\x0d\x0d\x0a": "is a pcapng capture; convert it with: editcap -F pcap",
    b"\x1f\x8b": "is gzipped twice; unpack it once",
}

_MAGICS = (*_UNSUPPORTED, *PCAP_BEGINS, *(begins for known in FORMATS.values() for begins in known.begins))


def format_of(source: InputFile) -> str:
    """Detect the format of an opened file by its first bytes, then its name, then its rows; return a name of FORMATS.

    Raises:
        ValueError: no format matches, or the match is ambiguous.
    """
    head = source.head
    if source.name.endswith(".pcd.bin") and not head.startswith(b"# .PCD"):
        return "nuscenes"
    if not head.startswith(_MAGICS):
        return _format_by_name(source)
    for begins, problem in _UNSUPPORTED.items():
        if head.startswith(begins):
            raise ValueError(problem)
    for name, known in FORMATS.items():
        if known.begins and head.startswith(known.begins):
            return name
    return _format_of_capture(source)


def _format_by_name(source: InputFile) -> str:
    for name, known in _plugin_formats().items():
        if source.head.startswith(known.begins) or source.name.endswith(known.suffixes):
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


def _format_of_capture(source: InputFile) -> str:
    """Return "velodyne" if one of the first payloads is a Velodyne packet, else "ouster"."""
    content = source.content()
    for index, (_, payload) in enumerate(udp_payloads(content)):
        if is_velodyne(payload):
            return "velodyne"
        if index >= _MAX_PACKETS_TRIED:
            break
    if metadata_path(source.path).is_file():
        return "ouster"
    raise ValueError(
        f"holds no Velodyne packets; if it is an Ouster capture, put its metadata beside it as "
        f"{metadata_path(source.path).name}"
    )


def writer_named(name: str, path: str) -> Writer:
    """Return the writer of the format ``name``; "auto" chooses by the suffix of ``path``.

    Raises:
        ValueError: the format or the suffix is unknown, or the format is read-only.
    """
    writers = {known: form.write for known, form in all_formats().items() if form.write is not None}
    if name == "auto":
        plain = path.lower().removesuffix(".gz")
        name = next((known for known in writers if plain.endswith(all_formats()[known].suffixes)), "")
        if not name:
            raise ValueError(f"{path}: format is not known from the name; name one of {', '.join(writers)}")
    if name not in writers:
        raise ValueError(f"{path}: format must be one of {', '.join(writers)} to write, got {name!r}")
    return writers[name]


BAG_SUFFIXES = tuple(kind + packed for kind in (".bag", ".mcap", ".db3") for packed in ("", ".zstd", ".zst"))
"""File suffixes of bags, plain or compressed."""


def is_recording(path: str | os.PathLike[str]) -> bool:
    """Return whether a path is a recording (a folder or a bag) and not a file of sweeps."""
    place = Path(path)
    return place.is_dir() or place.name.lower().endswith(BAG_SUFFIXES)
