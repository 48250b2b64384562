"""Links and damage in recordings of every layout: no file outside is read, and nothing stops the rest."""

from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from viewshed.io import read_index
from viewshed.recordings.read import open_source
from viewshed.recordings.read.source import each_sweep

pytest.importorskip("rosbags", reason="rosbags is not installed: recordings of ROS are not made")
pytest.importorskip("mcap", reason="mcap is not installed: recordings of ROS are not made")
made: Any = import_module("recording_files")
RECORDINGS = made.recordings()
FILES = [(kind, name) for kind, files in RECORDINGS.items() for name in files if name != "a/metadata.yaml"]


def read_all(place: Path) -> tuple[int, int, list[str]]:
    """How many sweeps and boxes come out of a recording, and what is said about the rest."""
    lines: list[str] = []
    sweeps = boxes = 0
    try:
        source = open_source(place)
        for ref, _ in each_sweep(source, on_damage=lambda _, line: lines.append(line)):
            sweeps += 1
            boxes += len(source.boxes(ref) or ())
    except (ValueError, OSError) as error:
        lines.append(str(error))
    return sweeps, boxes, [line for line in lines if "clouds have no pose: frame" not in line]


@pytest.mark.parametrize("kind", sorted(RECORDINGS))
def test_the_recordings_are_whole(kind: str, tmp_path: Path) -> None:
    sweeps, boxes, lines = read_all(made.write(tmp_path, RECORDINGS[kind]))
    assert lines == []
    assert (
        sweeps == sum(name.endswith((".bin", ".pcd", ".npy", "000.feather")) for name in RECORDINGS[kind])
        or sweeps == 2
    )
    assert (boxes > 0) == (kind in {"nuscenes", "kitti_raw", "kitti_object", "opv2v", "carla", "argoverse2"})


@pytest.mark.parametrize(("kind", "name"), FILES, ids=lambda value: str(value).replace("/", "_"))
def test_a_link_out_of_a_recording_is_refused_whichever_file_it_is(kind: str, name: str, tmp_path: Path) -> None:
    place = made.write(tmp_path / "recording", RECORDINGS[kind])
    outside = tmp_path / "outside"
    (place / name).rename(outside)
    (place / name).symlink_to(outside)
    _, _, lines = read_all(place)
    assert any("leads out of" in line for line in lines), lines
    assert all("\n" not in line for line in lines)


@pytest.mark.parametrize(("kind", "name"), FILES, ids=lambda value: str(value).replace("/", "_"))
def test_a_link_within_a_recording_is_followed(kind: str, name: str, tmp_path: Path) -> None:
    place = made.write(tmp_path, RECORDINGS[kind])
    (place / name).rename(place / "elsewhere")
    (place / name).symlink_to(place / "elsewhere")
    assert read_all(place)[2] == []


@pytest.mark.parametrize("kind", sorted(RECORDINGS))
def test_folders_that_lead_out_are_refused(kind: str, tmp_path: Path) -> None:
    place = made.write(tmp_path / "recording", RECORDINGS[kind])
    top = sorted({name.split("/")[0] for name in RECORDINGS[kind]})[-1]
    (place / top).rename(tmp_path / "outside")
    (place / top).symlink_to(tmp_path / "outside")
    _, _, lines = read_all(place)
    assert any("leads out of" in line for line in lines), lines


def test_links_in_a_circle_are_one_line(tmp_path: Path) -> None:
    loop = tmp_path / "loop.bin"
    loop.symlink_to(loop)
    with pytest.raises(OSError, match=r"loop\.bin: its links lead in a circle"):
        open_source(loop)
    (tmp_path / "index.json").write_text('[{"file": "loop.bin", "sensor": "x"}]')
    with pytest.raises(ValueError, match=r"index\.json: entry 0: .*loop\.bin: its links lead in a circle; refused"):
        read_index(tmp_path / "index.json")


def test_a_recording_may_be_named_by_a_link(tmp_path: Path) -> None:
    made.write(tmp_path / "real", RECORDINGS["opv2v"])
    (tmp_path / "link").symlink_to(tmp_path / "real")
    assert read_all(tmp_path / "link") == (1, 1, [])


def test_whatever_a_reader_raises_is_a_line_and_the_rest_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from viewshed.recordings.read import kitti

    def faulty(*_: object, **settings: object) -> None:
        raise RuntimeError("two\nlines")

    place = made.write(tmp_path, RECORDINGS["kitti_odometry"])
    monkeypatch.setattr(kitti, "read_sweep", faulty)
    sweeps, _, lines = read_all(place)
    assert sweeps == 0
    [line] = lines
    assert line.startswith(f"{place}/sequences/00/velodyne/000000.bin: is damaged")
    assert line.endswith("RuntimeError: two lines")
