"""Ouster's packets: a packet by hand, every layout against ouster-sdk, and metadata that cannot be."""

import json
import struct
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from viewshed.io.ouster_packets import PROFILES, OusterDecoder, OusterMetadata
from viewshed.io.velodyne import udp_payloads

files: Any = import_module("sweep_files")

COLUMNS = 64


def metadata(**changes: Any) -> dict[str, Any]:
    """Return metadata of a sensor of 32 beams, with changes of its layout."""
    found: dict[str, Any] = json.loads(files.ouster_metadata(COLUMNS))
    found["data_format"] |= changes
    return found


def decoder_of(found: dict[str, Any]) -> OusterDecoder:
    return OusterDecoder(OusterMetadata.parse(json.dumps(found)))


def rng19_packet(first: int, frame: int, *, start: int = 0, serial: int = 123, valid: int = 1) -> bytes:
    """Return a packet of 16 columns, beam r of column c at 1000 + 100 r + c millimeters with signal 7 r."""
    head = struct.pack("<HH", 1, frame) + start.to_bytes(3, "little") + serial.to_bytes(5, "little")
    body = b""
    for column in range(first, first + 16):
        body += struct.pack("<QHH", 5_000_000 + 1000 * column, column, valid)
        # The bits above the 19 of the range are others' business.
        body += b"".join(
            struct.pack("<IBBHHH", (0xABC << 19) | (1000 + 100 * r + column), r, 0, 7 * r, 1, 2) for r in range(32)
        )
    return head.ljust(32, b"\x00") + body + bytes(32)


def test_a_revolution_by_hand() -> None:
    decoder = decoder_of(metadata(udp_profile_lidar="RNG19_RFL8_SIG16_NIR16"))
    assert decoder.packet_bytes == len(rng19_packet(0, 1)) == 6400
    packets = [rng19_packet(first, 9) for first in range(0, COLUMNS, 16)]
    [columns] = decoder.revolutions(packets)
    assert columns.t_ns == 5_000_000
    assert len(columns.points) == 32 * COLUMNS
    # Rows of a packet are the highest beam first, rings the lowest.
    assert columns.ring[:3].tolist() == [31, 30, 29]
    assert columns.intensity[:3].tolist() == [0.0, 7.0, 14.0]
    np.testing.assert_allclose(columns.time_s[[0, -1]], [0.0, 63e-6], rtol=1e-5)
    # Column 0 begins behind the sensor; the beam starts 15.8 mm from the axis and 36.18 mm above the base.
    altitude, turn = np.deg2rad(files.OUSTER_BEAMS_DEG[5]), -np.deg2rad(files.OUSTER_OFFSETS_DEG[5])
    out_m, start_m = 1.5 - 0.0158, 0.0158
    expected = [
        -(out_m * np.cos(altitude) * np.cos(turn) + start_m),
        -(out_m * np.cos(altitude) * np.sin(turn)),
        out_m * np.sin(altitude) + 0.03618,
    ]
    np.testing.assert_allclose(columns.points[5], expected, atol=1e-6)


def test_packets_out_of_order_twice_late_and_of_others() -> None:
    decoder = decoder_of(metadata(udp_profile_lidar="RNG19_RFL8_SIG16_NIR16"))
    one = [rng19_packet(first, 65535) for first in (16, 0, 48, 32, 32)]
    two = [rng19_packet(first, 0) for first in range(0, COLUMNS, 16)]
    others = [rng19_packet(0, 7, serial=99), b"", bytes(6399)]
    found = list(decoder.revolutions([*one, *others, two[0], one[0], *two[1:]]))
    assert [len(columns.points) for columns in found] == [32 * COLUMNS] * 2
    np.testing.assert_array_equal(found[0].points, found[1].points)


def test_columns_that_are_not_valid_are_left_out() -> None:
    decoder = decoder_of(metadata(udp_profile_lidar="RNG19_RFL8_SIG16_NIR16"))
    packets = [rng19_packet(first, 1, valid=int(first > 0)) for first in range(0, COLUMNS, 16)]
    [columns] = decoder.revolutions(packets)  # incomplete, but there is no other
    assert len(columns.points) == 32 * 48
    behind = decoder_of(metadata(udp_profile_lidar="RNG19_RFL8_SIG16_NIR16", column_window=[16, 63]))
    assert behind.decode(packets)[1]
    assert not behind.decode(packets[:-1])[1]
    around = decoder_of(metadata(udp_profile_lidar="RNG19_RFL8_SIG16_NIR16", column_window=[48, 31]))
    assert not around.decode(packets)[1]
    assert around.decode([rng19_packet(first, 1) for first in (0, 16, 48)])[1]


def test_no_packets_of_this_sensor() -> None:
    with pytest.raises(ValueError, match="holds no lidar packets that agree with the metadata"):
        list(decoder_of(metadata()).revolutions([b"", bytes(48)]))


@pytest.mark.parametrize("profile", PROFILES)
def test_every_layout_equals_the_makers_decoder(profile: str) -> None:
    core = pytest.importorskip("ouster.sdk.core")
    text = json.dumps(metadata(udp_profile_lidar=profile))
    rng = np.random.default_rng(1)
    info = core.SensorInfo(text)
    image = core.LidarFrame(info)
    rows = 32
    low_rate = "RNG15" in profile
    image.field("RANGE")[:] = rng.integers(0, 2**15, (rows, COLUMNS)) * 8 * (rng.random((rows, COLUMNS)) > 0.2)
    name = "REFLECTIVITY" if low_rate else "SIGNAL"
    image.field(name)[:] = rng.integers(0, 200, (rows, COLUMNS))
    image.status[:] = 1
    image.measurement_id[:] = np.arange(COLUMNS)
    image.timestamp[:] = np.arange(COLUMNS) * 1_000_000 + 17
    image.frame_id = 5
    packets = [bytes(each.buf) for each in core.frame_to_packets(image, core.PacketFormat(info), 0, 123)]
    decoder = OusterDecoder(OusterMetadata.parse(text))
    assert [decoder.frame_number(packet) for packet in packets] == [5] * 4
    columns, is_complete = decoder.decode(packets)
    column, row = np.nonzero(image.field("RANGE").T)
    assert is_complete
    assert columns.t_ns == 17
    np.testing.assert_allclose(columns.points, core.XYZLut(info, False)(image)[row, column], atol=1e-4)
    np.testing.assert_array_equal(columns.intensity, image.field(name)[row, column])


CAPTURES = ("data/ouster/*.pcap", "recordings/ouster-lidar__ouster-sdk/tests/pcaps/*.pcap")


@pytest.mark.parametrize("pattern", CAPTURES)
def test_real_captures_equal_the_makers_decoder(pattern: str, real_data: Path) -> None:
    core = pytest.importorskip("ouster.sdk.core")
    captures = sorted(real_data.parent.glob(pattern))
    if not captures:
        pytest.skip("no captures")
    compared = 0
    for capture in captures:
        payloads = [payload for _, payload in udp_payloads(capture.read_bytes())]
        for beside in sorted(capture.parent.glob(f"{capture.stem}*.json")):
            if "digest" in beside.name:
                continue
            info = core.SensorInfo(beside.read_text())
            decoder = OusterDecoder(OusterMetadata.parse(beside.read_text()))
            packets = next(decoder.grouped(payloads), None)
            if packets is None:  # metadata of the other sensor of a capture of two
                continue
            compared += 1
            image, batcher, packet = (
                core.LidarFrame(info),
                core.FrameBatcher(info),
                core.LidarPacket(core.PacketFormat(info)),
            )
            for each in packets:
                packet.buf[:] = np.frombuffer(each, np.uint8)
                assert packet.validate(info) == core.PacketValidationFailure.NONE
                batcher.batch(packet, image)
            hit = (image.field("RANGE") > 0) & ((image.status & 1) > 0)
            column, row = np.nonzero(hit.T)
            columns, is_complete = decoder.decode(packets)
            assert is_complete == image.complete(info.format.column_window)
            np.testing.assert_allclose(columns.points, core.XYZLut(info, False)(image)[row, column], atol=1e-4)
    assert compared >= 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is no JSON"),
        ("[]", "must be an object, got list"),
        ("[" * 100_000, "is no JSON"),
        ("{}", "beam_altitude_angles must be a list of 1 to 512 numbers"),
        (json.dumps(metadata(udp_profile_lidar="XYZ")), "udp_profile_lidar must be one of LEGACY, .* got XYZ"),
        (json.dumps(metadata(udp_profile_lidar=None)), "udp_profile_lidar must be one of LEGACY, .* got None"),
        (json.dumps(metadata(columns_per_frame=0)), r"columns_per_frame must be a whole number in \[1, 8192\], got 0"),
        (json.dumps(metadata(columns_per_frame="64")), "columns_per_frame must be a whole number"),
        (json.dumps(metadata(columns_per_packet=10**9)), "columns_per_packet must be a whole number"),
        (json.dumps(metadata(pixels_per_column=64)), "must name 64 beam angles of each kind, got 32 and 32"),
        (json.dumps(metadata(column_window=[0, 64])), r"column_window must be two columns in \[0, 64\), got \[0, 64\]"),
        (json.dumps(metadata(column_window=5)), "column_window must be two columns"),
        (json.dumps(metadata() | {"data_format": 3}), "data_format must be an object, got int"),
        (json.dumps(metadata() | {"beam_azimuth_angles": [float("nan")] * 32}), "beam_azimuth_angles must be a list"),
        (json.dumps(metadata() | {"lidar_origin_to_beam_origin_mm": "x"}), "lidar_origin_to_beam_origin_mm must be"),
        (
            json.dumps(metadata() | {"lidar_to_sensor_transform": [1, 2]}),
            "lidar_to_sensor_transform must be 16 numbers",
        ),
    ],
)
def test_metadata_that_cannot_be_are_refused(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        OusterMetadata.parse(text)


def test_metadata_of_the_newer_kind_say_the_same() -> None:
    old = metadata(udp_profile_lidar="RNG15_RFL8_NIR8")
    new = {
        "sensor_info": {"prod_line": old["prod_line"], "prod_sn": old["prod_sn"]},
        "beam_intrinsics": {key: old[key] for key in ("beam_altitude_angles", "beam_azimuth_angles")}
        | {"beam_to_lidar_transform": [1, 0, 0, 15.8, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]},
        "lidar_intrinsics": {"lidar_to_sensor_transform": old["lidar_to_sensor_transform"]},
        "lidar_data_format": old["data_format"],
    }
    first, second = (OusterMetadata.parse(json.dumps(each)) for each in (old, new))
    for name in ("profile", "columns", "window", "origin_mm", "product", "serial"):
        assert getattr(first, name) == getattr(second, name), name
    np.testing.assert_array_equal(first.altitude, second.altitude)
    np.testing.assert_array_equal(first.sensor_from_lidar, second.sensor_from_lidar)
