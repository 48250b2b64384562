"""Every format, from bytes made by hand to the points, rings and times they stand for."""

import io
import struct
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from viewshed import LidarModel, Rigid
from viewshed.io import read_sweep

files: Any = import_module("sweep_files")
recordings: Any = import_module("recording_files")
P, I = files.POINTS, files.INTENSITY  # noqa: E741
SAMPLES = files.samples()


@pytest.fixture
def put(tmp_path: Path) -> Any:
    def write(name: str, content: bytes) -> Path:
        (tmp_path / name).write_bytes(content)
        return tmp_path / name

    return write


PLAIN = ["kitti", "pcd ascii", "pcd binary", "ply ascii", "ply little endian", "ply big endian", "ply gzipped",
         "pcd compressed", "las", "text", "text with names"]  # fmt: skip


@pytest.mark.parametrize("name", PLAIN)
def test_points_and_intensity_come_out_as_they_were_put_in(name: str, put: Any) -> None:
    sweep = read_sweep(put(SAMPLES[name].name, SAMPLES[name].content))
    times = 40 if name == "pcd compressed" else 1
    np.testing.assert_allclose(sweep.points, np.repeat(P, times, axis=0), atol=1e-6)
    np.testing.assert_array_equal(sweep.intensity, np.repeat(I, times))
    assert sweep.ring is None


@pytest.mark.parametrize("name", sorted(SAMPLES))
def test_every_sample_is_recognized_and_equals_its_named_format(name: str, tmp_path: Path) -> None:
    sample = SAMPLES[name]
    for other, content in {sample.name: sample.content, **sample.beside}.items():
        (tmp_path / other).write_bytes(content)
    known = read_sweep(tmp_path / sample.name)
    named = read_sweep(tmp_path / sample.name, format=sample.format)
    assert len(known) > 0
    np.testing.assert_array_equal(known.points, named.points)


def test_nuscenes_x_right_y_forward_becomes_x_forward_y_left(put: Any) -> None:
    raw = np.array([[2.0, 7.0, -1.0, 55.0, 3.0], [-4.0, 1.0, 0.5, 66.0, 9.0]], np.float32)
    path = put("n008-2018__LIDAR_TOP__1533151603547590.pcd.bin", raw.tobytes())
    sweep = read_sweep(path)
    np.testing.assert_array_equal(sweep.points, [[7.0, -2.0, -1.0], [1.0, 4.0, 0.5]])
    assert sweep.ring.tolist() == [3, 9]
    assert sweep.t_ns == 1_533_151_603_547_590_000
    np.testing.assert_array_equal(read_sweep(path, file_frame="sensor").points, raw[:, :3])


def test_chunks_of_a_large_binary_sweep_are_joined_in_order(put: Any) -> None:
    rng = np.random.default_rng(0)
    table = np.column_stack((rng.normal(size=(150_001, 3)) * 20, rng.integers(0, 255, 150_001)))
    sweep = read_sweep(put("big.bin", files.rows(table)))
    np.testing.assert_array_equal(sweep.points, table[:, :3].astype(np.float32))
    rings = np.argsort(np.argsort(table[:, 2] / np.hypot(table[:, 0], table[:, 1]))) * 32 // 150_001
    nuscenes = read_sweep(put("big.pcd.bin", files.rows(table, rings)), file_frame="sensor")
    np.testing.assert_array_equal(nuscenes.points, table[:, :3].astype(np.float32))
    np.testing.assert_array_equal(nuscenes.ring, rings)


def test_bin_with_five_columns_is_known_by_its_rings(put: Any) -> None:
    content = files.rows(np.tile(P, (10, 1)), np.tile(I, 10), np.tile(np.arange(6), 10))
    assert len(content) % 16 == 0
    assert read_sweep(put("five.bin", content)).ring is not None
    four = files.rows(np.tile(P, (10, 1)), np.tile(I, 10))
    assert len(four) % 20 == 0
    assert len(read_sweep(put("four.bin", four))) == 60


def test_pcd_fields_of_any_type_order_and_count(put: Any) -> None:
    header = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS normal ring z _ timestamp y x\nSIZE 4 2 8 1 8 4 4\nTYPE F U F U F F F\n"
        "COUNT 3 1 1 5 1 1 1\nWIDTH 2\nHEIGHT 3\nPOINTS 6\nDATA binary\n"
    )
    body = b"".join(
        struct.pack("<3fHd5Bdff", 9, 9, 9, ring, z, 0, 0, 0, 0, 0, 1.7e9 + 0.01 * ring, y, x)
        for ring, (x, y, z) in enumerate(P.tolist())
    )
    sweep = read_sweep(put("o.pcd", header.encode() + body))
    np.testing.assert_array_equal(sweep.points, P)
    assert sweep.ring.tolist() == [0, 1, 2, 3, 4, 5]
    np.testing.assert_allclose(sweep.time_s, 0.01 * np.arange(6), atol=1e-6)


@pytest.mark.parametrize(
    ("scale", "sign", "zero"), [(1.0, -1.0, 0.0), (180 / np.pi, 1.0, np.pi / 2), (18000 / np.pi, -1.0, np.pi)]
)
def test_pcd_azimuth_of_any_unit_and_sign_becomes_ours(scale: float, sign: float, zero: float, put: Any) -> None:
    true = np.arctan2(P[:, 1], P[:, 0]).astype(np.float64)
    told = np.mod(sign * (true - zero), 2 * np.pi) * scale
    content = files.pcd(files.rows(P, told), "binary", "x y z azimuth")
    azimuth = read_sweep(put("a.pcd", content)).azimuth
    np.testing.assert_allclose(azimuth, true, atol=1e-4)
    turned = read_sweep(put("a.pcd", content), file_frame="carla")
    np.testing.assert_allclose(turned.azimuth, np.arctan2(-P[:, 0], -P[:, 1]), atol=1e-4)


@pytest.mark.parametrize(
    ("field", "values", "rule"),
    [
        ("ring", [0, 1, 1.5, 3, 4, 5], "ring is left out: it must be whole numbers"),
        ("ring", [0, 1, -1, 3, 4, 5], "ring is left out"),
        ("ring", [0, 1, np.nan, 3, 4, 5], "ring is left out"),
        ("ring", [0, 1, 70_000, 3, 4, 5], "ring is left out"),
        ("time", [0, 0.1, np.nan, 0.3, 0.4, 0.5], "time is left out: it must be finite and within one revolution"),
        ("time", [0, 0.1, 0.2, 0.3, 0.4, 2.1], "time is left out"),
        ("azimuth", [0.3, 9.1, 4.4, 2.2, 7.7, 1.1], "azimuth is left out: no choice of unit, sign and zero"),
    ],
)
def test_columns_of_others_that_cannot_be_are_left_out_with_a_warning(
    field: str, values: list[float], rule: str, put: Any
) -> None:
    content = files.pcd(files.rows(P, values), "binary", f"x y z {field}")
    with pytest.warns(UserWarning, match=rf"a\.pcd: {rule}"):
        sweep = read_sweep(put("a.pcd", content))
    assert sweep.points.tolist() == P.tolist()
    assert (sweep.ring, sweep.time_s, sweep.azimuth) == (None, None, None)


def test_text_takes_names_in_any_order_and_any_separator(put: Any) -> None:
    sweep = read_sweep(put("a.csv", b'"intensity","z","y","x"\r\n7,3,2,1.5\r\n\r\n8,6,5,4\r\n'))
    assert sweep.points.tolist() == [[1.5, 2, 3], [4, 5, 6]]
    assert sweep.intensity.tolist() == [7, 8]
    assert read_sweep(put("b.xyz", b"1\t2\t3\n4\t5\t6")).points.tolist() == [[1, 2, 3], [4, 5, 6]]


PLACE = np.array([566_000.123, 5_930_000.456, 12.0])
IN_A_MAP = {
    "a.las": files.las(P + PLACE, I, (566_000.0, 5_930_000.0, 0.0)),
    "a.csv": "".join(f"{x:.4f},{y:.4f},{z:.4f}\n" for x, y, z in (P + PLACE)).encode(),
}


@pytest.mark.parametrize("name", [*IN_A_MAP, "a.laz"])
def test_coordinates_of_a_map_keep_their_millimeters(name: str, put: Any) -> None:
    laspy = pytest.importorskip("laspy")
    if name == "a.laz":
        packed = io.BytesIO()
        laspy.read(io.BytesIO(IN_A_MAP["a.las"])).write(packed, do_compress=True)
        content = packed.getvalue()
    else:
        content = IN_A_MAP[name]
    sweep = read_sweep(put(name, content), file_frame=Rigid(np.eye(3), -PLACE))
    np.testing.assert_allclose(sweep.points, P, atol=6e-4)  # float32 stores the northing in steps of half a meter


def test_arrays_of_int32_are_millimeters_of_floats_meters_and_the_only_one_of_an_npz_the_points(put: Any) -> None:
    np.testing.assert_allclose(read_sweep(put("m.npy", files.npy((P * 1000).astype(np.int32)))).points, P, atol=1e-6)
    wide = np.asfortranarray(np.column_stack((P, I)).astype(np.float64))
    sweep = read_sweep(put("f.npy", files.npy(wide)))
    np.testing.assert_array_equal(sweep.points, P)
    assert sweep.intensity.tolist() == I.tolist()
    np.testing.assert_array_equal(read_sweep(put("one.npz", files.npz(cloud=P))).points, P)


def test_argoverse_points_move_from_the_car_to_the_lidar_and_lasers_to_rings(put: Any) -> None:
    above = P + np.array([0, 0, 1.64042], np.float32)
    sweep = read_sweep(put("log_315966265259836000.feather", files.feather()))
    np.testing.assert_allclose(sweep.points, P - [1.35018, 0, 1.64042], atol=2e-3)
    elevation = (above[:, 2] - 2 * 1.64042) / np.hypot(P[:, 0] - 1.35018, P[:, 1])
    assert sweep.ring.tolist() == np.argsort(np.argsort(elevation)).tolist()
    assert sweep.t_ns == 315_966_265_259_836_000
    np.testing.assert_allclose(sweep.time_s, 0.001 * np.arange(6), atol=1e-6)


@pytest.mark.parametrize("known", [True, False])
def test_a_model_tells_the_places_of_lasers_in_no_order_of_which_two_have_no_returns(known: bool, put: Any) -> None:
    elevation, order = np.deg2rad([-20.0, -12.0, -7.0, -1.0, 2.0, 9.0]), np.array([3, 0, 5, 1, 4, 2])
    beam = np.repeat([0, 1, 3, 4], 40)
    azimuth, range_m = np.random.default_rng(3).uniform([[-3.0], [3.0]], [[3.0], [40.0]], (2, 160))
    at = range_m * np.stack([np.cos(azimuth), np.sin(azimuth), np.tan(elevation[beam])])
    columns = {**dict(zip("xyz", at.astype(np.float32), strict=True)), "intensity": np.zeros(160, np.uint8)}
    content = recordings.feather(
        **columns, laser_number=order[beam].astype(np.uint8), offset_ns=np.zeros(160, np.int32)
    )
    model = LidarModel("six", elevation, 40) if known else None
    ring = read_sweep(put("a.feather", content), sensor=model, file_frame="sensor").ring
    assert ring.tolist() == (beam if known else np.repeat(np.arange(4), 40)).tolist()


def test_given_knowledge_reaches_the_sweep(put: Any) -> None:
    pose = Rigid.from_yaw(0.5, (1.0, 2.0, 3.0))
    known: dict[str, Any] = {"sensor_height_m": 1.9, "attitude": (1, 0, 0, 0), "world_from_sensor": pose}
    sweep = read_sweep(put("a.bin", files.rows(P, I)), sensor="VLP-16", **known)
    assert (sweep.model.rings, sweep.sensor_height_m) == (16, 1.9)
    assert sweep.world_from_sensor is pose
    assert sweep.attitude.tolist() == [1, 0, 0, 0]


@pytest.mark.parametrize(
    ("frame", "expected"),
    [("sensor", [2, 3, 4]), ("nuscenes", [3, -2, 4]), ("carla", [-3, -2, -4]), ("pandaset", [2, 3, 2.2]),
     (Rigid.from_yaw(np.pi / 2, (1, 1, 1)), [-2, 3, 5])],
)  # fmt: skip
def test_file_frames(frame: str | Rigid, expected: list[float], put: Any) -> None:
    path = put("a.bin", files.rows([[2.0, 3.0, 4.0]], [1.0]))
    np.testing.assert_allclose(read_sweep(path, file_frame=frame, format="kitti").points, [expected], atol=1e-6)


def test_a_header_that_says_zero_points_is_an_empty_sweep(put: Any) -> None:
    for name, content in {
        "e.pcd": files.pcd(b"", "binary", count=0),
        "t.pcd": files.pcd(b"", "ascii", count=0),
        "e.ply": files.ply(b"", "ascii", 0),
        "e.npy": files.npy(np.zeros((0, 3), np.float32)),
        "e.npz": files.npz(points=np.zeros((0, 3), np.int32)),
    }.items():
        assert len(read_sweep(put(name, content))) == 0
