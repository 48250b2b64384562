"""Every exporter: states map as documented, what is read back equals what was written, files are whole."""

import contextlib
import io
import json
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from tests.io.export.readers import fov_of_geojson, polygons_of_osi

from viewshed import load_estimator, read_sweep
from viewshed.fov.estimate import Basis, CellState, FovEstimate
from viewshed.fov.polygons import polygon_of_mask
from viewshed.fov.visibility import PEDESTRIAN
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.io.export import (
    EXPORTERS,
    Exporter,
    claimed_by_cpm,
    read_npz,
    to_cpm,
    to_geojson,
    to_grid_map,
    to_occupancy_grid,
    to_occupancy_grids,
    to_osi,
    write_export,
    write_npz,
)

BASIS = Basis(1.84, "estimated", 0.63, 0.04, 0.07, 80.0)
POSE = Rigid.from_yaw(0.7, (105.0, -37.5, 2.0))


def random_estimate(seed: int, cells: int = 13, pose: Rigid | None = None) -> FovEstimate:
    rng = np.random.default_rng(seed)
    state = rng.integers(0, 4, (cells, cells)).astype(np.uint8)
    seen = (state == CellState.FREE) | (state == CellState.SURFACE)
    prob = np.where(seen, rng.uniform(0.5, 1, state.shape), rng.uniform(0, 0.49, state.shape)).astype(np.float32)
    std = np.where(rng.random(state.shape) < 0.5, np.nan, rng.random(state.shape)).astype(np.float32)
    return FovEstimate(
        BevGrid(cells, 0.31 * cells, (2.5, -1.25)), prob, state, std,
        method="shadow_map", target=PEDESTRIAN, world_from_level=pose, t_ns=1_533_151_603_547_590_123, agent="left",
        basis=BASIS,
    )  # fmt: skip


def street(blind: bool = False) -> FovEstimate:
    """An asymmetric street: a wall on the left, shadows, a range that ends; a vehicle's own blind spot if asked."""
    grid = BevGrid(96, 24.0)
    x, y = grid.centers[..., 0], grid.centers[..., 1]
    distance, angle = np.hypot(x, y), np.arctan2(y, x)
    seen = (distance < 21) & (y < 9) & (x > -14)
    for at, near, width in [(0.4, 6, 0.15), (-1.1, 8, 0.2), (2.6, 5, 0.1), (-2.5, 9, 0.3)]:
        seen &= ~((np.abs(angle - at) < width) & (distance > near))
    if blind:
        seen &= ~((np.abs(x + 0.7) < 1.4) & (np.abs(y) < 0.8))
    return FovEstimate(grid, seen.astype(np.float32), np.where(seen, CellState.FREE, CellState.HIDDEN))


@pytest.mark.parametrize("name", EXPORTERS)
@pytest.mark.parametrize("pose", [None, POSE])
def test_every_exporter_writes_a_whole_file(name: str, pose: Rigid | None, tmp_path: Path) -> None:
    path = tmp_path / f"fov{EXPORTERS[name].suffix}"
    estimate = random_estimate(1, pose=pose)
    write_export(estimate, name, path)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == sorted(EXPORTERS[name].files(estimate, path.name))
    content = path.read_bytes()
    if name == "npz":
        assert zipfile.is_zipfile(io.BytesIO(content))
    elif path.suffix not in {".tif", ".yaml"}:  # test_opened.py opens these
        json.loads(content, parse_constant=pytest.fail)


@pytest.mark.parametrize("name", EXPORTERS)
def test_every_exporter_takes_an_estimate_that_sees_nothing(name: str) -> None:
    grid = BevGrid(16, 8.0)
    blank = FovEstimate(grid, np.zeros(grid.shape, np.float32), np.zeros(grid.shape, np.uint8))
    assert all(len(content) > 0 for content in EXPORTERS[name].files(blank, "x").values())


def test_a_failed_export_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "fov.json"
    path.write_text("old")

    def broken(estimate: FovEstimate) -> dict[str, Any]:
        return {"value": float("nan")}

    monkeypatch.setitem(EXPORTERS, "broken", Exporter(broken, ".json", b"no file has this", ""))
    with pytest.raises(ValueError, match="JSON"):
        write_export(random_estimate(0), "broken", path)
    monkeypatch.setattr("os.fsync", lambda _: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        write_export(random_estimate(0), "geojson", path)
    assert path.read_text() == "old"
    assert len(list(tmp_path.iterdir())) == 1


def test_unknown_format_and_missing_folder(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"format must be one of geojson, .*npz, got 'shp'"):
        write_export(random_estimate(0), "shp", tmp_path / "x")
    with pytest.raises(FileNotFoundError):
        write_export(random_estimate(0), "npz", tmp_path / "missing" / "x.npz")
    with pytest.raises(IsADirectoryError, match="path must name a file"):
        write_export(random_estimate(0), "npz", tmp_path)


@given(st.integers(0, 1000), st.booleans())
@settings(max_examples=25)
def test_npz_loses_nothing(tmp_path_factory: pytest.TempPathFactory, seed: int, posed: bool) -> None:
    made = random_estimate(seed, pose=POSE if posed else None)
    path = tmp_path_factory.mktemp("npz") / "fov.npz"
    write_npz(made, path)
    back = read_npz(path)
    for name in ("visible_prob", "std", "state"):
        np.testing.assert_array_equal(getattr(back, name), getattr(made, name))
    for name in ("grid", "method", "target", "t_ns", "agent", "basis"):
        assert getattr(back, name) == getattr(made, name)
    assert (back.world_from_level is None) == (made.world_from_level is None)
    if back.world_from_level is not None:
        np.testing.assert_array_equal(back.world_from_level.as_matrix(), POSE.as_matrix())


def test_npz_without_a_basis_reads_as_none(tmp_path: Path) -> None:
    write_npz(replace(random_estimate(3), basis=None), tmp_path / "fov.npz")
    assert read_npz(tmp_path / "fov.npz").basis is None
    # So did version 0.3 write it.
    with np.load(tmp_path / "fov.npz") as file:
        arrays = dict(file)
    about = json.loads(arrays["about"].tobytes())
    del about["basis"]
    np.savez(tmp_path / "old.npz", **(arrays | {"about": np.frombuffer(json.dumps(about).encode(), np.uint8)}))
    assert read_npz(tmp_path / "old.npz").basis is None


def test_broken_npz_gets_one_line(tmp_path: Path) -> None:
    path = tmp_path / "fov.npz"
    write_npz(random_estimate(3), path)
    whole = path.read_bytes()
    for broken in (b"", b"PK\x03\x04", whole[: len(whole) // 2], b"\x93NUMPY" + whole):
        path.write_bytes(broken)
        with pytest.raises(ValueError, match=r"fov.npz must be an NPZ of write_npz: ") as caught:
            read_npz(path)
        assert "\n" not in str(caught.value)
    np.savez(path, visible_prob=np.array([{"a": 1}], dtype=object))
    with pytest.raises(ValueError, match="must be an NPZ of write_npz"):
        read_npz(path)


@given(st.integers(0, 2**32), st.integers(0, 2000))
@settings(max_examples=60)
def test_mutated_npz_never_crashes(tmp_path_factory: pytest.TempPathFactory, seed: int, at: int) -> None:
    path = tmp_path_factory.mktemp("npz") / "fov.npz"
    write_npz(random_estimate(3), path)
    content = bytearray(path.read_bytes())
    rng = np.random.default_rng(seed)
    content[at % len(content)] = int(rng.integers(256))
    path.write_bytes(bytes(content))
    with contextlib.suppress(ValueError):
        assert read_npz(path).grid.cells >= 1


@pytest.mark.parametrize("pose", [None, POSE])
def test_geojson_round_trip(pose: Rigid | None) -> None:
    made = random_estimate(5, pose=pose)
    back = fov_of_geojson(json.loads(json.dumps(to_geojson(made, 0.5))))
    np.testing.assert_array_equal(back.state, made.state)
    np.testing.assert_array_equal(back.visible(), made.visible())
    assert back.grid == made.grid
    assert (back.t_ns, back.agent, back.method, back.basis) == (made.t_ns, "left", "shadow_map", BASIS)
    assert fov_of_geojson(to_geojson(replace(made, basis=None))).basis is None


def test_geojson_states_its_frame_and_area() -> None:
    made = to_geojson(random_estimate(5, pose=POSE))
    assert made["viewshed:frame"]["coordinates"] == "meters in world frame, not WGS84"
    assert to_geojson(random_estimate(5))["viewshed:frame"]["coordinates"] == "meters in level frame, not WGS84"
    visible = next(each for each in made["features"] if each["properties"]["layer"] == "visible")
    assert visible["properties"]["area_m2"] == pytest.approx(random_estimate(5).area_m2())
    assert shapely.geometry.shape(visible["geometry"]).is_valid


def test_occupancy_grid_by_hand() -> None:
    grid = BevGrid(2, 1.0, (3.0, 0.0))
    state = np.array([[CellState.FREE, CellState.SURFACE], [CellState.HIDDEN, CellState.UNKNOWN]])
    prob = np.array([[0.9, 0.8], [0.2, 0.1]])
    made = to_occupancy_grids(FovEstimate(grid, prob, state, t_ns=2_000_000_007, agent="bus"))
    occupancy, visibility = made["occupancy"], made["visibility"]
    assert occupancy["data"] == [0, -1, 100, -1]
    assert made["state"]["data"] == [0, 50, 100, -1]
    assert visibility["data"] == [90, 20, 80, -1]
    assert occupancy["info"]["origin"]["position"] == {"x": 2.0, "y": -1.0, "z": 0.0}
    assert (occupancy["info"]["resolution"], occupancy["info"]["width"]) == (grid.cell_m, 2)
    assert occupancy["header"] == {"stamp": {"sec": 2, "nanosec": 7}, "frame_id": "bus/level"}
    with pytest.raises(ValueError, match="layer must be occupancy, visibility, state or doubt, got 'cost'"):
        to_occupancy_grid(street(), "cost")


def test_cells_of_a_grid_map_lie_where_grid_map_core_has_them() -> None:
    """Position (row, column) of https://github.com/ANYbotics/grid_map: both count from the farthest corner."""
    made = random_estimate(6)
    message = json.loads(json.dumps(to_grid_map(made), allow_nan=False))
    info, (row, column) = message["info"], np.indices(made.grid.shape)
    center = info["pose"]["position"]
    first = 0.5 * info["length_x"] - 0.5 * info["resolution"]
    x, y = (center[axis] + first - info["resolution"] * at.ravel() for axis, at in (("x", row), ("y", column)))
    i, j = np.rint((np.column_stack([x, y]) - made.grid.centers[0, 0]) / made.grid.cell_m).astype(int).T
    std: NDArray[Any] = np.nan_to_num(made.std, nan=-1.0)
    layers: dict[str, NDArray[Any]] = {"visible_prob": made.visible_prob, "state": made.state, "std": std}
    assert message["layers"] == list(layers)
    for each, values in zip(message["data"], layers.values(), strict=True):
        found = np.array(each["data"], np.float32).reshape(made.grid.shape, order="F")
        np.testing.assert_array_equal(found.ravel(), values[i, j])
    assert info["length_x"] == pytest.approx(2 * made.grid.half_extent_m)
    assert to_grid_map(street())["layers"] == ["visible_prob", "state"]  # no cell has a deviation


def test_osi_round_trip() -> None:
    made = random_estimate(9)
    message = json.loads(json.dumps(to_osi(made)))
    assert message["timestamp"] == {"seconds": 1_533_151_603, "nanos": 547_590_123}
    layers = polygons_of_osi(message)
    visible = made.visible()
    for layer, mask in [
        ("visible", visible),
        ("hidden", made.state == CellState.HIDDEN),
        ("unknown", made.state == CellState.UNKNOWN),
    ]:
        assert layers[layer].equals(polygon_of_mask(mask, made.grid))
    assert "timestamp" not in to_osi(street())


def shapes_of(message: dict[str, Any]) -> list[int]:
    """How many radial shapes or nodes each region has."""
    counts = []
    for region in message["perceptionRegionContainer"]:
        ((kind, shape),) = region["perceptionRegionShape"].items()
        counts.append(len(shape["radialShapesList" if kind == "radialShapes" else "polygon"]))
    return counts


@pytest.mark.parametrize("blind", [False, True])
@pytest.mark.parametrize("shape", ["sectors", "polygon"])
@pytest.mark.parametrize("count", [5, 40])
@pytest.mark.parametrize("whole_cells", [True, False])
def test_cpm_never_claims_a_cell_that_is_not_visible(blind: bool, shape: str, count: int, whole_cells: bool) -> None:
    made = street(blind)
    message = json.loads(json.dumps(to_cpm(made, count, shape, whole_cells=whole_cells)))
    claimed = claimed_by_cpm(message, made.grid.centers)
    visible = made.visible()
    assert not (claimed & ~visible).any()
    assert message["viewshed:share_kept"] == pytest.approx((claimed & visible).sum() / visible.sum())
    assert sum(shapes_of(message)) <= count
    assert max(shapes_of(message), default=0) <= 16
    if whole_cells:
        points = np.random.default_rng(count).uniform(-24, 24, (20_000, 2))
        assert not (claimed_by_cpm(message, points) & ~(made.at(points) >= 0.5)).any()


@pytest.mark.parametrize("grid", [BevGrid(200, 64.0), BevGrid(240, 60.0), BevGrid(256, 64.0, (20.1, 0.0))])
def test_cpm_of_a_real_sweep_never_claims_a_cell_that_is_not_visible(real_data: Path, grid: BevGrid) -> None:
    sweep = read_sweep(real_data / "kitti/object/000000.bin")
    made = load_estimator("shadow_map", grid=grid).estimate(sweep)
    claimed = claimed_by_cpm(to_cpm(made), grid.centers)
    assert claimed.any()
    assert not (claimed & ~made.visible()).any()


def test_cpm_keeps_most_of_a_clean_street() -> None:
    made = street()
    kept = [to_cpm(made, count)["viewshed:share_kept"] for count in (4, 16, 64)]
    assert kept == sorted(kept)
    assert kept[1] > 0.75
    assert kept[2] > 0.85
    assert to_cpm(made, 64, whole_cells=False)["viewshed:share_kept"] > 0.94


def test_cpm_footprint_closes_the_blind_spot() -> None:
    made = street(blind=True)
    message = to_cpm(made, 16, footprint_m=2.5)
    assert [
        region["perceptionRegionShape"]["radialShapes"]["xCoordinate"]
        for region in message["perceptionRegionContainer"]
    ] == [0]
    claimed = claimed_by_cpm(message, made.grid.centers)
    near = np.hypot(*np.moveaxis(made.grid.centers, -1, 0)) < 2.5
    assert not (claimed & ~made.visible() & ~near).any()


def test_cpm_refuses_what_the_format_cannot_say() -> None:
    with pytest.raises(ValueError, match=r"sectors must lie in \[4, 4096\], got 3"):
        to_cpm(street(), 3)
    with pytest.raises(ValueError, match="shape must be sectors or polygon, got 'star'"):
        to_cpm(street(), 16, "star")
    grid = BevGrid(4, 400.0)
    wide = FovEstimate(grid, np.ones(grid.shape, np.float32), np.ones(grid.shape, np.uint8))
    with pytest.raises(ValueError, match="grid must lie within ±327 m"):
        to_cpm(wide)
