"""CARLA recordings: frames computed by hand, two real cars that must see one world, tables that are damaged."""

import json
import pickle
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed.recordings.read import open_source
from viewshed.recordings.read.carla import lidar_of_carla, rotation_of_carla
from viewshed.recordings.read.source import each_sweep

HEADER = "frame,t_ns,x,y,z,roll,pitch,yaw\n"


def _recording(folder: Path, sweeps: dict[str, dict[int, Any]], **about: Any) -> Path:
    """A recording with (N, 3) points in NPY files; poses are (t_ns, x, y, z, roll, pitch, yaw)."""
    for agent, frames in sweeps.items():
        (folder / agent).mkdir(parents=True)
        for frame, (points, _) in frames.items():
            np.save(folder / agent / f"{frame:06d}.npy", np.asarray(points, np.float32))
        rows = [",".join(map(str, (frame, *pose))) for frame, (_, pose) in frames.items() if pose is not None]
        (folder / agent / "poses.csv").write_text(HEADER + "\n".join(rows) + "\n")
    if about:
        (folder / "recording.json").write_text(json.dumps(about))
    return folder


def _points(count: int = 20) -> NDArray[np.float32]:
    return np.random.default_rng(4).uniform(-30, 30, (count, 3)).astype(np.float32)


def test_all_three_angles_as_the_client_of_carla_0_9_16_says() -> None:
    # carla.Transform(carla.Location(1, 2, 3), carla.Rotation(pitch=10, yaw=20, roll=30)).get_matrix()
    said = [
        [0.9254165291786194, -0.21461014449596405, -0.31232452392578125],
        [0.33682405948638916, 0.8434932231903076, 0.41841205954551697],
        [0.1736481785774231, -0.49240386486053467, 0.8528684973716736],
    ]
    np.testing.assert_allclose(rotation_of_carla(roll_deg=30, pitch_deg=10, yaw_deg=20), said, atol=1e-6)


def test_beams_of_the_default_sensor_are_those_of_the_shipped_table() -> None:
    from viewshed.sensors import lidar_model

    made = lidar_of_carla(32, 10.0, -30.0, 50.0, 105_600, 10.0)
    shipped = lidar_model("carla")
    assert made.azimuth_columns == shipped.azimuth_columns == 330
    np.testing.assert_allclose(made.elevation, shipped.elevation, atol=np.deg2rad(6e-4))


@pytest.mark.parametrize(
    ("axes", "file_point"),
    [("carla", (5.0, -3.0, 0.5)), ("carla_0.9.9", (-3.0, -5.0, -0.5)), ("sensor", (5.0, 3.0, 0.5))],
)
def test_axes_by_hand(tmp_path: Path, axes: str, file_point: Sequence[float]) -> None:
    # ahead 5, left 3, up 0.5; carla has y right; 0.9.9 has x right, y backward, z down. At x = 10, y = 2 (right), to
    # +y: forward is CARLA's (0, 1), right is (-1, 0), so that the thing is at CARLA's (10 + 3, 2 + 5), our (13, -7).
    pose = (7_000, 10.0, 2.0, 1.0, 0.0, 0.0, 90.0)
    source = open_source(_recording(tmp_path / "r", {"car": {12: ([file_point], pose)}}, axes=axes))
    [(ref, sweep)] = each_sweep(source)
    assert (ref.scene, ref.agent, ref.t_ns, sweep.t_ns, sweep.agent) == ("r", "car", 7_000, 7_000, "car")
    np.testing.assert_allclose(sweep.points, [[5.0, 3.0, 0.5]], atol=1e-6)
    np.testing.assert_allclose(sweep.world_from_sensor @ sweep.points, [[13.0, -7.0, 1.5]], atol=1e-5)


def test_sweeps_come_in_the_order_of_time_and_survive_pickling(tmp_path: Path) -> None:
    still = (0.0,) * 6
    made = {"b": {1: (200, *still), 2: (100, *still)}, "a": {9: (100, *still), 3: None}}
    frames = {agent: {frame: (_points(), pose) for frame, pose in poses.items()} for agent, poses in made.items()}
    folder = _recording(tmp_path, frames)
    source = pickle.loads(pickle.dumps(open_source(folder)))  # noqa: S301
    refs = source.refs(tmp_path.name)
    assert [(ref.t_ns, ref.agent, ref.key) for ref in refs] == [
        (100, "a", "9"), (100, "b", "2"), (200, "b", "1"), (None, "a", "3"),
    ]  # fmt: skip
    assert [ref.index for ref in refs] == [0, 1, 2, 3]
    assert source.read(refs[3]).world_from_sensor is None
    assert any("t_ns does not ascend" in line for line in source.damage())
    assert any("1 of 2 sweeps have no pose, the first is 000003" in line for line in source.damage())


def test_actors_become_boxes_without_the_one_that_carries_the_sensor(tmp_path: Path) -> None:
    folder = _recording(tmp_path / "r", {"car": {5: (_points(), (0, 0, 0, 0, 0, 0, 0))}})
    common = {"z": 0.75, "roll": 0.0, "pitch": 0.0, "extent": [2.0, 1.0, 0.75]}
    actors = [
        {"id": 31, "type": "vehicle.audi.tt", "x": 8.0, "y": 3.0, "yaw": 30.0, **common},
        {"id": 32, "type": "vehicle.own", "x": 0.0, "y": 0.0, "yaw": 0.0, "agent": "car", **common},
    ]
    (folder / "actors.jsonl").write_text(
        json.dumps({"frame": 4, "actors": []}) + "\n" + json.dumps({"frame": 5, "actors": actors}) + "\n"
    )
    source = open_source(folder)
    [ref] = source.refs("r")
    [box] = source.boxes(ref)
    assert (box.category, box.track, box.size_m) == ("vehicle.audi.tt", "31", (4.0, 2.0, 1.5))
    np.testing.assert_allclose(box.center, [8.0, -3.0, 0.75])
    assert box.yaw == pytest.approx(-np.pi / 6)


def test_what_the_recording_says_about_its_sensor_is_used(tmp_path: Path) -> None:
    beams = {"channels": 4, "upper_fov_deg": 10.0, "lower_fov_deg": -20.0, "range_m": 80.0,
             "points_per_second": 16_000, "rotation_hz": 10.0}  # fmt: skip
    pose = (0, 0, 0, 0, 0, 0, 0)
    folder = _recording(
        tmp_path / "r", {"a": {0: (_points(), pose)}, "b": {0: (_points(), pose)}},
        agents={"a": {"sensor_height_m": 2.4, "lidar": beams}, "b": {"lidar": {"channels": 4}}},
    )  # fmt: skip
    source = open_source(folder)
    first, second = (sweep for _, sweep in each_sweep(source))
    assert (first.sensor_height_m, first.model.rings, first.model.azimuth_columns) == (2.4, 4, 400)
    np.testing.assert_allclose(np.rad2deg(first.model.elevation), [-20, -10, 0, 10])
    assert second.model is None
    assert any("describes its sensor wrongly" in line for line in source.damage())


def test_one_line_for_each_damaged_thing_and_the_rest_goes_on(tmp_path: Path) -> None:
    pose = (0, 0, 0, 0, 0, 0, 0)
    folder = _recording(tmp_path / "r", {"a": {frame: (_points(), (frame, *pose[1:])) for frame in range(4)}})
    (folder / "a" / "000002.npy").write_bytes(b"\x93NUMPY")
    (folder / "a" / "last.ply").write_bytes(b"ply\n")
    (folder / "a" / "poses.csv").write_text(
        "\ufeff" + HEADER + "0,0,0,0,0,0,0,0\n1,1,0,0,nan,0,0,0\n2,2,0,0,0,0,0\n3,3,0,0,0,0,0,0\n3,4,0,0,0,0,0,0\n"
    )
    (folder / "actors.jsonl").write_text('{"frame": 0, "actors": [{"id": 1}]}\n{"frame": \n[]\n')
    source, told = open_source(folder), list[str]()
    sweeps = list(each_sweep(source, on_damage=lambda scene, line: told.append(line)))
    assert [ref.key for ref, _ in sweeps] == ["0", "3", "1"]
    assert all("\n" not in line for line in told)
    for words in ("last.ply: a sweep must be named", "line 3: a pose (x, y", "line 4:", "line 6: frame 3",
                  "2 of 4 sweeps have no pose", "000002.npy: is not an NPY", "actors.jsonl: line 2",
                  "actors.jsonl: line 3"):  # fmt: skip
        assert [words in line for line in told].count(True) == 1, words
    with pytest.raises(ValueError, match=r"actors\.jsonl: frame 0 has a damaged actor"):
        source.boxes(sweeps[0][0])


def test_a_scene_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="scene must be one of r, got 'other'"):
        open_source(_recording(tmp_path / "r", {"a": {0: (_points(), (0,) * 7)}})).refs("other")
