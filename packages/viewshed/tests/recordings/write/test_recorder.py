"""Bags that are written are read back by our own reader, and by those of rosbags and mcap."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.io.messages.test_laserscan import Scan
from tests.recordings.write.moments import doubted, drive_moments, moments_of, write

from viewshed import read_sweep
from viewshed.geometry import Rigid
from viewshed.io.export.ros import visibility_layer
from viewshed.io.messages.laserscan import sweep_of_scan
from viewshed.io.samples import junction_path
from viewshed.recordings.read import open_source
from viewshed.recordings.read.source import each_sweep
from viewshed.recordings.write.moment import MAP, Moment, RisingTimes, Transform
from viewshed.recordings.write.recorder import open_recorder
from viewshed.recordings.write.ros_topics import TOPICS

pytest.importorskip("rosbags", reason="rosbags is not installed: bags are not written")
pytest.importorskip("mcap", reason="mcap is not installed: bags are not written")
BAGS = ["run.mcap", "run.bag", "run"]


@pytest.fixture(scope="module")
def drive() -> list[Moment]:
    return drive_moments()


@pytest.fixture(scope="module")
def junction() -> list[Moment]:
    """A sweep of a file: no time, no pose."""
    sweep = read_sweep(junction_path())
    return moments_of([(sweep, None), (sweep.replace(t_ns=None), None)])


@pytest.mark.parametrize("name", BAGS)
def test_clouds_poses_and_heights_of_a_drive_come_back(name: str, drive: list[Moment], tmp_path: Path) -> None:
    damage: list[str] = []
    place = write(tmp_path / name, drive)
    read = [sweep for _, sweep in each_sweep(open_source(place), on_damage=lambda _, line: damage.append(line))]
    assert damage == []
    assert len(read) == len(drive) == 12
    back = {(sweep.agent.partition("/")[0], sweep.t_ns): sweep for sweep in read}
    for moment in drive:
        wrote, got = moment.sweep, back[moment.agent, moment.t_ns]
        assert got.points.tobytes() == wrote.points.tobytes()
        assert got.intensity.tobytes() == wrote.intensity.tobytes()
        np.testing.assert_array_equal(got.ring, wrote.ring)
        np.testing.assert_allclose(got.time_s, wrote.time_s - wrote.time_s.min(), atol=1e-6)
        np.testing.assert_allclose(
            got.world_from_sensor.as_matrix(), wrote.world_from_sensor.as_matrix(), rtol=0, atol=1e-9
        )
        assert got.sensor_height_m == pytest.approx(wrote.sensor_height_m, abs=1e-9)


def test_frames_stand_where_leveling_and_drive_put_them(drive: list[Moment]) -> None:
    """From the level frame through sensor and carrier to the map: the pose of the estimate."""
    for moment in drive:
        edges = {each.child: each for each in (*moment.static_transforms(), *moment.transforms())}

        def in_map(frame: str, edges: dict[str, Transform] = edges) -> Rigid:
            return Rigid.identity() if frame == MAP else in_map(edges[frame].parent) @ edges[frame].parent_from_child

        pose, height_m = moment.answer.estimate.world_from_level, moment.sweep.sensor_height_m
        np.testing.assert_allclose(in_map(moment.level_frame).as_matrix(), pose.as_matrix(), atol=1e-9)
        footprint = in_map(f"{moment.agent}/base_footprint").translation
        above = moment.sweep.world_from_sensor.translation - footprint
        np.testing.assert_allclose(above, [0.0, 0.0, height_m], atol=1e-6)


@pytest.mark.parametrize("name", BAGS)
def test_equal_runs_give_equal_bytes(name: str, drive: list[Moment], tmp_path: Path) -> None:
    contents = []
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        place = write(tmp_path / folder / name, drive)
        files = [place] if place.is_file() else sorted(place.iterdir())
        contents.append({file.name: file.read_bytes() for file in files})
    assert contents[0] == contents[1]


def messages_of(place: Path) -> dict[str, list[tuple[int, Any]]]:
    """Topic → (time, message), decoded by the readers of other makers."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    found: dict[str, list[tuple[int, Any]]] = {}
    if place.suffix == ".mcap":
        from mcap.reader import make_reader

        store = get_typestore(Stores.EMPTY)
        with place.open("rb") as file:
            for schema, channel, message in make_reader(file).iter_messages():
                if schema.name not in store.types:  # by the definitions in the file alone
                    store.register(get_types_from_msg(schema.data.decode(), schema.name))
                decoded = store.deserialize_cdr(message.data, schema.name)
                found.setdefault(channel.topic, []).append((message.log_time, decoded))
        return found
    from rosbags.highlevel import AnyReader

    with AnyReader([place], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        for connection, t_ns, raw in reader.messages():
            found.setdefault(connection.topic, []).append((t_ns, reader.deserialize(raw, connection.msgtype)))
    return found


def test_topics_of_a_drive(drive: list[Moment], tmp_path: Path) -> None:
    found = messages_of(write(tmp_path / "run.mcap", drive))
    agents = sorted({moment.agent for moment in drive})
    assert len(agents) == 3
    counts = {topic: len(messages) for topic, messages in found.items()}
    once = {"/object_truth": 4, **dict.fromkeys(("/agent_names", "/attacked_agents", "/tf_static"), 1)}
    once |= {"/tf": 12, "/diagnostics": 12}
    of_agent = ("state", *(f"lidar/{part}" for part in ("data", "object_truth", "fov", "visibility", "state", "doubt")))
    assert counts == once | {f"/{agent}/{topic}": 4 for agent in agents for topic in of_agent}
    assert sorted(json.loads(found["/agent_names"][0][1].data)) == agents
    assert json.loads(found["/attacked_agents"][0][1].data) == []
    # Vehicles carry their sensor, the mast does not: two mounts.
    mounted = [each.child_frame_id for each in found["/tf_static"][0][1].transforms]
    assert len(mounted) == 2


def test_bags_have_the_published_topics() -> None:
    """All but those of its trust: ours has one number an agent."""
    of_lidar = ("data", "detections", "fov", "tracks", "object_truth")
    published = {"/object_truth", "/agent_names", "/attacked_agents", "/{agent}/state", "/tf", "/tf_static"}
    published |= {"/command_center/tracks"} | {f"/{{agent}}/lidar/{part}" for part in of_lidar}
    assert published <= {topic.name for topic in TOPICS}


def test_grids_and_polygon_are_those_of_the_estimate(drive: list[Moment], tmp_path: Path) -> None:
    found = messages_of(write(tmp_path / "run.mcap", drive))
    moment = drive[0]
    estimate = moment.answer.estimate
    for layer in ("visibility", "state", "doubt"):
        t_ns, grid = found[f"/{moment.agent}/lidar/{layer}"][0]
        assert (t_ns, grid.header.frame_id) == (moment.t_ns, f"{moment.agent}/level")
        stamp = grid.header.stamp
        assert stamp.sec * 1_000_000_000 + stamp.nanosec == moment.t_ns
        assert (grid.info.origin.position.x, grid.info.resolution) == (-64.0, 0.5)
        values = np.asarray(grid.data, np.int8).reshape(estimate.grid.shape).T
        np.testing.assert_array_equal(values, visibility_layer(estimate, layer))
    corners = found[f"/{moment.agent}/lidar/fov"][0][1].polygon.points
    inside = estimate.at(np.array([[point.x, point.y] for point in corners]) * 0.999)
    assert len(corners) > 100
    assert (inside >= estimate.threshold).mean() > 0.95


def test_a_sweep_without_time_and_pose(junction: list[Moment], tmp_path: Path) -> None:
    found = messages_of(write(tmp_path / "run.mcap", junction))
    assert sorted(found) == [
        "/diagnostics", "/ego/lidar/data", "/ego/lidar/doubt", "/ego/lidar/fov", "/ego/lidar/state",
        "/ego/lidar/visibility", "/tf",
    ]  # fmt: skip
    times = [t_ns for t_ns, _ in found["/ego/lidar/data"]]
    assert times[1] - times[0] == 100_000_000
    [status] = found["/diagnostics"][0][1].status
    assert status.message.startswith("visible ")
    values = {each.key: each.value for each in status.values}
    assert values["method"] == "shadow_map"
    assert "latency_ms" not in values


def test_a_refused_sweep_is_an_error_in_the_diagnostics(junction: list[Moment], tmp_path: Path) -> None:
    refused = replace(junction[0].answer, estimate=None, leveled=None, refused="no return was usable")
    found = messages_of(write(tmp_path / "run.mcap", [replace(junction[0], answer=refused)]))
    [status] = found["/diagnostics"][0][1].status
    assert (status.level, status.message) == (2, "no return was usable")
    assert "/ego/lidar/visibility" not in found
    assert len(found["/ego/lidar/data"]) == 1


def test_an_alarm_is_told_with_its_reasons_and_numbers(junction: list[Moment], tmp_path: Path) -> None:
    found = messages_of(write(tmp_path / "run", [doubted(junction[0]), junction[1]]))
    [(_, alarms)] = found["/ego/lidar/alarms"]
    sentences = ["a wall hangs in the air", "and moves"]
    assert [status.message for status in alarms.status] == sentences
    assert {status.level for status in alarms.status} == {2}
    values = {each.key: each.value for each in alarms.status[0].values}
    assert (values["score"], values["threshold"], values["p_value"]) == ("2.0000", "1.0000", "0.0100")
    assert values["suspect_from_deg"] == "20 25"
    alone = doubted(junction[0])
    assert alone.answer.report is not None
    report = replace(alone.answer.report, now=replace(alone.answer.report.now, p_value=np.nan))
    assert "p_value" not in replace(alone, answer=replace(alone.answer, report=report)).numbers()
    levels = [message.status[0].level for _, message in found["/diagnostics"]]
    assert levels == [2, 0]


@pytest.mark.parametrize(
    ("name", "schemas", "message"),
    [
        ("run.db3", "ros", r"a bag must be NAME.mcap, NAME.bag \(ROS 1\) or a folder NAME \(ROS 2\), got .*run.db3"),
        ("there", "ros", "a bag must not replace a folder, got .*there, which exists; choose another name"),
        ("run.mcap", "protobuf", "schemas must be one of ros, foxglove, got 'protobuf'"),
        ("run.bag", "foxglove", "Foxglove's schemas go into NAME.mcap, got .*run.bag"),
    ],
)
def test_what_cannot_be_written(name: str, schemas: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    with pytest.raises(ValueError, match=message), open_recorder(tmp_path / name, schemas):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["there"]


@pytest.mark.parametrize("name", BAGS)
@pytest.mark.parametrize(("error", "is_kept"), [(KeyboardInterrupt, True), (OSError, False)])
def test_a_bag_is_whole_or_not_there(
    name: str, error: type[BaseException], is_kept: bool, junction: list[Moment], tmp_path: Path
) -> None:
    def interrupted() -> None:
        with open_recorder(tmp_path / name) as record:
            record(junction[0])
            raise error

    with pytest.raises(error):
        interrupted()
    assert [path.name for path in tmp_path.iterdir()] == ([name] if is_kept else [])
    if is_kept:
        assert len([*each_sweep(open_source(tmp_path / name), on_damage=lambda *_: None)]) == 1


@given(st.lists(st.tuples(st.sampled_from("ab"), st.none() | st.integers(-(10**12), 10**12)), max_size=20))
def test_times_of_a_recording_rise(stream: list[tuple[str, int | None]]) -> None:
    times, last = RisingTimes(), dict[str, int]()
    for agent, t_ns in stream:
        now_ns = times.of(agent, t_ns)
        assert now_ns > last.get(agent, -1)
        last[agent] = now_ns


@pytest.mark.parametrize("name", BAGS)
def test_a_laser_scan_comes_back_as_one(name: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    angle = np.linspace(-2.0, 2.0, 721)
    ranges = np.where(rng.random(721) < 0.2, np.inf, rng.uniform(1.0, 20.0, 721)).astype(np.float32)
    ranges[rng.random(721) < 0.1] = np.nan
    scan = Scan(ranges, -2.0, 2.0, 4.0 / 720, 0.0, 0.1, 25.0, np.arange(721, dtype=np.float32))
    sweep = sweep_of_scan(scan).replace(t_ns=5)
    place = write(tmp_path / name, moments_of([(sweep, None)]))
    [(_, back)] = each_sweep(open_source(place), on_damage=lambda *_: None)
    assert back.planar.max_range_m == sweep.planar.max_range_m
    np.testing.assert_allclose(back.points, sweep.points, atol=2e-5)
    np.testing.assert_array_equal(back.intensity, sweep.intensity)
    np.testing.assert_allclose(back.azimuth, sweep.azimuth, atol=1e-6)
    np.testing.assert_allclose(back.planar.open_azimuth, sweep.planar.open_azimuth, atol=1e-6)
    assert angle.size > len(back) + len(back.planar.open_azimuth)


def test_what_follows_a_step_back_keeps_its_gaps() -> None:
    times, second = RisingTimes(), 1_000_000_000
    made = [times.of("ego", t_ns) for t_ns in (0, second, 0, second, 3 * second)]
    assert made == [0, second, second + 100_000_000, 2 * second + 100_000_000, 4 * second + 100_000_000]
