"""nuScenes' tables, written here with sweeps whose poses are known, come back as what was written."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.recordings.read.test_kitti import lines_of

from viewshed.geometry import Rigid, quaternion_from_rotation
from viewshed.io import read_sweep
from viewshed.recordings.read import open_source
from viewshed.recordings.read.source import each_sweep

NuscenesTables = dict[str, list[dict[str, Any]]]

CALIBRATION = Rigid.from_yaw(-1.5, (0.94, 0.02, 1.84))  # ego from LIDAR_TOP: x right, y forward
TURN = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # x forward, y left ← x right, y forward


def _pose(pose: Rigid) -> dict[str, list[float]]:
    return {"rotation": quaternion_from_rotation(pose.rotation).tolist(), "translation": pose.translation.tolist()}


def write_tree(root: Path, sweeps: list[tuple[bytes, int, Rigid]], version: str = "v1.0-mini") -> NuscenesTables:
    """Write one scene: (content, time in µs, world_from_sensor) of each sweep; every second one is a keyframe."""
    tables: NuscenesTables = {
        "sensor": [
            {"token": "se-l", "channel": "LIDAR_TOP", "modality": "lidar"},
            {"token": "se-c", "channel": "CAM_FRONT", "modality": "camera"},
        ],
        "calibrated_sensor": [
            {"token": "ca-l", "sensor_token": "se-l", "camera_intrinsic": [], **_pose(CALIBRATION)},
            {"token": "ca-c", "sensor_token": "se-c", "camera_intrinsic": [[1.0]], **_pose(Rigid.identity())},
        ],
        "log": [{"token": "lo", "logfile": "x", "vehicle": "n", "date_captured": "2018-08-01", "location": "b"}],
        "scene": [
            {"token": "sc0", "log_token": "lo", "name": "scene-0000", "description": "empty, {not} ours"},
            {"token": "sc1", "log_token": "lo", "name": "scene-0103", "description": "Many peds, right turn"},
        ],
        "sample": [], "sample_data": [], "ego_pose": [],
        "category": [{"token": "k0", "name": "vehicle.car"}, {"token": "k1", "name": "human.pedestrian.adult"}],
        "instance": [{"token": "i0", "category_token": "k0"}, {"token": "i1", "category_token": "k1"}],
        "sample_annotation": [],
    }  # fmt: skip
    for number, (content, t_us, world_from_sensor) in enumerate(sweeps):
        keyframe = number % 2 == 0
        name = f"{'samples' if keyframe else 'sweeps'}/LIDAR_TOP/n008__LIDAR_TOP__{t_us:016d}.pcd.bin"
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(content)
        ego = world_from_sensor @ Rigid(TURN, np.zeros(3)) @ CALIBRATION.inverse()
        tables["ego_pose"].append({"token": f"sd{number}", "timestamp": t_us, **_pose(ego)})
        tables["sample"].append({"token": f"sa{number}", "timestamp": t_us, "scene_token": "sc1"})
        shared = {"ego_pose_token": f"sd{number}", "is_key_frame": keyframe, "height": 0, "width": 0}
        tables["sample_data"] += [
            {"token": f"sd{number}", "sample_token": f"sa{number}", "calibrated_sensor_token": "ca-l", "filename": name,
             "timestamp": t_us, "fileformat": "pcd", "prev": "", "next": "", **shared},
            {"token": f"im{number}", "sample_token": f"sa{number}", "calibrated_sensor_token": "ca-c",
             "filename": f"samples/CAM_FRONT/{t_us}.jpg", "timestamp": t_us, "fileformat": "jpg", **shared},
        ]  # fmt: skip
    tables["sample_annotation"] = [
        {"token": "an0", "sample_token": "sa0", "instance_token": "i0", "size": [1.9, 4.6, 1.7],
         "translation": [373.2, 1130.4, 0.8], "rotation": [0.0, 0.0, 0.0, 1.0], "num_lidar_pts": 57},
        {"token": "an1", "sample_token": "sa0", "instance_token": "i1", "size": [0.6, 0.7, 1.8],
         "translation": [380.0, 1120.0, 0.9], "rotation": [0.7071067811865476, 0.0, 0.0, 0.7071067811865476]},
        {"token": "an2", "sample_token": "sa2", "instance_token": "i0", "size": [1.9, 4.6, 1.7],
         "translation": [374.0, 1130.4, 0.8], "rotation": [0.0, 0.0, 0.0, 1.0], "num_lidar_pts": 8},
    ]  # fmt: skip
    put(root / version, tables)
    return tables


def put(folder: Path, tables: NuscenesTables) -> None:
    folder.mkdir(exist_ok=True)
    for name, rows in tables.items():
        (folder / f"{name}.json").write_text(json.dumps(rows, indent=0))


def made(seed: int, count: int = 300) -> bytes:
    """A file's content: points in front of a car that is in x right, y forward, with rings."""
    rng = np.random.default_rng(seed)
    rows = np.concatenate([rng.normal((3, 12, -1), (4, 6, 0.5), (count, 3)), rng.uniform(0, 255, (count, 1)),
                           rng.integers(0, 32, (count, 1))], axis=1)  # fmt: skip
    return rows.astype("<f4").tobytes()


WORLD = [Rigid.from_yaw(0.3 + 0.1 * k, (370.0 + k, 1130.0 - 2.0 * k, 1.8)) for k in range(4)]


@pytest.fixture
def tree(tmp_path: Path) -> tuple[Path, NuscenesTables]:
    sweeps = [(made(k), 1_533_151_603_547_590 + 50_000 * k, WORLD[k]) for k in range(4)]
    return tmp_path, write_tree(tmp_path, sweeps)


def test_a_point_ahead_of_the_car_lands_ahead_of_it_in_the_world(tmp_path: Path) -> None:
    """By hand: the car at (100, 50) faces north, so what is 10 m ahead and 2 m left is at (98, 60)."""
    content = np.array([[-2.0, 10.0, -1.0, 7.0, 3.0]], "<f4").tobytes()
    write_tree(tmp_path, [(content, 1_000_000, Rigid.from_yaw(np.pi / 2, (100.0, 50.0, 1.84)))])
    [(ref, sweep)] = each_sweep(open_source(tmp_path))
    assert sweep.points.tolist() == [[10.0, 2.0, -1.0]]
    np.testing.assert_allclose(sweep.world_from_sensor @ sweep.points, [[98.0, 60.0, 0.84]], atol=1e-9)
    assert (ref.t_ns, sweep.t_ns, sweep.agent) == (1_000_000_000, 1_000_000_000, "ego")
    assert np.array_equal(sweep.ring, [3])


def test_sweeps_come_back_in_time_order_with_poses_times_and_beams(tree: tuple[Path, NuscenesTables]) -> None:
    root, tables = tree
    tables["sample_data"].reverse()
    tables["ego_pose"] = tables["ego_pose"][2:] + tables["ego_pose"][:2]
    put(root / "v1.0-mini", tables)
    source = open_source(root)
    assert source.scenes() == ("scene-0000", "scene-0103")
    assert source.refs("scene-0000") == []
    refs = source.refs("scene-0103")
    assert [ref.key for ref in refs] == ["sd0", "sd1", "sd2", "sd3"]
    assert [ref.index for ref in refs] == [0, 1, 2, 3]
    assert [ref.keyframe for ref in refs] == [True, False, True, False]
    for k, ref in enumerate(refs):
        sweep = source.read(ref)
        assert np.array_equal(sweep.points, read_sweep(ref.file).points)
        assert sweep.t_ns == ref.t_ns == (1_533_151_603_547_590 + 50_000 * k) * 1000
        assert sweep.sensor_height_m == pytest.approx(1.84)
        assert sweep.model.name == "HDL-32E"
        np.testing.assert_allclose(sweep.world_from_sensor.as_matrix(), WORLD[k].as_matrix(), atol=1e-9)
    assert source.damage() == ()


def test_boxes_of_keyframes_are_in_the_world_with_length_along_the_heading(tree: tuple[Path, NuscenesTables]) -> None:
    source = open_source(tree[0])
    first, between, last, _ = source.refs("scene-0103")
    car, person = source.boxes(first)
    assert (car.category, car.track, car.size_m) == ("vehicle.car", "i0", (4.6, 1.9, 1.7))
    assert car.center.tolist() == [373.2, 1130.4, 0.8]
    assert abs(car.yaw) == pytest.approx(np.pi)
    assert (car.returns, person.returns) == (57, None)
    assert person.category == "human.pedestrian.adult"
    assert person.yaw == pytest.approx(np.pi / 2)
    # The count of a keyframe is not that of a sweep before it.
    assert [(box.track, box.returns) for box in source.boxes(between) or ()] == [("i0", None)]
    assert [box.track for box in source.boxes(last) or ()] == ["i0"]


def test_boxes_between_keyframes_go_straight_and_turn_the_shorter_way(tmp_path: Path) -> None:
    """By hand: three quarters of the way from 170° to 210° (as -150°), and from x = 373.2 m to 374.0 m."""
    times = [1_000_000, 1_375_000, 1_500_000, 1_600_000]
    tables = write_tree(tmp_path, [(made(k), t_us, WORLD[k]) for k, t_us in enumerate(times)])
    for row, yaw_deg in ((0, 170.0), (2, -150.0)):
        half = np.radians(yaw_deg) / 2
        tables["sample_annotation"][row]["rotation"] = [np.cos(half), 0.0, 0.0, np.sin(half)]
    put(tmp_path / "v1.0-mini", tables)
    source = open_source(tmp_path)
    refs = source.refs("scene-0103")
    [box] = source.boxes(refs[1]) or ()
    assert box.track == "i0"
    np.testing.assert_allclose(box.center, [373.8, 1130.4, 0.8])
    assert np.degrees(box.yaw) % 360 == pytest.approx(200.0)
    assert box.size_m == (4.6, 1.9, 1.7)
    assert source.boxes(refs[3]) is None  # no keyframe comes after it


def test_a_damaged_box_costs_the_sweeps_on_both_sides_of_its_keyframe(tree: tuple[Path, NuscenesTables]) -> None:
    root, tables = tree
    tables["sample_annotation"][2]["size"] = [1.0, 2.0]
    put(root / "v1.0-mini", tables)
    source = open_source(root)
    first, between, last, _ = source.refs("scene-0103")
    assert len(source.boxes(first) or ()) == 2
    for ref in (between, last):
        with pytest.raises(ValueError, match=r"annotation.json: row 2: [^\n]*$"):
            source.boxes(ref)


def test_the_test_version_has_no_boxes(tree: tuple[Path, NuscenesTables]) -> None:
    root, tables = tree
    put(root / "v1.0-mini", {**tables, "sample_annotation": [], "instance": []})
    source = open_source(root)
    assert [source.boxes(ref) for ref in source.refs("scene-0103")] == [None] * 4


def test_the_version_is_named_where_there_are_several(tree: tuple[Path, NuscenesTables]) -> None:
    root, tables = tree
    put(root / "v1.0-test", tables)
    with pytest.raises(ValueError, match=r"one version of nuScenes .*, got v1.0-mini, v1.0-test; name one of these"):
        open_source(root)
    assert len(open_source(root / "v1.0-test").refs("scene-0103")) == 4


@pytest.mark.parametrize("name", ["sensor", "calibrated_sensor", "scene", "sample", "sample_data", "ego_pose"])
def test_a_missing_or_broken_table_is_named(name: str, tree: tuple[Path, NuscenesTables]) -> None:
    place = tree[0] / "v1.0-mini" / f"{name}.json"
    content = place.read_text()
    for damaged in (content[: len(content) // 2], content.replace("]", "", 1)[:-1], "{}", '["a"]', "[[[[", "no json"):
        place.write_text(damaged)
        with pytest.raises(ValueError, match=rf"{name}\.json: must be a JSON list of objects[^\n]*$"):
            open_source(tree[0])
    place.unlink()
    with pytest.raises(OSError, match=rf"^[^\n]*{name}\.json: No such file"):
        open_source(tree[0], "nuscenes")


def _change(table: str, row: int, key: str, value: Any) -> Callable[[NuscenesTables], object]:
    return lambda tables: tables[table][row].update({key: value})


def _shift_a_number(tables: NuscenesTables) -> None:
    tables["ego_pose"][1] |= {"rotation": [1.0, 0.0, 0.0], "translation": [0.0, 1.0, 2.0, 3.0]}


@pytest.mark.parametrize(
    ("damage", "line"),
    [
        (_change("sample_data", 2, "ego_pose_token", "nowhere"), r"103\|.*597590.*ego_pose.json has no row 'nowhere'"),
        (
            _change("sample_data", 2, "sample_token", "x"),
            r"^\|.*sample_data.json: .*597590.* no sample of a scene, 'x'",
        ),
        (_change("sample_data", 2, "timestamp", "soon"), r"^\|.*_data.json: row 2 must have a whole number as 't"),
        (_change("sample_data", 2, "filename", "../LIDAR_TOP"), r"103\|.* leads out of .*; refused"),
        (_change("sample_data", 2, "filename", "sweeps/LIDAR_TOP/gone.pcd.bin"), r"103\|.*gone.pcd.bin: No such file"),
        (_change("sample", 1, "scene_token", "x"), r"^\|.*sample.json: row 'sa1' names no row of scene.json, 'x'"),
        (_change("ego_pose", 1, "rotation", [0.0, 0.0, 0.0, 0.0]), r"597590.*ego_pose.json, row 'sd1': .*norm 1"),
        (_shift_a_number, r"597590.*ego_pose.json, row 'sd1': .* finite"),
        (_change("ego_pose", 1, "translation", 5), r"^\|.*ego_pose.json: row 1 must have a list as 'translation'"),
    ],
)
def test_a_damaged_row_costs_one_sweep_and_is_told(
    damage: Callable[[NuscenesTables], object], line: str, tree: tuple[Path, NuscenesTables]
) -> None:
    root, tables = tree
    damage(tables)
    put(root / "v1.0-mini", tables)
    keys, told = lines_of(open_source(root))
    assert keys == ["sd0", "sd2", "sd3"]
    assert any(re.search(line, text) for text in told), told


@pytest.mark.parametrize(
    ("damage", "line"),
    [
        (_change("sample_annotation", 1, "instance_token", "x"), r"annotation.json: row 1 names no object .*, 'x'"),
        (_change("instance", 1, "category_token", "x"), r"annotation.json: row 1 names no object .*, 'i1'"),
        (
            _change("sample_annotation", 1, "size", [1.0, -2.0, 1.0]),
            r"annotation.json: row 1: size_m must be three pos",
        ),
        (_change("sample_annotation", 1, "rotation", None), r"annotation.json: row 1: quaternion must be four finite"),
    ],
)
def test_a_damaged_box_is_told_where_it_is_asked_for(
    damage: Callable[[NuscenesTables], object], line: str, tree: tuple[Path, NuscenesTables]
) -> None:
    root, tables = tree
    damage(tables)
    put(root / "v1.0-mini", tables)
    source = open_source(root)
    first, _, last, _ = source.refs("scene-0103")
    with pytest.raises(ValueError, match=line):
        source.boxes(first)
    assert len(source.boxes(last) or ()) == 1
