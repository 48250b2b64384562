"""Perspective pictures of a world, rendered by the ray caster itself: what it casts is what is seen."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F32
from viewshed.geometry import Rigid
from viewshed.sensors import LidarModel
from viewshed_lab.sim.assets.shapes import MATERIALS, material_index
from viewshed_lab.sim.raycast.caster import cast_world
from viewshed_lab.sim.raycast.scan import ExactScan
from viewshed_lab.sim.world import GROUND, NOTHING, Snapshot, World

Image = NDArray[np.uint8]

CEILING_M = 2.0
"""Indoors, things that begin higher than this above the ground are left out of pictures."""

_MATERIAL_COLORS = {
    "asphalt": (0.40, 0.41, 0.43), "concrete": (0.70, 0.69, 0.66), "plaster": (0.87, 0.82, 0.72),
    "brick": (0.68, 0.40, 0.31), "paint": (0.75, 0.77, 0.80), "dark_paint": (0.17, 0.18, 0.22),
    "metal": (0.58, 0.61, 0.66), "sign": (0.96, 0.80, 0.12), "clothes": (0.88, 0.28, 0.12),
    "bark": (0.42, 0.29, 0.18), "grass": (0.52, 0.66, 0.34), "wood": (0.70, 0.52, 0.31),
    "rubber": (0.10, 0.10, 0.10), "leaves": (0.30, 0.54, 0.20), "hedge": (0.22, 0.46, 0.20),
    "mesh": (0.62, 0.70, 0.70), "glass": (0.55, 0.80, 0.92), "absorber": (0.05, 0.05, 0.09),
    "cabin": (0.20, 0.24, 0.28), "window": (0.50, 0.77, 0.95), "tinted": (0.30, 0.45, 0.52),
}  # fmt: skip

_CAR_COLORS = ((0.80, 0.16, 0.16), (0.16, 0.34, 0.72), (0.92, 0.92, 0.90), (0.20, 0.50, 0.46), (0.88, 0.66, 0.16),
               (0.55, 0.57, 0.60))  # fmt: skip

_SKY = (0.80, 0.88, 0.96)

_SUN = np.array([0.42, -0.30, 0.86], np.float32)

_SAMPLES = 2

_HAZE_M = 150.0


@dataclass(frozen=True, slots=True)
class Lens:
    """A pinhole camera."""

    pitch_deg: float = -12.0  # how far it looks up; negative is down
    across_deg: float = 95.0  # horizontal field of view
    shape: tuple[int, int] = (256, 470)  # pixels down and across

    def __post_init__(self) -> None:
        if not (-60 <= self.pitch_deg <= 30 and 20 <= self.across_deg <= 120 and min(self.shape) >= 2):
            raise ValueError(f"pitch_deg must lie in [-60, 30], across_deg in [20, 120], got {self}")

    @property
    def focal(self) -> float:
        """Focal length in pixels."""
        return float(self.shape[1] / 2 / np.tan(np.deg2rad(self.across_deg) / 2))

    def project(self, points: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """Return pixels (n, 2) down and across of points (n, 3) before the camera, and which lie in the picture."""
        tilted = points @ _pitch(self.pitch_deg)
        ahead = np.maximum(tilted[:, 0], 1e-6)
        down, across = (np.array(size / 2 - self.focal * tilted[:, axis] / ahead)
                        for size, axis in zip(self.shape, (2, 1), strict=True))  # fmt: skip
        inside = (tilted[:, 0] > 0.1) & (down >= 0) & (down < self.shape[0]) & (across >= 0) & (across < self.shape[1])
        pixels = np.column_stack([down, across])
        pixels[~inside] = 0
        return pixels.astype(np.intp), inside


@dataclass(frozen=True, slots=True, eq=False)
class Photo:
    """A picture: ``image`` (down, across, 3) and ``depth_m`` (down, across) of its pixels, +inf for the sky."""

    image: Image
    depth_m: NDArray[np.float32]


def photograph(world: World, snapshot: Snapshot, world_from_camera: Rigid, lens: Lens, seed: int = 0) -> Photo:
    """Return what a camera at an upright pose sees: colors of things, lit by the sun, fading into the distance."""
    model, column, ring = _rays(lens)
    scan = cast_world(snapshot, model, world_from_camera, seed=seed)
    light = _light(scan)[column, ring]
    depth_m, thing = scan.depth_m[column, ring], scan.thing[column, ring]
    colors = surface_colors(world, thing, scan.material[column, ring])
    near = np.exp(-depth_m / _HAZE_M)[..., None]
    lit = np.where((thing == NOTHING)[..., None], colors, np.minimum(colors * light[..., None], 1.0))
    pictured = _shrunk(lit * near + np.array(_SKY, np.float32) * (1 - near))
    return Photo(to_bytes(pictured), depth_m[::_SAMPLES, ::_SAMPLES])


def viewpoint(snapshot: Snapshot, eye: NDArray[np.float64], yaw: float, ways_m: NDArray[np.float64]) -> Rigid:
    """Return the first upright pose among steps (n, 3) back, left and up from ``eye`` with a clear line to it.

    If nothing is clear, the eye itself.
    """
    for offset in ways_m:
        step = Rigid.from_yaw(yaw).rotation @ offset
        length = float(np.linalg.norm(step))
        if _clear_m(snapshot, eye, step / length) > length + 1.0:
            return Rigid.from_yaw(yaw, eye + step)
    return Rigid.from_yaw(yaw, eye)


def without_ceiling(world: World, snapshot: Snapshot) -> tuple[Snapshot, float]:
    """Return the solids of a building without its ceiling and what hangs, and how high one sees then, in meters.

    Things that begin higher than ``CEILING_M`` above the ground are left out, and ceilings; outdoors none is.
    """
    bottoms = np.array([min(part.bottom_m for part in thing.parts) for thing in world.things])
    roofs = np.array([thing.kind == "ceiling" for thing in world.things], np.bool_)
    above = ((bottoms >= CEILING_M) | roofs) & world.indoor
    kept = ~above[snapshot.thing]
    arrays = ("kind", "center_m", "rotation", "half_m", "velocity_mps", "material", "thing")
    lower = replace(snapshot, **{name: getattr(snapshot, name)[kept] for name in arrays})
    return lower, float(bottoms[above].min(initial=np.inf))


def surface_colors(world: World, thing: NDArray[np.int32], material: NDArray[np.uint8]) -> F32:
    """Return colors (…, 3) in [0, 1] of what was met: by material, painted vehicles each in one of six colors.

    >>> from viewshed_lab.sim.terrain import Terrain
    >>> empty = World("empty", Terrain.plane(9.0))
    >>> colors = surface_colors(empty, np.array([-1], np.int32), np.array([material_index("grass")], np.uint8))
    >>> int(colors[0].argmax())  # red, green, blue
    1
    """
    colors = np.array([_MATERIAL_COLORS[one.name] for one in MATERIALS], np.float32)[material]
    vehicle = np.array([one.tilts for one in world.things] + [False, False])[thing]
    painted = vehicle & (material == material_index("paint"))
    colors[painted] = np.array(_CAR_COLORS, np.float32)[thing[painted] * 7 % len(_CAR_COLORS)]
    colors[thing == NOTHING] = _SKY
    return colors


def to_bytes(colors: F32 | NDArray[np.float64]) -> Image:
    """Return colors in [0, 1] as uint8 in steps of two: a smaller file, no visible difference."""
    return np.asarray((colors * 127).round() * 2, np.uint8)


def _clear_m(snapshot: Snapshot, start: NDArray[np.float64], toward: NDArray[np.float64]) -> float:
    """Return how far a beam goes from ``start`` along a unit vector."""
    model = LidarModel("one beam", np.array([np.arcsin(toward[2])]), 4, min_range_m=0.0, max_range_m=300.0)
    yaw = np.arctan2(toward[1], toward[0]) + np.pi - model.azimuth_step / 2
    return float(cast_world(snapshot, model, Rigid.from_yaw(yaw, start)).depth_m[0, 0])


@lru_cache(maxsize=8)
def _rays(lens: Lens) -> tuple[LidarModel, NDArray[np.intp], NDArray[np.intp]]:
    """Return a dense sensor that covers the picture, and the column and ring of each of its samples."""
    down, across = (np.arange(_SAMPLES * size) + 0.5 for size in lens.shape)
    v, u = np.meshgrid(lens.shape[0] / 2 - down / _SAMPLES, lens.shape[1] / 2 - across / _SAMPLES, indexing="ij")
    rays = np.dstack([np.full(u.shape, lens.focal), u, v]) @ _pitch(lens.pitch_deg).T
    azimuth = np.arctan2(rays[..., 1], rays[..., 0])
    elevation = np.arctan2(rays[..., 2], np.hypot(rays[..., 0], rays[..., 1]))
    step = 1 / (lens.focal * _SAMPLES)
    low, high = float(elevation.min()), float(elevation.max())
    rings = int(np.ceil((high - low) / step)) + 1
    elevations, columns = np.linspace(low, high, rings), int(2 * np.pi / step)
    model = LidarModel("camera", elevations, columns, min_range_m=0.0, max_range_m=400.0)
    column = np.floor((azimuth + np.pi) / model.azimuth_step).astype(np.intp)
    ring = np.rint((elevation - low) / (high - low) * (rings - 1)).astype(np.intp)
    return model, column, ring


def _pitch(pitch_deg: float) -> NDArray[np.float64]:
    """Return ``upright_from_camera`` (3, 3) of a camera that looks up by an angle."""
    c, s = np.cos(np.deg2rad(pitch_deg)), np.sin(np.deg2rad(pitch_deg))
    return np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])


def _light(scan: ExactScan) -> F32:
    """Return the brightness (C, R) of what the beams met: normals from neighboring stops on the same thing."""
    hits = scan.direction * np.where(np.isfinite(scan.depth_m), scan.depth_m, 0)[..., None] + scan.origin_m
    normal = np.zeros_like(hits)
    normal[1:-1, 1:-1] = np.cross(hits[2:, 1:-1] - hits[:-2, 1:-1], hits[1:-1, 2:] - hits[1:-1, :-2])
    length = np.linalg.norm(normal, axis=-1)
    cosine = -(normal * scan.direction).sum(axis=-1) / np.maximum(length, 1e-12)
    smooth = (np.abs(np.abs(cosine) - scan.cos_incidence) < 0.08) & (length > 0)
    sun = np.sign(cosine) * (normal @ _SUN) / np.maximum(length, 1e-12)
    otherwise = np.where(scan.thing == GROUND, _SUN[2], scan.cos_incidence - 0.4)
    return np.asarray(0.72 + 0.38 * np.where(smooth, sun, otherwise), np.float32)


def _shrunk(colors: F32) -> F32:
    """Return the mean over each square of samples."""
    down, across = (size // _SAMPLES for size in colors.shape[:2])
    return np.asarray(colors.reshape(down, _SAMPLES, across, _SAMPLES, 3).mean(axis=(1, 3)))
