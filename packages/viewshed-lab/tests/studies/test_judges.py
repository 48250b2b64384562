"""A log made by hand: flat ground, half of which the survey has a meter lower; cars in sight and behind a wall."""

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.recordings.read import test_kitti as kitti
from tests.recordings.read import test_nuscenes as nuscenes

from viewshed.cli import main
from viewshed.geometry import Rigid
from viewshed.recordings.read.source import ObjectBox
from viewshed.sensors import lidar_model
from viewshed.sweep import Sweep
from viewshed_lab.sim.assets.shapes import Box
from viewshed_lab.sim.raycast.caster import cast_world
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import Thing, World
from viewshed_lab.studies.judges import BANDS_M, SurveyedGround, judged_returns, near_point, returns_in

made: Any = import_module("recording_files")
TIME_NS = 315966265259836000
CITY_M = np.array([5224.0, 2384.0, 69.0])  # of the car, whose axes are those of the city
SENSOR_M = np.array([1.35018, 0.0, 1.64042])  # of the sensor on the car
SEEN, HIDDEN = (10.0, -6.0), (-16.0, 9.0)  # of two cars, from the sensor


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a log: the sensor, 1.64 m above flat ground, sees one car; another stands behind a wall."""
    car = Box(0.0, 0.0, 4.2, 1.8, 1.5)
    things = (Thing("seen", (car,), *SEEN), Thing("hidden", (car,), *HIDDEN),
              Thing("wall", (Box(0.0, 0.0, 0.4, 14.0, 4.0),), -11.0, 7.0))  # fmt: skip
    world = World("flat", Terrain.plane(90.0), things)
    model = lidar_model("hdl32e")
    scan = cast_world(world.snapshot(0.0), model, Rigid(np.eye(3), np.array([0.0, 0.0, SENSOR_M[2]])))
    column, ring = np.nonzero(np.isfinite(scan.depth_m))
    points = scan.direction[column, ring] * scan.depth_m[column, ring, None] + SENSOR_M
    sweep = dict(zip("xyz", points.astype(np.float32).T, strict=True)) | {
        "intensity": np.zeros(len(points), np.uint8), "laser_number": ring.astype(np.uint8),
        "offset_ns": np.zeros(len(points), np.int32),
    }  # fmt: skip
    still = {"qw": [1.0], "qx": [0.0], "qy": [0.0], "qz": [0.0]}
    centers = [(x + SENSOR_M[0], y, 0.75) for x, y in (SEEN, HIDDEN)]
    boxes = {name: [row[k] for row in centers] for k, name in enumerate(("tx_m", "ty_m", "tz_m"))}
    boxes |= {
        name: [value] * 2 for name, value in zip(("length_m", "width_m", "height_m"), (4.2, 1.8, 1.5), strict=True)
    }
    boxes |= {name: value * 2 for name, value in still.items()}
    place = dict(zip(("tx_m", "ty_m", "tz_m"), ([value] for value in CITY_M), strict=True))
    # Two nodes a meter; the ground of the city is at 69 m, west of the sensor it is surveyed a meter lower.
    survey = np.full((400, 400), 69.0, np.float16)
    survey[:, :200] = 68.0
    survey[:40] = np.nan  # nobody surveyed the south
    x, y = CITY_M[:2] + SENSOR_M[:2]
    numpy = import_module("sweep_files").npy(survey)
    return Path(made.write(tmp_path_factory.mktemp("log"), {
        f"sensors/lidar/{TIME_NS}.feather": made.feather(**sweep),
        "city_SE3_egovehicle.feather": made.feather(timestamp_ns=[TIME_NS], **still, **place),
        "annotations.feather": made.feather(
            timestamp_ns=[TIME_NS] * 2, category=["CAR"] * 2, track_uuid=["a", "b"], **boxes
        ),
        "map/log_ground_height_surface____PIT.npy": numpy,
        "map/log___img_Sim2_city.json": f'{{"R": [1, 0, 0, 1], "t": [{100 - x}, {100 - y}], "s": 2.0}}'.encode(),
    }))  # fmt: skip


def _run(*words: str) -> str:
    with pytest.raises(SystemExit) as done:
        main(["evaluate", *words])
    assert done.value.code in (0, None)
    return Path(words[-1]).read_text(encoding="utf-8")


def _rows(page: str, heading: str) -> dict[str, list[str]]:
    lines = page.partition(f"## {heading}\n")[2].partition("\n## ")[0].splitlines()
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")]
    return {row[0]: row[1:] for row in cells[2:]}


def test_claims_over_ground_that_is_surveyed_elsewhere_are_counted(log: Path, tmp_path: Path) -> None:
    page = _run("survey", str(log), "--methods", "shadow_map,continuous", "--out", str(tmp_path / "page.md"))
    off = _rows(page, "Claims on ground that lies elsewhere")
    for name in ("shadow_map", "continuous"):
        for cell in off[name]:
            # The western half of the view, less what the wall hides there.
            assert 0.25 < float(cell.partition(" ")[0]) < 0.55, off
    enough, none = _rows(page, "Vehicles with returns"), _rows(page, "Vehicles without a return")
    assert enough["shadow_map"][0] == "1.000 of 1"
    assert none["shadow_map"][1] == ".000 of 1"
    # The bottoms of the boxes lie on the true ground, which the survey of the west does not.
    bottoms = _rows(page, "Ground below boxes")
    assert float(bottoms["seen, 0 to 16 m"][1]) < 0.05 or float(bottoms["unseen, 0 to 16 m"][1]) < 0.05


def test_a_raster_is_read_where_it_lies_and_unknown_beyond() -> None:
    survey = SurveyedGround(np.array([[1.0, 2.0], [3.0, np.nan]]), np.array([10.0, 20.0]), 0.5)
    xyz = np.array(
        [[-10.0, -20.0, 0.0], [-7.9, -20.0, 0.0], [-10.0, -17.0, 0.0], [-7.0, -17.0, 0.0], [-10.1, -20.0, 0.0]]
    )
    np.testing.assert_equal(survey.at(xyz), [1.0, 2.0, 3.0, np.nan, np.nan])


def test_returns_in_a_turned_box_and_the_point_where_it_is_looked_up() -> None:
    box = ObjectBox(Rigid.from_yaw(np.pi / 2, (10.0, 0.0, 0.0)), (4.0, 2.0, 1.5), "car")
    inside = [[9.1, 1.9, 0.0], [10.9, -1.9, 0.7], [8.95, 0.0, 0.0]]  # the last one within the margin
    sweep = Sweep(np.array([*inside, [11.9, 0.0, 0.0], [10.0, 0.0, 0.9], [8.8, 0.0, 0.0]]))
    assert returns_in(box, sweep) == len(inside)
    np.testing.assert_allclose(near_point(Rigid.identity(), box), [9.3, 0.0], atol=1e-9)


def test_the_count_of_those_who_drew_a_box_decides_and_a_return_at_its_edge_is_none_of_a_hidden_one() -> None:
    sweep = Sweep(np.array([[10.0, 0.0, 0.0], [11.05, 0.0, 0.0]]))
    for told, judged in ((None, 2), (7, 7), (0, 1)):
        box = ObjectBox(Rigid.from_yaw(0.0, (10.0, 0.0, 0.0)), (2.0, 2.0, 1.5), "car", returns=told)
        assert judged_returns(box, sweep) == judged
    far = ObjectBox(Rigid.from_yaw(0.0, (50.0, 0.0, 0.0)), (2.0, 2.0, 1.5), "car", returns=0)
    assert judged_returns(far, sweep) == 0


@pytest.mark.parametrize(("told", "enough"), [(57, "of 2"), (3, "–")])
def test_boxes_of_nuscenes_are_judged_by_the_annotators_counts(told: int, enough: str, tmp_path: Path) -> None:
    tables = nuscenes.write_tree(tmp_path, [(nuscenes.made(k), 10**6 * (k + 1), nuscenes.WORLD[k]) for k in range(4)])
    for row in tables["sample_annotation"]:
        row["num_lidar_pts"] = told
    nuscenes.put(tmp_path / "v1.0-mini", tables)
    page = _run("boxes", str(tmp_path), "--methods", "shadow_map", "--out", str(tmp_path / "page.md"))
    assert _rows(page, "Vehicles with returns")["shadow_map"][0].endswith(enough)
    assert f"{0 if told == 57 else 2}\nvehicles with fewer returns" in page
    assert "survey" not in page


def test_boxes_of_kitti_are_judged_by_the_returns_in_them(tmp_path: Path) -> None:
    kitti.write_objects(tmp_path, {"000007": kitti.made(7)})
    page = _run("boxes", str(tmp_path), "--methods", "shadow_map", "--out", str(tmp_path / "page.md"))
    assert _rows(page, "Vehicles without a return")["shadow_map"] == ["–", "–", ".000 of 1", "–"]


def test_a_damaged_sweep_costs_no_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kitti.write_objects(tmp_path, {"000007": kitti.made(7), "000008": kitti.made(8)})
    damaged = next(tmp_path.rglob("000008.bin"))
    damaged.write_bytes(damaged.read_bytes()[:-3])
    with pytest.raises(SystemExit) as done:
        main(["evaluate", "boxes", str(tmp_path), "--methods", "shadow_map", "--out", str(tmp_path / "page.md")])
    assert (done.value.code, "1 sweeps of" in (tmp_path / "page.md").read_text()) == (2, True)
    assert "000008.bin" in capsys.readouterr().err


def test_a_recording_without_boxes_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tables = nuscenes.write_tree(tmp_path, [(nuscenes.made(0), 10**6, nuscenes.WORLD[0])])
    nuscenes.put(tmp_path / "v1.0-mini", {**tables, "sample_annotation": []})
    with pytest.raises(SystemExit) as done:
        main(["evaluate", "boxes", str(tmp_path)])
    assert done.value.code == 2
    assert "must hold annotated boxes, got 1 sweeps without one" in capsys.readouterr().err


def test_surveyed_ground_agrees_with_the_real_log(real_data: Path, tmp_path: Path) -> None:
    survey = real_data.parent / "judges" / "survey"
    if not survey.is_dir():
        pytest.skip("no surveyed ground: ../shared/judges is not there")
    [source] = [folder for folder in survey.iterdir() if folder.is_dir()]
    files = {str(file.relative_to(source)): file.read_bytes() for file in source.rglob("*") if file.is_file()}
    for file in (real_data / "argoverse2").glob("*.feather"):
        files[f"sensors/lidar/{file.stem.rpartition('_')[2]}.feather"] = file.read_bytes()
    page = _run(
        "survey",
        str(made.write(tmp_path / "log", files)),
        "--methods",
        "shadow_map",
        "--out",
        str(tmp_path / "page.md"),
    )
    ground = _rows(page, "Ground below the cells")
    for low, high in BANDS_M[:3]:
        assert float(ground[f"seen, {low:g} to {high:g} m"][1]) < 0.1
