"""Exports opened by the programs that they are for: geopandas, rasterio, and nav2's map server by its documentation."""

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
import yaml
from numpy.typing import NDArray
from tests.io.export.readers import fov_of_geojson
from tests.io.export.test_export import random_estimate

from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.geometry import Rigid
from viewshed.io.export import to_geojson, to_occupancy_grid, write_export
from viewshed.io.export.nav2 import NOTHING_KNOWN

HAMBURG = Rigid.from_yaw(0.4, (566_000.0, 5_930_000.0, 12.0))
"""In EPSG:25832: 9.9953 degrees east, 53.5148 degrees north."""

GEOPANDAS = """
import json, sys, warnings
warnings.simplefilter("error")
import geopandas
frame = geopandas.read_file(sys.argv[1])
print(json.dumps([frame.crs.type_name, frame.crs.to_epsg(), frame.total_bounds.tolist(), frame.to_crs(
    sys.argv[2]).area.tolist() if len(sys.argv) > 2 else frame.area.tolist()]))
"""


def load_nav2(path: Path) -> tuple[NDArray[np.int8], dict[str, Any]]:
    """Return the values (height, width) of nav_msgs/OccupancyGrid as nav2's map server makes them of a YAML file.

    https://docs.nav2.org/configuration/packages/configuring-map-server.html: darkness is 1 - pixel / 255. Trinary:
    above occupied_thresh 100, below free_thresh 0, else -1. Raw: 0 to 100 as they are, others -1. Row 0 of the grid is
    the lowest row of the picture.
    """
    about = yaml.safe_load(path.read_text(encoding="utf-8"))
    match = re.match(rb"P5\n(\d+) (\d+)\n255\n", content := (path.parent / about["image"]).read_bytes())
    width, height = int(match[1]), int(match[2])
    pixels = np.frombuffer(content[match.end() :], np.uint8).reshape(height, width)
    dark = 1.0 - pixels / 255.0
    assert len(about["origin"]) == 3
    assert about["negate"] == 0
    if about["mode"] == "trinary":
        values = np.where(dark > about["occupied_thresh"], 100, np.where(dark < about["free_thresh"], 0, -1))
    else:
        assert about["mode"] == "raw"
        values = np.where(pixels <= 100, pixels.astype(np.int16), -1)
    return values[::-1].astype(np.int8), about


def test_nav2_loads_the_map(tmp_path: Path) -> None:
    estimate = random_estimate(3)
    write_export(estimate, "nav2_map", tmp_path / "it's a view.nav2_map.yaml")
    values, about = load_nav2(tmp_path / "it's a view.nav2_map.yaml")
    # Row by row with x fastest, as the occupancy layer of the same estimate.
    assert values.ravel().tolist() == to_occupancy_grid(estimate)["data"]
    assert about["resolution"] == pytest.approx(estimate.grid.cell_m)
    assert about["origin"] == pytest.approx([*estimate.grid.origin_m, 0.0])


def test_nav2_loads_the_mask_of_what_is_not_seen_within_reach(tmp_path: Path) -> None:
    estimate = random_estimate(4)
    short = replace(estimate, basis=replace(estimate.basis, reach_m=3.0))
    write_export(short, "nav2_mask", tmp_path / "m.nav2_mask.yaml")
    values, about = load_nav2(tmp_path / "m.nav2_mask.yaml")
    assert about["mode"] == "raw"
    far = np.hypot(*np.moveaxis(estimate.grid.centers, -1, 0)) > 3.0
    assert 0 < far.sum() < values.size
    np.testing.assert_array_equal(values.T, np.where(far, NOTHING_KNOWN, np.where(estimate.visible(), 0, 100)))


def test_a_map_with_a_pose_lies_along_the_axes_of_the_map(tmp_path: Path) -> None:
    state = np.zeros((40, 40), np.uint8)
    state[30, 10] = CellState.SURFACE  # one cell far ahead and to the right
    grid = type(random_estimate(0).grid)(40, 20.0)
    pose = Rigid.from_yaw(np.pi / 2, (100.0, 50.0, 1.0))
    estimate = FovEstimate(grid, (state > 0).astype(np.float32), state, world_from_level=pose)
    write_export(estimate, "nav2_map", tmp_path / "m.yaml")
    values, about = load_nav2(tmp_path / "m.yaml")
    [[row, column]] = np.argwhere(values == 100)
    x_m, y_m = about["origin"][0] + (column + 0.5) * 1.0, about["origin"][1] + (row + 0.5) * 1.0
    ahead_m, left_m = grid.centers[30, 10]
    assert about["origin"][2] == 0.0
    assert [x_m, y_m] == pytest.approx([100.0 - left_m, 50.0 + ahead_m], abs=1.0)


def test_rasterio_opens_the_raster_where_the_cells_lie(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio", reason="needs the extra geo")
    estimate = random_estimate(6, pose=HAMBURG)
    write_export(estimate, "geotiff", tmp_path / "fov.tif", crs="EPSG:25832")
    with rasterio.open(tmp_path / "fov.tif") as raster:
        assert raster.crs.to_epsg() == 25832
        assert raster.descriptions == ("state", "visible_prob", "std")
        centers = estimate.grid.centers.reshape(-1, 2)
        world = (HAMBURG @ np.column_stack([centers, np.zeros(len(centers))]))[:, :2]
        read = np.array(list(raster.sample(world)))
    assert (read[:, 0] == estimate.state.ravel()).all()
    assert (read[:, 1] == estimate.visible_prob.ravel()).all()
    assert np.array_equal(read[:, 2], np.asarray(estimate.std).ravel(), equal_nan=True)


def test_a_raster_without_a_reference_system_says_none(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio", reason="needs the extra geo")
    estimate = random_estimate(7)
    write_export(estimate, "geotiff", tmp_path / "fov.tif")
    with rasterio.open(tmp_path / "fov.tif") as raster:
        assert raster.crs is None
        assert raster.tags()["frame"] == "level"
        assert raster.bounds.left == pytest.approx(estimate.grid.origin_m[0])


def test_geojson_in_a_reference_system_keeps_to_rfc_7946() -> None:
    pytest.importorskip("rasterio", reason="needs the extra geo")
    estimate = random_estimate(9, pose=HAMBURG)
    made = json.loads(json.dumps(to_geojson(estimate, crs="EPSG:25832")))
    assert "crs" not in made  # section 4: WGS84, without a member that says so
    for feature in made["features"]:
        polygon = shapely.geometry.shape(feature["geometry"])
        west, south, east, north = polygon.bounds
        # In place, and in the order longitude, latitude.
        assert 9.9951 < west < east < 9.9956
        assert 53.5147 < south < north < 53.5149
        for part in shapely.get_parts(polygon):  # section 3.1.6: the exterior ring is counterclockwise, holes clockwise
            assert part.exterior.is_ccw
            assert not any(hole.is_ccw for hole in part.interiors)
    back = fov_of_geojson(made)
    assert (back.state == estimate.state).all()
    assert back.world_from_level is not None


def opened_by_geopandas(path: Path, *arguments: str) -> list[Any]:
    """Return type of the reference system, its EPSG code, the bounds and the areas that geopandas reads."""
    pytest.importorskip("geopandas", reason="needs the extra docs")
    words = [sys.executable, "-c", GEOPANDAS, str(path), *arguments]
    done = subprocess.run(words, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    read: list[Any] = json.loads(done.stdout)
    return read


@pytest.mark.docs
def test_geopandas_opens_meters_as_meters(tmp_path: Path) -> None:
    estimate = random_estimate(10)
    write_export(estimate, "geojson", tmp_path / "fov.geojson")
    kind, epsg, _, areas_m2 = opened_by_geopandas(tmp_path / "fov.geojson")
    assert (kind, epsg) == ("Engineering CRS", None)
    assert areas_m2[0] == pytest.approx(estimate.area_m2())


@pytest.mark.docs
def test_geopandas_opens_a_reference_system_in_its_place(tmp_path: Path) -> None:
    estimate = random_estimate(11, pose=HAMBURG)
    write_export(estimate, "geojson", tmp_path / "fov.geojson", crs="EPSG:25832")
    kind, epsg, bounds, areas_m2 = opened_by_geopandas(tmp_path / "fov.geojson", "EPSG:25832")
    assert (kind, epsg) == ("Geographic 2D CRS", 4326)
    assert bounds == pytest.approx([9.9953, 53.5148, 9.9954, 53.5149], abs=2e-4)
    assert areas_m2[0] == pytest.approx(estimate.area_m2(), rel=1e-4)
