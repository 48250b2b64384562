"""The OPV2V layout: frames by hand, two real cars in it, boxes, and files that are missing or damaged."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from viewshed.recordings.read import open_source
from viewshed.recordings.read.source import each_sweep

POSE = [10.0, 2.0, 1.9, 0.0, 90.0, 0.0]  # x, y, z, roll, yaw, pitch: yaw is the fifth


def _frame(agent: Path, frame: int, points: Any, **about: Any) -> None:
    """Points as OpenCDA writes them: ASCII, with the intensity hidden in a color."""
    agent.mkdir(parents=True, exist_ok=True)
    rows = "\n".join(f"{x} {y} {z} 4.2108e+06" for x, y, z in np.asarray(points, np.float64).tolist())
    header = "VERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1"
    count = len(points)
    sizes = f"WIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA ascii"
    (agent / f"{frame:06d}.pcd").write_text(f"# .PCD v0.7 - Point Cloud Data file format\n{header}\n{sizes}\n{rows}\n")
    if about:
        (agent / f"{frame:06d}.yaml").write_text(yaml.dump(about))


def test_vehicles_become_boxes(tmp_path: Path) -> None:
    # A car at x = 8, y = 3 that faces CARLA's +y; its box's center is 0.5 m ahead of its origin and 0.7 m above it.
    car = {"location": [8.0, 3.0, 0.1], "center": [0.5, 0, 0.7], "angle": [0, 90.0, 0], "extent": [2.0, 1.0, 0.75],
           "speed": 3.0}  # fmt: skip
    _frame(tmp_path / "s" / "641", 68, [[5, 3, 1]], lidar_pose=POSE, vehicles={304: car})
    source = open_source(tmp_path)
    [box] = source.boxes(source.refs("s")[0])
    np.testing.assert_allclose(box.center, [8.0, -3.5, 0.8], atol=1e-12)
    assert (box.size_m, box.track, box.category) == ((4.0, 2.0, 1.5), "304", "vehicle")
    assert box.yaw == pytest.approx(-np.pi / 2)


def test_the_published_example_is_read_as_its_page_explains_it(tmp_path: Path) -> None:
    """The numbers of OpenCOOD's page about OPV2V's annotations; a color of Open3D is a float hardly above 0."""
    about: dict[str, Any] = {
        "lidar_pose": [144.33, -388.94, 1.93, 0.078, 174.18, 0.21],
        "true_ego_pos": [143.83, -388.89, 0.032, 0.075, 174.18, 0.21],
        "vehicles": {4796: {"angle": [0.096, -177.86, 0.197], "center": [0.0004, 0.0005, 0.71],
                            "extent": [2.45, 1.06, 0.75], "location": [158.55, -385.75, 0.032], "speed": 19.47}},
    }  # fmt: skip
    agent = tmp_path / "train" / "2021_08_24_21_29_28" / "4805"
    _frame(agent, 69, [[5.0, -3.0, 0.5]], **about)
    content = (agent / "000069.pcd").read_text()
    (agent / "000069.pcd").write_text(content.replace("4.2108e+06", "1.174561e-38"))
    (agent / "000069_camera0.png").write_bytes(b"")
    (agent / "000069_additional.yaml").write_text("x: 1\n")
    source = open_source(tmp_path)
    [(ref, sweep)] = each_sweep(source)
    assert (ref.scene, ref.agent, source.damage()) == ("train/2021_08_24_21_29_28", "4805", ())
    assert (ref.t_ns, sweep.t_ns) == (3_450_000_000, 3_450_000_000)
    np.testing.assert_allclose(sweep.points, [[5.0, 3.0, 0.5]])
    assert sweep.sensor_height_m == pytest.approx(1.898)
    [box] = source.boxes(ref) or ()
    seen = sweep.world_from_sensor.inverse() @ box.center
    # By hand in the map, y to the south: (14.22, 3.19) m away, the car faces 174.18 degrees: behind it, to its left.
    np.testing.assert_allclose(seen, [-13.82, 4.61, -1.14], atol=0.02)
    assert box.size_m == pytest.approx((4.9, 2.12, 1.5))


def test_the_protocol_tells_the_beams_and_the_step(tmp_path: Path) -> None:
    lidar = {"channels": 64, "range": 120, "points_per_second": 1_300_000, "rotation_frequency": 20, "upper_fov": 2,
             "lower_fov": -25}  # fmt: skip
    protocol = {"world": {"fixed_delta_seconds": 0.1}, "vehicle_base": {"sensing": {"perception": {"lidar": lidar}}}}
    for agent in ("641", "-1"):
        _frame(tmp_path / "s" / agent, 2, [[5, 3, 1]], lidar_pose=POSE)
    (tmp_path / "s" / "data_protocol.yaml").write_text(yaml.dump(protocol))
    source = pickle.loads(pickle.dumps(open_source(tmp_path / "s")))  # noqa: S301
    (roadside, at_roadside), (car, on_car) = each_sweep(source)
    assert (roadside.agent, car.agent, car.t_ns) == ("-1", "641", 200_000_000)
    assert at_roadside.model is None
    assert (on_car.model.rings, on_car.model.max_range_m) == (64, 120.0)


def test_agents_of_one_moment_follow_each_other_by_number(tmp_path: Path) -> None:
    for agent, frames in (("1732", (70, 68)), ("641", (68,))):
        for frame in frames:
            _frame(tmp_path / "s" / agent, frame, [[5, 3, 1]], lidar_pose=POSE)
    refs = open_source(tmp_path).refs("s")
    assert [(ref.agent, ref.index) for ref in refs] == [("641", 0), ("1732", 1), ("1732", 2)]


def test_one_line_for_each_damaged_thing_and_the_rest_goes_on(tmp_path: Path) -> None:
    car = tmp_path / "s" / "641"
    for frame in range(1, 7):
        _frame(car, frame, [[5, 3, 1]], lidar_pose=POSE)
    (car / "000001.yaml").unlink()
    (car / "000002.yaml").write_text("lidar_pose: [1, 2, 3]\n")
    (car / "000003.yaml").write_text("lidar_pose: [1,\n")
    (car / "000004.pcd").write_text("# .PCD\n")
    (car / "000005.pcd").unlink()
    source, told = open_source(tmp_path), list[str]()
    sweeps = [(ref.t_ns, sweep.world_from_sensor is None) for ref, sweep in each_sweep(
        source, on_damage=lambda scene, line: told.append(line))]  # fmt: skip
    assert sweeps == [(50_000_000, True), (300_000_000, False)]
    assert all("\n" not in line for line in told)
    for words in ("1 frame(s) without YAML", "the first is 000005",
                  "000002.yaml: lidar_pose (x, y, z, roll, yaw, pitch) must be 6 finite numbers",
                  "000003.yaml: is not YAML", "000004.pcd: "):  # fmt: skip
        assert [words in line for line in told].count(True) == 1, words


def test_objects_of_python_in_the_yaml_are_skipped_and_not_run(tmp_path: Path) -> None:
    _frame(tmp_path / "s" / "641", 68, [[5, 3, 1]], lidar_pose=POSE)
    path = tmp_path / "s" / "641" / "000068.yaml"
    trap = tmp_path / "run"
    path.write_text(path.read_text() + f"ego_speed: !!python/object/apply:pathlib.Path.touch [{trap}]\n")
    [(_, sweep)] = each_sweep(open_source(tmp_path))
    assert sweep.world_from_sensor is not None
    assert not trap.exists()


def test_damaged_vehicles_are_named(tmp_path: Path) -> None:
    _frame(tmp_path / "s" / "641", 68, [[5, 3, 1]], lidar_pose=POSE, vehicles={7: {"location": [1, 2]}})
    source = open_source(tmp_path)
    with pytest.raises(ValueError, match=r"000068\.yaml: a vehicle is damaged"):
        source.boxes(source.refs("s")[0])
