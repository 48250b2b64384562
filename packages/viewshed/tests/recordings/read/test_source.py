"""The role of a recording: walking through one, boxes, and knowing which one a folder is."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from viewshed.geometry import Rigid
from viewshed.recordings.read import SOURCES, open_source
from viewshed.recordings.read.source import ObjectBox, SweepRef, each_sweep
from viewshed.recordings.recording import is_data_set
from viewshed.sweep import Sweep


@dataclass(frozen=True)
class Half:
    """A recording whose second sweep and second scene are damaged."""

    def scenes(self) -> tuple[str, ...]:
        return "a", "b", "c"

    def refs(self, scene: str) -> Sequence[SweepRef]:
        if scene == "b":
            raise OSError("b/index.txt: No such file")
        return [SweepRef(scene, index, f"{scene}/{index}.bin") for index in range(3)]

    def read(self, ref: SweepRef) -> Sweep:
        if ref.index == 1:
            raise ValueError(f"{ref.file}: is cut off")
        return Sweep(np.array([[1.0, 2.0, float(ref.index)]]))

    def boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        return None

    def damage(self) -> tuple[str, ...]:
        return ("list.txt: row 3 is no name",)

    def notes(self) -> tuple[str, ...]:
        return ()


def test_walking_goes_on_after_damage_and_tells_each_once() -> None:
    told: list[tuple[str, str]] = []
    found = [(ref.file, sweep.points[0, 2]) for ref, sweep in each_sweep(Half(), None, lambda *line: told.append(line))]
    assert found == [("a/0.bin", 0.0), ("a/2.bin", 2.0), ("c/0.bin", 0.0), ("c/2.bin", 2.0)]
    assert told == [
        ("", "list.txt: row 3 is no name"),
        ("a", "a/1.bin: is cut off"),
        ("b", "b/index.txt: No such file"),
        ("c", "c/1.bin: is cut off"),
    ]


def test_walking_raises_where_nobody_is_told() -> None:
    walk = each_sweep(Half(), ["c"])
    assert next(walk)[0].file == "c/0.bin"
    with pytest.raises(ValueError, match=r"^c/1\.bin: is cut off$"):
        next(walk)


@pytest.mark.parametrize(
    "size", [(4.0, 0.0, 1.5), (4.0, -1.0, 1.5), (np.nan, 1.0, 1.0), (np.inf, 1.0, 1.0), (4.0, 1.0)]
)
def test_a_box_without_three_positive_sizes_is_refused(size: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match=r"size_m must be three positive numbers, got \("):
        ObjectBox(Rigid.identity(), size, "car")


def test_an_empty_folder_is_told_with_every_layout_that_was_looked_for(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"no recording found here; looked for ") as told:
        open_source(tmp_path)
    assert "\n" not in str(told.value)
    for name, kind in SOURCES.items():
        assert f"{kind.layout} ({name})" in str(told.value)


def test_a_manifest_of_another_program_makes_no_data_set(tmp_path: Path) -> None:
    for manifest, ours in (('{"name": "my app"}', False), ('{"kind": "viewshed archive"}', True), ("", True)):
        (tmp_path / "manifest.json").write_text(manifest)
        assert is_data_set(tmp_path) == ours


def test_a_place_that_is_not_there_and_a_kind_that_is_not_known_are_told(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"nowhere: no such file or folder"):
        open_source(tmp_path / "nowhere")
    with pytest.raises(ValueError, match=r"kind must be auto or one of nuscenes, .*, got 'waymo'"):
        open_source(tmp_path, "waymo")


NOTHING = {
    "nuscenes": "must hold one version of nuScenes", "carla": "must hold folders AGENT/000123",
    "opv2v": "must hold folders SCENARIO/AGENT/", "argoverse2": "must hold Argoverse 2's LOG/sensors/lidar/",
    **dict.fromkeys(("kitti_raw", "kitti_odometry", "kitti_object"), "must hold KITTI's "),
}  # fmt: skip


@pytest.mark.parametrize("kind", SOURCES)
def test_every_kind_refuses_an_empty_folder_in_one_line(kind: str, tmp_path: Path) -> None:
    with pytest.raises((ValueError, OSError), match=NOTHING.get(kind)) as told:
        open_source(tmp_path, kind)
    assert str(tmp_path) in str(told.value)
    assert "\n" not in str(told.value)
    assert not SOURCES[kind].fits(tmp_path)


def test_the_folder_one_stands_in_is_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    part = tmp_path / "training" / "velodyne"
    part.mkdir(parents=True)
    (part / "000004.bin").write_bytes(np.ones((3, 4), "<f4").tobytes())
    monkeypatch.chdir(tmp_path)
    [(ref, sweep)] = each_sweep(open_source("."))
    assert (ref.scene, ref.key, len(sweep)) == ("training", "000004", 3)
