"""Build small valid files of every format byte by byte from the format specifications, for tests and fuzzing."""

from __future__ import annotations

import gzip
import io
import json
import struct
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from viewshed import Rigid, Sweep
from viewshed.io import write_sweep

POINTS = np.array(
    [[5.0, 1.0, -1.5], [8.0, -2.0, -1.0], [3.0, 4.0, 0.0], [-6.0, 2.5, 0.5], [-7.0, -3.0, 1.0], [0.5, 9.0, 2.0]],
    dtype=np.float32,
)
"""(6, 3) float32 meters: asymmetric, with elevations that ascend from row to row."""
INTENSITY = np.array([10, 20, 30, 40, 50, 60], dtype=np.float32)


@dataclass(frozen=True, slots=True)
class SampleFile:
    """A file: format, name, content, and contents of the files beside it by name."""

    format: str
    name: str
    content: bytes
    beside: dict[str, bytes] = field(default_factory=dict)


def rows(*columns: NDArray[np.generic], order: str = "<") -> bytes:
    """Return columns as the bytes of float32 rows."""
    return np.column_stack(columns).astype(order + "f4").tobytes()


def pcd(body: bytes, data: str, fields: str = "x y z intensity", count: int = 6) -> bytes:
    """Return a PCD file with this body and a header of float32 fields."""
    width = len(fields.split())
    header = (
        f"# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {fields}\nSIZE {'4 ' * width}\n"
        f"TYPE {'F ' * width}\nCOUNT {'1 ' * width}\nWIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n"
        f"POINTS {count}\nDATA {data}\n"
    )
    return header.encode() + body


def lzf_packed(data: bytes) -> bytes:
    """Return data as an LZF stream: runs of equal bytes are back references of distance 1, the rest are literals."""
    packed = bytearray()
    at = 0
    while at < len(data):
        run = 1
        while at + run < len(data) and data[at + run] == data[at] and run < 200:
            run += 1
        if run >= 12:
            packed += bytes([0, data[at], 7 << 5, run - 1 - 9, 0])
            at += run
        else:
            packed += bytes([run - 1]) + data[at : at + run]
            at += run
    return bytes(packed)


def pcd_compressed(table: NDArray[np.float32]) -> bytes:
    """Return a binary_compressed PCD file of the columns x, y, z and intensity of a table (N, 4)."""
    raw = np.ascontiguousarray(table.T, "<f4").tobytes()
    packed = lzf_packed(raw)
    return pcd(struct.pack("<II", len(packed), len(raw)) + packed, "binary_compressed", count=len(table))


def ply(body: bytes, order: str, count: int = 6) -> bytes:
    """Return a PLY file with this body and a header of x, y, z, I."""
    header = (
        f"ply\nformat {order} 1.0\ncomment a comment\nelement vertex {count}\nproperty float x\nproperty float32 y\n"
        "property float z\nproperty float I\nelement face 0\nproperty list uchar int vertex_indices\nend_header\n"
    )
    return header.encode() + body


def text(table: NDArray[np.float32]) -> bytes:
    """Return a table as lines of text."""
    return "".join(" ".join(f"{value:.4f}" for value in row) + "\n" for row in table).encode()


def npy(array: NDArray[np.generic]) -> bytes:
    """Return an NPY file, as numpy writes it."""
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


def npz(**arrays: NDArray[np.generic]) -> bytes:
    """Return an NPZ file, as numpy writes it."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def feather(compression: str = "lz4", repeats: int = 1) -> bytes:
    """Return an Argoverse 2 sweep of repeated :data:`POINTS` in the car's frame; laser numbers are not sorted."""
    import pyarrow as pa
    from pyarrow import feather as arrow

    table = pa.table(
        {
            **{name: pa.array(np.tile(POINTS[:, axis], repeats).astype(np.float16)) for axis, name in enumerate("xyz")},
            "intensity": pa.array(np.tile(INTENSITY, repeats).astype(np.uint8)),
            "laser_number": pa.array(np.tile(np.array((3, 1, 2, 0, 4, 5), np.uint8), repeats)),
            "offset_ns": pa.array(np.arange(6 * repeats, dtype=np.int32) * 1000_000 // repeats),
        }
    )
    buffer = io.BytesIO()
    arrow.write_feather(table, buffer, compression=compression)
    return buffer.getvalue()


def vlp16_payload(start_deg: float, step_deg: float, distance_m: float, product: int = 0x22) -> bytes:
    """Return a VLP-16 data packet: 12 blocks from an azimuth on (clockwise), with all beams at one distance."""
    payload = bytearray()
    for block in range(12):
        centidegrees = round(100 * (start_deg + block * step_deg)) % 36_000
        payload += struct.pack("<HH", 0xEEFF, centidegrees)
        payload += struct.pack("<HB", round(distance_m / 0.002), 77) * 32
    return bytes(payload) + struct.pack("<IBB", round(start_deg * 277), 0x37, product)


def vlp16_turns(turns: float = 2.3, distance_m: float = 5.0) -> list[bytes]:
    """Return the packets of some revolutions of a VLP-16."""
    step_deg = 2.4
    packets = int(turns * 360 / (12 * step_deg))
    return [vlp16_payload(index * 12 * step_deg, step_deg, distance_m) for index in range(packets)]


def udp_packet(payload: bytes) -> bytes:
    """Return an IPv4 packet body (UDP header and payload)."""
    return struct.pack(">HHHH", 2368, 2368, 8 + len(payload), 0) + payload


def ip_packet(body: bytes, *, offset: int = 0, more: bool = False, number: int = 7) -> bytes:
    """Return an Ethernet frame with an IPv4 packet or fragment."""
    flags = offset // 8 | (0x2000 if more else 0)
    header = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 20 + len(body), number, flags, 64, 17, 0, b"\x0a" * 4, b"\x0b" * 4)
    return b"\x02" * 12 + b"\x08\x00" + header + body


def fragments(payload: bytes, number: int = 7) -> list[bytes]:
    """Return the Ethernet frames of a UDP datagram in fragments."""
    body, size = udp_packet(payload), 1480
    starts = range(0, len(body), size)
    return [
        ip_packet(body[at : at + size], offset=at, more=at + size < len(body), number=number) for at in starts
    ]  # fmt: skip


def pcap(frames: list[bytes], order: str = "<") -> bytes:
    """Return a pcap file of Ethernet frames, one per millisecond from second 1000 on."""
    capture = bytearray(struct.pack(order + "IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65_535, 1))
    for index, frame in enumerate(frames):
        capture += struct.pack(order + "IIII", 1000, 1000 * index, len(frame), len(frame)) + frame
    return bytes(capture)


OUSTER_BEAMS_DEG = [12.0 - 0.75 * row for row in range(32)]
OUSTER_OFFSETS_DEG = [(-4.0, -1.5, 1.5, 4.0)[row % 4] for row in range(32)]


def ouster_metadata(columns: int = 64) -> bytes:
    """Return metadata of an invented Ouster sensor of 32 beams."""
    identity = np.eye(4).ravel().tolist()
    layout = {
        "column_window": [0, columns - 1], "columns_per_frame": columns, "columns_per_packet": 16,
        "pixel_shift_by_row": [0] * 32, "pixels_per_column": 32, "udp_profile_lidar": "LEGACY",
        "udp_profile_imu": "LEGACY",
    }  # fmt: skip
    about = {
        "prod_line": "OS-1-32", "prod_pn": "840", "prod_sn": "123", "build_rev": "v2.1.1", "image_rev": "x",
        "build_date": "2021-06-18T06:44:07Z", "base_pn": "", "base_sn": "", "hostname": "", "proto_rev": "v1.1.1",
        "status": "RUNNING",
    }  # fmt: skip
    geometry = {
        "beam_altitude_angles": OUSTER_BEAMS_DEG, "beam_azimuth_angles": OUSTER_OFFSETS_DEG, "lidar_mode": "512x10",
        "lidar_origin_to_beam_origin_mm": 15.8, "imu_to_sensor_transform": identity,
        "lidar_to_sensor_transform": [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 36.18, 0, 0, 0, 1],
    }  # fmt: skip
    return json.dumps({**about, **geometry, "data_format": layout}).encode()


def ouster_payloads(frames: int = 1, columns: int = 64) -> list[bytes]:
    """Return Ouster lidar packets of some revolutions; all beams of frame f are at 5000 + 1000 f millimeters."""
    payloads: list[bytes] = []
    for frame in range(1, frames + 1):
        pixels = struct.pack("<IHHHH", 4000 + 1000 * frame, 0, 0, 0, 0) * 32
        blocks = [
            struct.pack("<QHHI", 1_000_000_000 * frame + 1_000_000 * column, column, frame, 0) + pixels + b"\xff" * 4
            for column in range(columns)
        ]
        payloads += [b"".join(blocks[first : first + 16]) for first in range(0, columns, 16)]
    return payloads


def las(
    points: NDArray[np.float64], intensity: NDArray[np.generic], offset: tuple[float, ...] = (0.0, 0.0, 0.0)
) -> bytes:
    """Return a LAS 1.2 file of point format 0, with coordinates in millimeters relative to an offset."""
    low, high = points.min(axis=0), points.max(axis=0)
    bounds = [number for axis in range(3) for number in (high[axis], low[axis])]
    header = struct.pack(
        "<4sHHIHH8sBB32s32sHHHIIBHI5I12d", b"LASF", 0, 0, 0, 0, 0, bytes(8), 1, 2, b"", b"", 1, 2026, 227, 227, 0, 0,
        20, len(points), len(points), 0, 0, 0, 0, 1e-3, 1e-3, 1e-3, *offset, *bounds,
    )  # fmt: skip
    steps = np.rint((points - offset) * 1e3).astype(int)
    return header + b"".join(
        struct.pack("<3iHBBBBH", *map(int, row), int(value), 0, 0, 0, 0, 0)
        for row, value in zip(steps, intensity, strict=True)
    )


def sample_sweep() -> Sweep:
    """Return a sweep with every attribute set except the model."""
    return Sweep(
        POINTS, INTENSITY, ring=np.arange(6, dtype=np.int16), azimuth=np.arange(6) * 0.5,
        time_s=np.arange(6) * 0.01, t_ns=12, attitude=np.array([1.0, 0, 0, 0]), sensor_height_m=1.8,
        world_from_sensor=Rigid.from_yaw(1.0, (1, 2, 3)),
    )  # fmt: skip


def written_npz(sweep: Sweep) -> bytes:
    """Return a sweep as the NPZ file that viewshed writes."""
    with TemporaryDirectory() as folder:
        write_sweep(sweep, Path(folder) / "a.npz")
        return (Path(folder) / "a.npz").read_bytes()


def samples() -> dict[str, SampleFile]:
    """Return a small valid file of every kind that the readers accept, by a unique name."""
    table = np.column_stack((POINTS, INTENSITY))
    turns = vlp16_turns()
    files = {
        "nuscenes": SampleFile("nuscenes", "a.pcd.bin", rows(POINTS, INTENSITY, np.arange(6))),
        "kitti": SampleFile("kitti", "a.bin", rows(POINTS, INTENSITY)),
        "pcd ascii": SampleFile("pcd", "a.pcd", pcd(text(table), "ascii")),
        "pcd binary": SampleFile("pcd", "b.pcd", pcd(rows(table), "binary")),
        "pcd compressed": SampleFile("pcd", "c.pcd", pcd_compressed(np.repeat(table, 40, axis=0))),
        "ply ascii": SampleFile("ply", "a.ply", ply(text(table), "ascii")),
        "ply little endian": SampleFile("ply", "b.ply", ply(rows(table), "binary_little_endian")),
        "ply big endian": SampleFile("ply", "c.ply", ply(rows(table, order=">"), "binary_big_endian")),
        "npy": SampleFile("npy", "a.npy", npy(POINTS)),
        "npz": SampleFile("npz", "a.npz", npz(points=(POINTS * 1000).astype(np.int32))),
        "npz of viewshed": SampleFile("npz", "b.npz", written_npz(sample_sweep())),
        "las": SampleFile("las", "a.las", las(POINTS.astype(np.float64), INTENSITY)),
        "text with names": SampleFile("text", "a.csv", b"X;Y;Z;Intensity\n" + text(table).replace(b" ", b";")),
        "text": SampleFile("text", "a.xyz", b"# made by hand\n" + text(table)),
        "argoverse2 lz4": SampleFile("argoverse2", "a.feather", feather()),
        "argoverse2 zstd": SampleFile("argoverse2", "b.feather", feather("zstd")),
        "velodyne payloads": SampleFile("velodyne", "v.bin", b"".join(turns)),
        "velodyne pcap": SampleFile("velodyne", "v.pcap", pcap([ip_packet(udp_packet(one)) for one in turns])),
        "ply gzipped": SampleFile("ply", "a.ply.gz", gzip.compress(ply(text(table), "ascii"), mtime=0)),
    }
    capture = pcap([frame for number, one in enumerate(ouster_payloads()) for frame in fragments(one, number=number)])
    files["ouster pcap"] = SampleFile("ouster", "o.pcap", capture, {"o.json": ouster_metadata()})
    return files
