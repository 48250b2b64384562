"""``viewshed replay --to`` and ``viewshed record`` as a stranger types them."""

import errno
import json
import os
import re
import shutil
import subprocess
import sys
import time
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cli.commands import run

from viewshed import Sweep, open_recording, read_sweep, write_sweep
from viewshed.cli._options import Reading
from viewshed.cli._outputs import Failures, Named
from viewshed.cli._profile import at_rate
from viewshed.cli._record import Listener, PendingSweep, repeated
from viewshed.cli._stream import placed_sweeps
from viewshed.io.samples import junction_path
from viewshed.pipeline import Answer, ReactionState
from viewshed.recordings.write.bag_writers import Schema, open_bag_writer
from viewshed.recordings.write.ros_topics import CLOUD, RosMessages

pytest.importorskip("rosbags", reason="rosbags is not installed: bags are not written")
pytest.importorskip("mcap", reason="mcap is not installed: bags are not written")
recordings: Any = import_module("recording_files")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three files of thinned sweeps."""
    sweep, folder = read_sweep(junction_path()), tmp_path_factory.mktemp("files")
    places = [folder / f"sweep{k}.ply" for k in range(3)]
    for k, place in enumerate(places):
        write_sweep(sweep.select(np.arange(k, len(sweep), 20)), place)
    return places


_ON_A_FULL_DISK = """
import json, resource, signal, sys
from viewshed.cli import main
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
for most_bytes, words in json.loads(sys.argv[1]):
    resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, resource.RLIM_INFINITY))
    try:
        main(words)
    except SystemExit as end:
        assert end.code == 2
"""
"""A file may become so large and no larger; beyond that writing fails as it does on a full disk."""


@pytest.mark.skipif(sys.platform == "win32", reason="no limit of the size of files can be set")
def test_a_full_disk_is_a_line_that_names_the_bag(files: list[Path], tmp_path: Path) -> None:
    places = {tmp_path / "a.mcap": 60_000, tmp_path / "a.bag": 3_000, tmp_path / "a": 3_000}
    replays = [
        (most_bytes, ["replay", *map(str, files), "--as-fast", "--to", str(place)])
        for place, most_bytes in places.items()
    ]
    code = [sys.executable, "-c", _ON_A_FULL_DISK, json.dumps(replays)]
    done = subprocess.run(code, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for place, line in zip(places, done.stderr.splitlines(), strict=True):
        said = rf"viewshed: {place}: (File too large|.*disk.*); free some space or choose another place"
        assert re.fullmatch(said, line)
    assert not list(tmp_path.iterdir())


def test_a_recording_ends_with_the_first_answer_that_cannot_be_written(
    files: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = 0

    def full(*_: object, **__: object) -> None:
        nonlocal asked
        asked += 1
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("viewshed.recordings.write.bag_writers.McapWriter.write", full)
    code, out, err = run("replay", *files * 10, "--as-fast", "--to", tmp_path / "a.mcap")
    said = "No space left on device; free some space or choose another place"
    assert (code, err) == (2, f"viewshed: {tmp_path / 'a.mcap'}: {said}\n")
    assert asked == 1
    assert int(out.splitlines()[-1].split(" answered")[0]) < 10
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["a.mcap", "a"])
def test_what_a_killed_run_left_goes_with_the_next_one_and_what_another_is_writing_stays(
    name: str, files: list[Path], tmp_path: Path
) -> None:
    killed, other = tmp_path / f".{name}.0123456789ab.part", tmp_path / ".b.0123456789ab.part"
    for folder in (killed, other):
        folder.mkdir()
        (folder / "half").write_bytes(b"half")
    (tmp_path / f".{name}.notes.part").write_text("mine")
    long_ago = time.time() - 60.0
    for folder in (killed, other):
        os.utime(folder, (long_ago, long_ago))
    with open_bag_writer(tmp_path / name):
        [own] = [each for each in tmp_path.glob(f".{name}.*.part") if each != killed and each.is_dir()]
        os.utime(own, (long_ago, long_ago))
        assert run("replay", *files, "--as-fast", "--to", tmp_path / name)[0] == 0
        assert own.exists()
        if not (tmp_path / name).is_file():
            shutil.rmtree(tmp_path / name)
    assert sorted(each.name for each in tmp_path.iterdir()) == sorted([f".{name}.notes.part", other.name, name])


def test_record_writes_what_replay_does(files: list[Path], tmp_path: Path) -> None:
    assert run("replay", *files, "--as-fast", "--to", tmp_path / "a.bag")[0] == 0
    assert run("record", *files, "--to", tmp_path / "b.bag")[0] == 0
    assert (tmp_path / "a.bag").read_bytes() == (tmp_path / "b.bag").read_bytes()


def test_one_topic_of_several_is_taken_with_poses_of_a_file(tmp_path: Path) -> None:
    sweep, ros, source = read_sweep(junction_path()), RosMessages(ros1=False), tmp_path / "two.mcap"
    schema = Schema(CLOUD, "ros2msg", "cdr", ros.definition(CLOUD).encode())
    sizes = {"/front": 1000, "/rear": 1500}
    with open_bag_writer(source) as bag:
        for t_ns in (100_000_000, 200_000_000, 300_000_000):
            for topic, size in sizes.items():
                bag.write(topic, schema, t_ns, ros.encode(ros.cloud(sweep.select(np.arange(size)), t_ns, topic[1:])))
    poses = tmp_path / "poses.txt"
    poses.write_text("".join(f"1 0 0 {x} 0 1 0 2 0 0 1 3\n" for x in range(3)))
    made = tmp_path / "made.mcap"
    assert run("record", source, "--topic", "/rear", "--poses", poses, "--to", made)[0] == 0
    sweeps = list(open_recording(made))
    assert [len(each) for each in sweeps] == [1500] * 3
    assert [each.world_from_sensor and each.world_from_sensor.translation.tolist() for each in sweeps] == [
        [x, 2.0, 3.0] for x in range(3)
    ]


def test_a_damaged_sweep_does_not_shift_poses_by_number(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sweep, ros, source = read_sweep(junction_path()), RosMessages(ros1=False), tmp_path / "one.mcap"
    schema = Schema(CLOUD, "ros2msg", "cdr", ros.definition(CLOUD).encode())
    with open_bag_writer(source) as bag:
        for number in range(3):
            cloud = ros.cloud(sweep.select(np.arange(1000)), (1 + number) * 100_000_000, "lidar")
            if number == 1:
                object.__setattr__(cloud, "width", 2000)  # more than it has
            bag.write("/points", schema, (1 + number) * 100_000_000, ros.encode(cloud))
    poses = tmp_path / "poses.txt"
    poses.write_text("".join(f"1 0 0 {x} 0 1 0 0 0 0 1 0\n" for x in range(3)))
    reading, placed = Reading(poses=poses), list[Sweep]()
    with pytest.raises(ValueError, match="2 sweeps read, 1 problems"):
        placed += (each for _, sweeps in placed_sweeps(reading, [(source, None)]) for _, each in sweeps)
    assert [each.world_from_sensor and each.world_from_sensor.translation[0] for each in placed] == [0.0, 2.0]
    assert "cut off" in capsys.readouterr().err


def test_a_sweep_without_a_pose_costs_one_line_and_not_the_rest(tmp_path: Path) -> None:
    sweep, ros, source = read_sweep(junction_path()), RosMessages(ros1=False), tmp_path / "drive.mcap"
    schema = Schema(CLOUD, "ros2msg", "cdr", ros.definition(CLOUD).encode())
    with open_bag_writer(source) as bag:
        for second in range(1, 5):
            cloud = ros.cloud(sweep.select(np.arange(1000)), second * 10**9, "lidar")
            bag.write("/points", schema, second * 10**9, ros.encode(cloud))
    poses = tmp_path / "late.tum"
    poses.write_text("2 0 0 0 0 0 0 1\n3 1 0 0 0 0 0 1\n")
    for command in (("estimate", "--results", "npz", "--out", tmp_path / "out"), ("monitor", "check")):
        code, out, err = run(*command, source, "--poses", poses)
        assert (code, len(re.findall("^drive.* → |^drive.*: ", out, re.MULTILINE))) == (2, 2)
        assert re.findall(r"the sweep at (\d).000 s has no pose", err) == ["1", "4"]


def test_a_profile_sets_what_no_option_beside_it_does(files: list[Path], tmp_path: Path) -> None:
    same = {
        "a.mcap": ["--profile", "robot"],
        "b.mcap": ["--grid", "indoor", "--monitor"],
        "c.mcap": ["--profile", "robot", "--grid", "road"],
        "d.mcap": ["--monitor"],
    }
    for name, options in same.items():
        code, _, err = run("replay", *files, "--as-fast", *options, "--to", tmp_path / name)
        assert (code, err.count("each is judged alone"), err.count("\n")) == (0, 1, 1)
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    assert (tmp_path / "c.mcap").read_bytes() == (tmp_path / "d.mcap").read_bytes()
    code, _, err = run("record", *files, "--profile", "car", "--to", tmp_path / "e.mcap")
    assert code == 2
    assert "profile must be one of robot, infrastructure, mapping, contested, got 'car'" in err


def test_earlier_sweeps_that_only_a_profile_wishes_for_are_no_demand(tmp_path: Path) -> None:
    """A sweep without a pose is answered by itself; it is refused where --history was given."""
    write_sweep(read_sweep(junction_path()).replace(world_from_sensor=None), tmp_path / "a.npz")
    words = ("record", tmp_path / "a.npz", "--profile", "mapping", "--to", tmp_path / "a.mcap")
    code, out, err = run(*words)
    assert (code, err) == (0, "")
    assert "1 answered" in out
    code, _, err = run(*words, "--history", 5)
    assert code == 2
    assert "--history needs a pose and a time of each sweep" in err


def test_a_profile_leaves_out_sweeps_beyond_its_rate() -> None:
    sweep = read_sweep(junction_path())
    times_ms = [0, 50, 95, 190, 200, 5]  # the last one is of a recording that begins again
    named = [Named(sweep.replace(t_ns=t * 1_000_000), f"{t}", Path(f"{t}")) for t in times_ms]
    kept = at_rate(named, 10.0)
    assert [each.name for each in kept] == ["0", "95", "190", "5"]


def test_a_recording_begins_again_as_long_as_any_sweep_can_be_read() -> None:
    sweep = Named(read_sweep(junction_path()), "a", Path("a.bin"))
    for loop, count in ((True, 3), (False, 2)):
        laps = iter(([sweep] * 2, [sweep], []))
        assert len(list(repeated(partial(next, laps), loop=loop))) == count


def test_a_simulated_drive_is_the_same_each_time(tmp_path: Path) -> None:
    words = ("record", "sim", "--preset", "nuscenes-small", "--agents", 2, "--seconds", 0.2, "--seed", 4, "--to")
    for name in ("a.mcap", "b.mcap"):
        code, out, err = run(*words, tmp_path / name)
        assert (code, err) == (0, "")
        assert [line.split()[0] for line in out.splitlines()[:4]] == ["0.000", "0.000", "0.100", "0.100"]
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    code, out, _ = run("replay", tmp_path / "a.mcap", "--as-fast")
    assert code == 0
    assert out.splitlines()[-1].startswith("4 answered, 0 dropped")


def test_a_bad_file_costs_a_line_and_the_bag_stays(files: list[Path], tmp_path: Path) -> None:
    bad = tmp_path / "bad.bin"
    bad.write_bytes(b"\0" * 17)
    code, _, err = run("record", bad, files[0], "--to", tmp_path / "run.mcap")
    assert code == 2
    assert err.count("\n") == 1
    assert (tmp_path / "run.mcap").stat().st_size > 10_000
    code, _, err = run("record", bad, "--to", tmp_path / "none.mcap")
    assert (code, "no sweep could be read" in err, (tmp_path / "none.mcap").exists()) == (2, True, False)


def test_a_sweep_that_another_agent_overtook_still_has_its_line(capsys: pytest.CaptureFixture[str]) -> None:
    """Of three sweeps a newer one of the first agent takes the place of its older one, before the second agent's."""
    sweep = read_sweep(junction_path()).select(np.arange(10))
    failures = Failures()
    listener = Listener([], failures, is_live=True)
    for number, agent in enumerate("aba"):
        listener.expect(number, PendingSweep(agent, 0.1 * number, sweep, None))
    for number, agent in ((2, "a"), (1, "b")):
        listener(Answer(agent, number, None, None, None, ReactionState(), 0.0, (), "nothing was usable", 0.01))
    assert failures.count == 2
    assert [line.split(":")[1].strip() for line in capsys.readouterr().err.splitlines()] == ["0.200 s", "0.100 s"]


def test_all_commands_say_what_the_monitor_in_the_box_finds_in_the_same_words(tmp_path: Path) -> None:
    """Of two agents by turns: each is judged with its own earlier sweeps."""
    drive = tmp_path / "drive.mcap"
    sim = ("record", "sim", "--preset", "ugv", "--agents", 2, "--seconds", 0.6, "--seed", 4, "--monitor", "--to", drive)
    words = [
        sim,
        ("replay", drive, "--as-fast", "--monitor"),
        ("estimate", drive, "--monitor", "--results", "npz", "--out", tmp_path / "out"),
        ("view", drive, "--html", tmp_path / "run.html", "--monitor"),
        ("monitor", "check", drive),
    ]
    said = []
    for command in words:
        code, out, err = run(*command)
        assert (code, err) == (0, "")
        said.append(re.findall(r"(?:nothing|INCONSISTENT|DEGRADED)\b.*?(?=; \d+\.\d kB$| → |$)", out, re.MULTILINE))
    assert len(said[0]) == 12
    assert [line.count("one sweep alone cannot reveal") for line in said[0]] == [1] * 10 + [0] * 2
    assert all(each == said[0] for each in said[1:])


def test_each_bag_of_a_folder_is_a_stream_of_its_own(tmp_path: Path) -> None:
    sweep, ros, folder = read_sweep(junction_path()), RosMessages(ros1=False), tmp_path / "two"
    schema = Schema(CLOUD, "ros2msg", "cdr", ros.definition(CLOUD).encode())
    folder.mkdir()
    for bag_number in range(2):
        with open_bag_writer(folder / f"{bag_number}.mcap") as bag:
            for number in range(6):
                t_ns = (1 + 6 * bag_number + number) * 100_000_000
                bag.write("/points", schema, t_ns, ros.encode(ros.cloud(sweep.select(np.arange(1000)), t_ns, "lidar")))
    words = [
        ("replay", folder, "--as-fast", "--monitor"),
        ("estimate", folder, "--monitor", "--results", "npz", "--out", tmp_path / "out"),
        ("view", folder, "--html", tmp_path / "run.html", "--monitor"),
        ("monitor", "check", folder),
    ]
    for command in words:
        lines = [line for line in run(*command)[1].splitlines() if re.search(r"nothing found|INCONSISTENT", line)]
        assert [line.count("one sweep alone cannot reveal") for line in lines] == ([1] * 5 + [0]) * 2
