"""Objects, metrics and the center of many agents in bags: topics, colors by explanation, trust over time."""

import json
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.recordings.write.moments import write
from tests.recordings.write.test_recorder import messages_of

from viewshed import load_estimator
from viewshed.agents.legend import LEGEND
from viewshed.cli._options import ObjectOptions
from viewshed.cli._outputs import Failures
from viewshed.cli._record import Listener, PendingSweep, run
from viewshed.objects.explained import Explanation
from viewshed.pipeline import Pipeline
from viewshed.recordings.write.moment import Moment
from viewshed_lab.data.drive import drive_plan, drive_sweeps
from viewshed_lab.data.presets import preset_named

pytest.importorskip("rosbags", reason="rosbags is not installed: bags are not written")
pytest.importorskip("mcap", reason="mcap is not installed: bags are not written")


@pytest.fixture(scope="module")
def drive() -> list[Moment]:
    """Two vehicles and a mast, six times; one vehicle reports objects that are not there from the second on."""
    plan = drive_plan(
        replace(preset_named("nuscenes-small"), roadside=1), seconds=0.6, hz=10.0, agents=2, world="street", seed=3
    )
    moments: list[Moment] = []
    object_options = ObjectOptions(fuse=True, attack="fabricate_static", attacked="vehicle_0", attack_from=0.1)
    adversary = object_options.adversary()
    listener = Listener([moments.append], Failures(), is_live=False, object_options=object_options, adversary=adversary)
    pipeline = Pipeline(
        load_estimator("shadow_map"), listener, objects=object_options.object_stream(adversary), lossless=True
    )
    sweeps = (PendingSweep(sweep.agent, 0.0, sweep, truth) for sweep, truth in drive_sweeps(plan))
    assert run(pipeline, listener, sweeps, adversary) == 18
    return moments


def test_topics_of_objects_and_of_the_center(drive: list[Moment], tmp_path: Path) -> None:
    found = messages_of(write(tmp_path / "run.mcap", drive))
    agents = sorted({moment.agent for moment in drive})
    for agent in agents:
        topics = [f"/{agent}/lidar/{part}" for part in ("detections", "tracks", "explained")]
        assert [len(found[topic]) for topic in (*topics, f"/metrics/{agent}", f"/metrics/{agent}/gospa")] == [6] * 5
        # Trust is known once the first round has ended, with the first report of the second.
        assert len(found[f"/trust/{agent}"]) == 5
    assert len(found["/command_center/picture"]) == 6
    assert [json.loads(message.data) for _, message in found["/attacked_agents"]] == [["vehicle_0"]]
    # Where all are attacked the first message names all.
    moments: list[Moment] = []
    listener = Listener(
        [moments.append], Failures(), is_live=False, adversary=ObjectOptions(attack="far_wall").adversary()
    )
    listener._record(drive[0].answer, PendingSweep(drive[0].agent, 0.0, drive[0].sweep, drive[0].truth), None)
    assert list(moments[0].attacked) == agents
    moment = next(each for each in reversed(drive) if each.round is not None)
    done = moment.round
    picture = json.loads(found["/command_center/picture"][-1][1].data)
    assert picture == json.loads(json.dumps(done.numbers()))
    assert set(picture["agents"]) == set(agents)
    # Cubes: one that deletes those before, then one for each, in the colors of the legend.
    _, markers = found[f"/{moment.agent}/lidar/tracks"][-1]
    tracks = moment.tracks()
    first, *cubes = markers.markers
    assert (first.action, len(cubes), len(cubes) > 2) == (3, len(tracks), True)
    for cube, number, at, box in zip(cubes, tracks.ids, tracks.legend, tracks.boxes, strict=True):
        assert (cube.header.frame_id, cube.ns, cube.id) == ("map", LEGEND[at].word, number)
        assert (cube.color.r, cube.color.g, cube.color.b) == pytest.approx(LEGEND[at].color)
        assert (cube.pose.position.x, cube.scale.x) == pytest.approx((box[0], box[3]))
    _, grid = found["/command_center/visibility"][-1]
    assert grid.info.width == done.joint.grid.cells
    corner = done.joint.world_from_grid.translation[0] + done.joint.grid.origin_m[0]
    assert grid.info.origin.position.x == pytest.approx(corner)


def test_metrics_count_what_was_seen(drive: list[Moment]) -> None:
    last = [moment for moment in drive if moment.agent == "vehicle_1"][-1]
    assert last.metrics["objects"] > 2
    assert 0.0 < last.metrics["gospa_m"] < np.sqrt(8.0 * (last.metrics["objects"] + last.metrics["tracks"]))
    parts = last.metrics["localization_m2"] + last.metrics["missed_m2"] + last.metrics["false_m2"]
    assert last.metrics["gospa_m"] == pytest.approx(np.sqrt(parts))


def test_the_legend_has_a_word_for_every_explanation() -> None:
    assert len(LEGEND) == len(Explanation) + 2
    colors = np.array([item.color for item in LEGEND[: len(Explanation)]])
    apart = np.linalg.norm(colors[:, None] - colors[None], axis=2) + np.eye(len(colors))
    assert apart.min() > 0.2


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_scenes_of_foxglove_are_colored_by_explanation(drive: list[Moment], tmp_path: Path) -> None:
    pytest.importorskip("foxglove", reason="foxglove-sdk is not installed: its schemas are not written")
    from mcap.reader import make_reader

    found: dict[str, list[Any]] = {}
    scene: Any = import_module("foxglove").messages.SceneUpdate
    with write(tmp_path / "run.mcap", drive, "foxglove").open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            found.setdefault(channel.topic, []).append((schema.name, channel.message_encoding, message.data))
    moment = drive[-1]
    objects = found[f"/{moment.agent}/lidar/objects"]
    assert [len(objects), objects[-1][0]] == [6, scene.get_schema().name]
    explained = json.loads(found[f"/{moment.agent}/lidar/explained"][-1][2])
    tracks = moment.tracks()
    assert [each["explanation"] for each in explained["tracks"]] == [LEGEND[at].word for at in tracks.legend]
    for each in explained["tracks"]:
        assert f"{each['id']} {each['explanation']}".encode() in objects[-1][2]
    assert json.loads(found["/trust/vehicle_0"][-1][2])["trust"] <= 1.0
    assert len(found["/command_center/objects"]) == len(found["/command_center/fov"]) == 6
