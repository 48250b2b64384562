"""Readers of exports, as other programs read them; tests compare the result with what was written."""

from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import MultiPolygon, Polygon
from shapely.affinity import affine_transform

from viewshed.fov.estimate import Basis, CellState, FovEstimate
from viewshed.fov.polygons import mask_of_polygon
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid


def fov_of_geojson(collection: dict[str, Any]) -> FovEstimate:
    """Return the estimate in a GeoJSON collection: exact states, probability 1 where visible, else 0."""
    where, frame = collection["viewshed:grid"], collection["viewshed:frame"]
    grid = BevGrid(where["cells"], where["half_extent_m"], tuple(where["offset_m"]))
    pose = None if frame["world_from_level"] is None else Rigid.from_matrix(frame["world_from_level"])
    features = {feature["properties"]["layer"]: feature for feature in collection["features"]}
    masks = {layer: mask_of(feature["geometry"], pose, grid, frame["crs"]) for layer, feature in features.items()}
    state = np.zeros(grid.shape, np.uint8)
    for value in CellState:
        state[masks[value.name.lower()]] = value
    about = features["visible"]["properties"]
    names = Basis.__dataclass_fields__
    return FovEstimate(
        grid, masks["visible"].astype(np.float32), state,
        method=about["method"], world_from_level=pose, t_ns=about["t_ns"], agent=about["agent"],
        basis=Basis(**{name: about[name] for name in names}) if "reach_m" in about else None,
    )  # fmt: skip


def mask_of(geometry: dict[str, Any], pose: Rigid | None, grid: BevGrid, crs: str | None) -> NDArray[np.bool_]:
    polygon = shapely.geometry.shape(geometry)
    if crs is not None:
        from rasterio.warp import transform

        polygon = shapely.transform(polygon, lambda xy: np.column_stack(transform("OGC:CRS84", crs, *xy.T)))
    if pose is not None:
        back = Rigid.from_yaw(pose.yaw, (*pose.translation[:2], 0.0)).inverse()
        polygon = affine_transform(polygon, [*back.rotation[:2, :2].ravel(), *back.translation[:2]])
    return mask_of_polygon(polygon, grid)


def polygons_of_osi(message: dict[str, Any]) -> dict[str, MultiPolygon]:
    """Return the polygons of an OSI message by layer."""
    parts: dict[str, list[Polygon]] = {"visible": [], "hidden": [], "unknown": []}
    for entry in message["polygons"]:
        outer, *inner = ([(at["x"], at["y"]) for at in ring] for ring in (entry["outer"], *entry["inner"]))
        parts[entry["layer"]].append(Polygon(outer, inner))
    return {layer: MultiPolygon(polygons) for layer, polygons in parts.items()}
