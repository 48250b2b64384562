"""Bad input gives one clear line that names the file, and never more memory than the file deserves."""

import gzip
import os
import re
import struct
import tracemalloc
import zipfile
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed.io import read_sweep
from viewshed.io.samples import junction_path

files: Any = import_module("sweep_files")
P, I = files.POINTS, files.INTENSITY  # noqa: E741
TABLE = np.column_stack((P, I)).astype(np.float32)
SAMPLES = files.samples()
NAN = np.full((6, 4), np.nan, np.float32)
COLUMNS = np.random.default_rng(0).normal(0, 10, (3, 5000)).astype(np.float32)


def header_only(header: bytes) -> bytes:
    """Return an NPY file of this header and no data."""
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header


def our_npz(**changes: Any) -> bytes:
    """Return an NPZ file of a sweep of this package, with other arrays in it."""
    sweep = {"points": P, "agent": np.array("a"), "dropped_points": np.array(0)}
    return files.npz(viewshed_sweep=np.array(1), **(sweep | changes))  # type: ignore[no-any-return]


def zipped(name: str, content: bytes, method: int = zipfile.ZIP_DEFLATED) -> bytes:
    import io

    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        archive.writestr(name, content)
    return buffer.getvalue()


PCD = files.pcd(files.rows(TABLE), "binary")
PLY = files.ply(files.rows(TABLE), "binary_little_endian")
PACKED = SAMPLES["pcd compressed"].content
AT = PACKED.index(b"binary_compressed\n") + 18
BAD = {
    "empty.bin": (b"", "the file is empty"),
    "empty.ply.gz": (gzip.compress(b""), "the gzip content is empty"),
    "short.pcd.bin": (files.rows(TABLE)[:-3], "must hold rows of 5 float32 .* got 93 bytes; it is cut off"),
    "short.bin": (files.rows(TABLE)[:-3], "does not look like rows of 4 or 5 float32 columns"),
    "four.pcd.bin": (files.rows(np.repeat(TABLE, 5, axis=0)), "the fifth column must be whole ring numbers"),
    "zeros.bin": (bytes(80 * 7), "could be 4 or 5 float32 columns; say which with --format"),
    "nan.pcd": (files.pcd(files.rows(NAN), "binary"), "none of the 6 points is finite"),
    "nan.ply": (files.ply(b"nan nan nan 0\n" * 6, "ascii"), "none of the 6 points is finite"),
    "cut.pcd": (PCD[:-9], "PCD data is cut off: 6 points need 96 bytes, the file holds 87"),
    "cut2.pcd": (PCD[:100], "PCD header has no DATA line"),
    "long.pcd": (PCD + bytes(70_000), "PCD header is wrong: 6 points need 96 bytes"),
    "huge.pcd": (PCD.replace(b"POINTS 6", b"POINTS 9999999"), "PCD data is cut off: 9999999 points need"),
    "huge2.pcd": (PCD.replace(b"POINTS 6", b"POINTS 999999999999"), "at most 20000000 points, PCD header says"),
    "minus.pcd": (PCD.replace(b"POINTS 6", b"POINTS -6"), "PCD header line POINTS is missing or not whole numbers"),
    "type.pcd": (PCD.replace(b"SIZE 4", b"SIZE 3"), "PCD field 'x' has unknown TYPE 'F', SIZE 3"),
    "fields.pcd": (PCD.replace(b"x y z", b"x y"), "must be of one length"),
    "noz.pcd": (PCD.replace(b"x y z", b"x y w"), "must have columns x, y and z, z not found"),
    "data.pcd": (PCD.replace(b"DATA binary", b"DATA zipped"), "PCD DATA must be ascii, binary, binary_compressed"),
    "word.pcd": (files.pcd(files.text(TABLE).replace(b"4.0000", b"four"), "ascii"), "could not convert string"),
    "column.pcd": (files.pcd(files.text(TABLE[:, :3]), "ascii"), "rows of 4 numbers"),
    "rows.pcd": (files.pcd(files.text(TABLE[:4]) + b" " * 99, "ascii"), "must hold 6 rows of 4 numbers, got 4 of 4"),
    "lzf.pcd": (PACKED[: AT + 4] + struct.pack("<I", 2**31) + PACKED[AT + 8 :], "PCD sizes do not agree"),
    "lzf2.pcd": (PACKED[:AT] + struct.pack("<I", 2**31) + PACKED[AT + 4 :], "should hold 2147483648 compressed bytes"),
    "ratio.pcd": (
        PACKED[:AT].replace(b"WIDTH 240", b"WIDTH 9000").replace(b"POINTS 240", b"POINTS 9000")
        + struct.pack("<II", 1000, 16 * 9000) + bytes(1000),
        "PCD sizes do not agree: 9000 points are 144000 bytes, got 144000 from 1000",
    ),
    "lzf3.pcd": (PACKED[: AT + 8] + b"\xff" * (len(PACKED) - AT - 8), "PCD compressed data is damaged"),
    "cut.ply": (PLY[:-1], "PLY data is cut off: 6 vertices need 96 bytes, the file holds 95"),
    "huge.ply": (PLY.replace(b"vertex 6", b"vertex 19999999"), "PLY data is cut off: 19999999 vertices need"),
    "list.ply": (PLY.replace(b"property float z", b"property list uchar int z"), "must be one number of a known type"),
    "order.ply": (PLY.replace(b"binary_little_endian", b"binary_middle"), "PLY format must be ascii, binary_"),
    "open.ply": (PLY.replace(b"end_header", b"no_end"), "PLY header has no end_header"),
    "shape.npy": (files.npy(P[:, :2]), r"points must have shape \(N, 3\) or more columns, got \(6, 2\)"),
    "int8.npy": (files.npy(P.astype(np.int8)), r"must be floats \(meters\) or int32 \(millimeters\), got int8"),
    "huge.npy": (
        header_only(b"{'descr': '<f8', 'fortran_order': False, 'shape': (999999999, 3), }\n"),
        r"NPY shape \(999999999, 3\) of float64 needs 23999999976 bytes, the array holds 0",
    ),
    "sizes.npy": (
        header_only(b"{'descr': '<f4', 'fortran_order': False, 'shape': (1, 1, 1, 1, 3), }\n"),
        "NPY shape must be up to 4 sizes of up to 12 digits",
    ),
    "object.npy": (files.npy(np.array([[1, 2, None]], dtype=object)), "pickled and structured are refused"),
    "text.npz": (our_npz(ring=np.array(["a"] * 6)), "ring must be real numbers, got dtype <U1"),
    "negative.npz": (our_npz(dropped_points=np.array(-5)), "dropped_points must not be negative, got -5"),
    "columns.npy": (files.npy(COLUMNS), r"must have shape \(N, 3\).*got \(3, 5000\); transpose it"),
    "columns.npz": (files.npz(points=COLUMNS), r"must have shape \(N, 3\).*got \(3, 5000\); transpose it"),
    "agentless.npz": (files.npz(viewshed_sweep=np.array(1), points=P), "is damaged or of a kind that is not read: Key"),
    "entries.npz": (SAMPLES["npz"].content + b"PK\x01\x02" * 64, "NPZ must have at most 64 arrays, got 65"),
    "none.npz": (files.npz(cloud=P, labels=P[:, 0]),
                 "NPZ must have an array 'points' or a single one, got cloud, labels"),
    "object.npz": (files.npz(points=np.array([[1, 2, None]], dtype=object)), "pickled and structured are refused"),
    "cut.npz": (SAMPLES["npz"].content[:-30], "NPZ is damaged or cut off"),
    "bomb.npz": (zipped("points.npy", bytes(5_000_000)), "unpacks to more than 1000000 bytes"),
    "lzma.npz": (zipped("points.npy", files.npy(P), zipfile.ZIP_LZMA), "NPZ must be stored or deflated"),
    "bomb.bin.gz": (gzip.compress(bytes(3_000_000)), "unpacks to more than 1000000 bytes"),
    "cut.ply.gz": (SAMPLES["ply gzipped"].content[:-12], "the gzip content is damaged or cut off"),
    "twice.ply.gz": (gzip.compress(SAMPLES["ply gzipped"].content), "is gzipped twice"),
    "members.bin.gz": (gzip.compress(b"", mtime=0) * 50_001, "gzip content must have at most 50000 members"),
    "after.bin.gz": (gzip.compress(files.rows(TABLE)) + b"garbage", "the gzip content is damaged or cut off"),
    "cut.feather": (SAMPLES["argoverse2 lz4"].content[:400], "feather content is damaged or cut off"),
    "bag.db3": (b"SQLite format 3\x00" + bytes(100), "is a ROS 2 bag .*viewshed.open_recording$"),
    "new.pcap": (b"\x0a\x0d\x0d\x0a" + bytes(100), "is a pcapng capture"),
    "none.pcap": (files.pcap([files.ip_packet(files.udp_packet(b"abc"))]), "holds no Velodyne packets; if it is an O"),
    "cut.pcap": (SAMPLES["velodyne pcap"].content[:900], "packet capture is cut off"),
    "link.pcap": (b"\xd4\xc3\xb2\xa1" + bytes(16) + struct.pack("<I", 147), "got link type 147"),
    "product.bin": (files.vlp16_payload(0, 0.4, 5, product=0x77) * 3, "got id 0x77"),
    "byte.bin": (b"\0", "does not look like rows"),
    "words.bin": (b"not points\n" * 9, "does not look like rows"),
    "page.bin": (b"<!DOCTYPE html><html>" * 20, "does not look like rows"),
    "ones.bin": (b"\xff" * 1600, "could be 4 or 5 float32 columns"),
    "picture.ply": (b"\x89PNG\r\n\x1a\n" + bytes(99), "named like ply but does not begin like"),
    "faces.ply": (b"ply\nformat ascii 1.0\nelement face 1\nend_header\n1\n", "PLY element vertex must come first"),
    "unnamed.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float a\nend_header\n1\n2\n",
        "x, y, z not found among no known column",
    ),
    "noz.ply": (PLY.replace(b"float z", b"float w"), "must have columns x, y and z, z not found"),
    "zip.npz": (b"PK\x03\x04" + bytes(60), "NPZ is damaged"),
    "text.npy": (files.npy(np.array([["a", "b", "c"]])), "must be floats .* got <U1"),
    "picture.npy": (files.npy(np.zeros((4, 64, 3))), r"or more columns, got \(4, 64, 3\)"),
    "complex.npy": (files.npy(np.zeros((9, 3), complex)), "type is not plain numbers"),
    "a.las": (b"LASF" + bytes(300), "LAS header is damaged"),
    "what.xyw": (b"1 2 3\n", "format is not known by name or content; name one of nuscenes, kitti"),
    "fake.pcd": (b"\x00" * 50, "is named like pcd but does not begin like it"),
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(BAD))
def test_bad_files_are_refused_in_one_line(name: str, tmp_path: Path) -> None:
    content, pattern = BAD[name]
    path = tmp_path / name
    path.write_bytes(content)
    read_sweep_of_sample(tmp_path)
    tracemalloc.start()
    with pytest.raises(ValueError, match=pattern) as caught:
        read_sweep(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    assert peak < 10 * len(content) + 16_000_000


def read_sweep_of_sample(folder: Path) -> None:
    """Load compiled code before memory is measured."""
    for name in ("kitti", "nuscenes", "argoverse2 lz4", "velodyne payloads"):
        (folder / f"warm {SAMPLES[name].name}").write_bytes(SAMPLES[name].content)
        read_sweep(folder / f"warm {SAMPLES[name].name}")


def test_gzip_members_follow_each_other_and_padding_is_left_out(tmp_path: Path) -> None:
    content = files.rows(TABLE)
    (tmp_path / "a.bin.gz").write_bytes(
        gzip.compress(content[:40]) + gzip.compress(b"") + gzip.compress(content[40:]) + bytes(40_000)
    )
    assert read_sweep(tmp_path / "a.bin.gz", format="kitti").points.tolist() == P.tolist()


def test_whatever_a_reader_raises_names_the_file_and_the_next_file_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from viewshed.cli import main
    from viewshed.io import FORMATS, formats

    def faulty(*_: object) -> None:
        raise ZeroDivisionError("two\nlines")

    monkeypatch.setitem(formats.FORMATS, "ply", replace(FORMATS["ply"], read=faulty))
    (tmp_path / "bad.ply").write_bytes(PLY)
    (tmp_path / "bad.npz").write_bytes(BAD["text.npz"][0])
    (tmp_path / "good.bin").write_bytes(files.rows(np.repeat(TABLE, 3, axis=0)))
    names = [str(tmp_path / name) for name in ("bad.ply", "bad.npz", "good.bin")]
    with pytest.raises(SystemExit) as left:
        main(["estimate", *names, "--method", "first_blocker", "--results", "npz", "--out", str(tmp_path / "out")])
    assert left.value.code == 2
    first, second = capsys.readouterr().err.splitlines()
    assert first == f"viewshed: {names[0]}: is damaged or of a kind that is not read: ZeroDivisionError: two lines"
    assert second.startswith(f"viewshed: {names[1]}: ring must be real numbers")
    assert (tmp_path / "out" / "good_first_blocker.npz").is_file()


def test_missing_file_folder_and_pipe_are_os_errors(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=re.escape(f"{tmp_path}/no.bin: No such file")):
        read_sweep(tmp_path / "no.bin")
    with pytest.raises(IsADirectoryError, match="is a folder; name the files in it"):
        read_sweep(tmp_path)
    os.mkfifo(tmp_path / "pipe.bin")
    with pytest.raises(OSError, match="is not a regular file"):
        read_sweep(tmp_path / "pipe.bin")
    with pytest.raises(OSError, match="is not a regular file"):
        read_sweep("/dev/zero")


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"format": "kity"}, r"format must be auto or one of nuscenes, .* got 'kity'"),
        ({"sensor": "HDL-65"}, "sensor must be one of"),
        ({"sensor": "VLP-16"}, r"a\.pcd\.bin: ring must lie in \[0, 16\) of VLP.?16, got 20…25"),
        ({"file_frame": "up"}, r"file_frame must be one of sensor, nuscenes, .* got 'up'"),
        ({"sensor_height_m": -1}, r"a\.pcd\.bin: sensor_height_m must lie in \(0, 100\), got -1"),
        ({"attitude": (2, 0, 0, 0)}, r"a\.pcd\.bin: quaternion must have norm 1"),
    ],
)
def test_wrong_arguments_are_named(given: dict[str, Any], words: str, tmp_path: Path) -> None:
    path = tmp_path / "a.pcd.bin"
    path.write_bytes(files.rows(P, I, np.arange(6) + 20))
    with pytest.raises(ValueError, match=words):
        read_sweep(path, **given)


JUNK: dict[str, Callable[[int], NDArray[np.int64]]] = {
    "random": lambda count: np.random.default_rng(0).integers(0, 64, count),
    "row numbers": lambda count: np.arange(count) % 1000,
    "all the same": lambda count: np.full(count, 500),
}


@pytest.mark.parametrize("kind", JUNK)
def test_a_column_of_something_else_is_no_ring(kind: str, tmp_path: Path) -> None:
    sweep = read_sweep(junction_path())
    shuffled = np.random.default_rng(1).permutation(sweep.points)
    path = tmp_path / "a.npz"
    path.write_bytes(our_npz(points=shuffled, ring=JUNK[kind](len(sweep))))
    with pytest.warns(UserWarning, match=r"a\.npz: ring is left out: (returns beside|every return has ring 500)"):
        assert read_sweep(path).ring is None


@pytest.mark.parametrize("turn", [0.0, 0.8])
def test_rings_of_a_rolled_sensor_in_another_frame_are_kept(turn: float, tmp_path: Path) -> None:
    sweep = read_sweep(junction_path())
    roll = np.array([[1, 0, 0], [0, np.cos(turn), -np.sin(turn)], [0, np.sin(turn), np.cos(turn)]])
    path = tmp_path / "a.npz"
    path.write_bytes(our_npz(points=(sweep.points @ roll.T + [1.0, 0.0, 1.7]).astype(np.float32), ring=sweep.ring))
    assert read_sweep(path).ring is not None


def test_ten_million_points_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    with path.open("wb") as file:
        file.truncate(16 * 10_000_000)
    assert len(read_sweep(path, format="kitti")) == 10_000_000
    with path.open("wb") as file:
        file.truncate(16 * 20_000_001)
    with pytest.raises(ValueError, match="a sweep must have at most 20000000 points, got 20000001"):
        read_sweep(path, format="kitti")


def test_feather_buffers_that_claim_too_much_are_refused_before_they_are_allocated(tmp_path: Path) -> None:
    content = bytearray(files.feather(repeats=500))
    first = content.index(struct.pack("<q", 3000 * 2))
    content[first : first + 8] = struct.pack("<q", 2**40)
    (tmp_path / "a.feather").write_bytes(content)
    with pytest.raises(ValueError, match=r"feather buffers claim 10995116\d+ bytes, more than \d+; refused"):
        read_sweep(tmp_path / "a.feather")
