"""Frame: what an archive stores of one sample, and the row of columns that it becomes.

An attacked sweep as the range image that it was made from, and what an attacker made: the same rows, bit by bit.

Touched: the record of what an attacker did to a stored sweep.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.datasets.archive import packing
from viewshed.datasets.archive.schema import Layout, Sensors
from viewshed.datasets.sample import Sample
from viewshed.fov.truth import Truth
from viewshed.geometry import Rigid
from viewshed.sim.lidar.stored_sweep import StoredSweep
from viewshed.sim.raycast.scan import Motion
from viewshed.sweep import Sweep


@dataclass(frozen=True, slots=True, eq=False)
class Touched:
    """What an attacker did to the sweep of a frame, as :class:`viewshed.threats.attacks.Tampered` says it.

    Attributes:
        added: (N,) bool, rows of the stored sweep that the attacker made.
        removed: (M,) bool, rows of the clean sweep that are gone.
        wedge: azimuth of its middle and width, radians, sensor frame; None if the attacker works anywhere.
    """

    added: NDArray[np.bool_]
    removed: NDArray[np.bool_]
    wedge: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for name in ("added", "removed"):
            mask = np.array(getattr(self, name), np.bool_).reshape(-1)
            mask.setflags(write=False)
            object.__setattr__(self, name, mask)

    def about(self) -> dict[str, Any]:
        """Return what is no mask, as plain values."""
        wedge = None if self.wedge is None else [float(value) for value in self.wedge]
        return {"added": len(self.added), "removed": len(self.removed), "wedge": wedge}

    def packed(self) -> bytes:
        """Return both masks, eight rows in each byte."""
        return packing.pack_masks(np.concatenate([self.added, self.removed])[None])

    @classmethod
    def unpacked(cls, about: dict[str, Any], raw: packing.Buffer) -> Touched:
        """Return the record of :meth:`about` and :meth:`packed`.

        Raises:
            ValueError: they do not fit each other.
        """
        rows, wedge = int(about["added"]), about["wedge"]
        masks = packing.unpack_masks(raw, (1, 1, rows + int(about["removed"])))[0, 0]
        return cls(masks[:rows], masks[rows:], None if wedge is None else (float(wedge[0]), float(wedge[1])))


COLUMNS = ("points", "intensity", "ring", "azimuth", "time_s")
"""The columns of a sweep, points first."""

MOST_MADE = 0.5
"""Where a larger share of the rows is the attacker's, points alone are shorter."""


def made_rows(attacked: Sweep, clean: Sweep, touched: Touched) -> Sweep | None:
    """Return the rows that an attacker made, where all others are those of the clean sweep, bit by bit; else None.

    Args:
        attacked: the sweep after the attack.
        clean: the sweep before.
        touched: which rows of the attacked sweep were made, and which of the clean one are gone.
    """
    made = np.count_nonzero(touched.added)
    if made > MOST_MADE * len(attacked) or len(touched.removed) != len(clean) or len(touched.added) != len(attacked):
        return None
    for name in COLUMNS:
        one, other = getattr(attacked, name), getattr(clean, name)
        if (one is None) != (other is None):
            return None
        if one is not None and one[~touched.added].tobytes() != other[~touched.removed].tobytes():
            return None
    return attacked.select(touched.added)


def with_rows(clean: Sweep, made: Sweep, touched: Touched) -> Sweep:
    """Return the attacked sweep of :func:`made_rows`; all but its rows is that of ``made``.

    Raises:
        ValueError: the three do not fit each other.
    """
    added, kept, left = (np.flatnonzero(mask) for mask in (touched.added, ~touched.added, ~touched.removed))
    if len(touched.removed) != len(clean) or len(left) != len(kept) or len(made) != len(added):
        told = f"{len(left)} of {len(touched.removed)} and {len(added)} in {len(touched.added)}"
        raise ValueError(f"touched must leave rows of {len(clean)} and add {len(made)}, got {told}")
    columns = {}
    for name in COLUMNS:
        one, other = getattr(clean, name), getattr(made, name)
        if (one is None) != (other is None):
            raise ValueError(f"what an attacker made must have {name} where the sweep has it")
        if one is not None:
            rows = columns[name] = np.empty((len(touched.added), *one.shape[1:]), one.dtype)
            rows[kept], rows[added] = one[left], other
    return made.replace(**columns)


BLOBS = ("ranges", "intensity", "points", "returns", "states", "masks")
"""The binary columns; ``about`` comes before them."""

TOUCHED = "touched"
"""One more binary column, last, in archives of attacked sweeps; a reader that does not know it may pass over it."""

Row = tuple[str, packing.Buffer | None, packing.Buffer | None, packing.Buffer | None,
            packing.Buffer, packing.Buffer, packing.Buffer, packing.Buffer | None]  # fmt: skip
"""``about``, the columns of :data:`BLOBS`, and :data:`TOUCHED`."""

_COLUMNS: dict[str, type[np.generic]] = {
    "intensity": np.float32, "ring": np.int16, "azimuth": np.float32, "time_s": np.float32,
}  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """What is stored of one sample.

    Attributes:
        measured: the range image, or the sweep where there is no range image.
        truth: see :class:`Sample`.
        known: see :class:`Sample`.
        touched: what an attacker did to the sweep, or None where nobody says.
        clean: the range image that an attacked sweep was made from, or None. It is stored with what the attacker made,
            which takes less room than all points.

    Raises:
        ValueError: ``touched`` does not fit the sweep.
    """

    measured: StoredSweep | Sweep
    truth: Truth
    known: NDArray[np.bool_]
    touched: Touched | None = None
    clean: StoredSweep | None = None

    def __post_init__(self) -> None:
        if self.touched is None:
            return
        image = self.measured
        rows = len(image) if isinstance(image, Sweep) else int(np.count_nonzero(image.steps))
        if len(self.touched.added) != rows:
            raise ValueError(f"touched must be of {rows} rows, got {len(self.touched.added)}")

    @classmethod
    def of(cls, sample: Sample) -> Frame:
        """Return what is to be stored: the range image where the sweep is still the one that was made from it."""
        image = sample.image
        whole = image is not None and same_sweep(sample.sweep, image.sweep())
        return cls(image if image is not None and whole else sample.sweep, sample.truth, sample.known)

    def attacked(self, sweep: Sweep, touched: Touched | None) -> Frame:
        """Return the frame with another sweep, made from its own, and a record of what was touched; truth stays."""
        clean = None if isinstance(self.measured, Sweep) else self.measured
        return replace(self, measured=sweep, touched=touched, clean=clean)

    @property
    def sweep(self) -> Sweep:
        """The sweep, made from the range image where there is one."""
        return self.measured if isinstance(self.measured, Sweep) else self.measured.sweep()

    def sample(self, scene: str, split: str) -> Sample:
        """Return the sample."""
        image = None if isinstance(self.measured, Sweep) else self.measured
        return Sample(self.sweep, self.truth, self.known, scene, split, image)

    def row(self, layout: Layout, sensors: Sensors) -> Row:
        """Return the frame as columns.

        Raises:
            ValueError: its truth does not have this layout.
        """
        if Layout.of(self.truth) != layout:
            raise ValueError(f"truth must have the layout of the archive, {layout}, got {Layout.of(self.truth)}")
        about, packed = self._packed(sensors)
        returns = b"".join(self.truth.expected_returns[name].tobytes() for name in layout.targets)
        states = packing.pack_states(np.array([self.truth.state[name] for name in layout.targets], np.uint8))
        masks = np.stack([*(self.truth.definitions[name] for name in layout.definitions), self.known])
        touched = None if self.touched is None else self.touched.packed()
        if self.touched is not None:
            about |= {TOUCHED: self.touched.about()}
        return json.dumps(about, ensure_ascii=False), *packed, returns, states, packing.pack_masks(masks), touched

    def _packed(self, sensors: Sensors) -> tuple[dict[str, Any], tuple[bytes | None, bytes | None, bytes | None]]:
        """Return what is said about the sweep, and the columns ranges, intensity and points."""
        image = self.measured
        if not isinstance(image, Sweep):
            return _about(image, sensors), (*_pack_image(image), None)
        clean, touched = self.clean, self.touched
        made = None if clean is None or touched is None else made_rows(image, clean.sweep(), touched)
        if clean is None or made is None:
            return _about(image, sensors), (None, None, _pack_points(image))
        about = _about(made, sensors) | {"clean": _about(clean, sensors)}
        return about, (*_pack_image(clean), _pack_points(made))

    @classmethod
    def from_row(cls, row: Row, layout: Layout, sensors: Sensors) -> Frame:
        """Return the frame of :meth:`row`.

        Raises:
            ValueError: the columns do not fit the layout or each other.
        """
        about, ranges, intensity, points, returns, states, masks, raw = row
        try:
            said = json.loads(about)
            measured = _image(said, ranges, intensity, sensors) if points is None else _sweep(said, points, sensors)
            touched = None if raw is None else Touched.unpacked(said[TOUCHED], raw)
            clean = _image(said["clean"], ranges, intensity, sensors) if "clean" in said else None
        except (KeyError, TypeError, IndexError, AttributeError) as error:
            raise ValueError(f"about must describe the frame: {error!r}") from error
        if clean is not None and touched is not None and isinstance(measured, Sweep):
            measured = with_rows(clean.sweep(), measured, touched)
        return cls(measured, *_truth(layout, returns, states, masks), touched, clean)


def same_sweep(one: Sweep, other: Sweep) -> bool:
    """Return whether two sweeps are equal in every attribute, bit by bit; one object as beam table is asked for."""
    arrays = ("points", *_COLUMNS, "attitude")
    plain = ("t_ns", "sensor_height_m", "model", "agent", "dropped_points")
    return (
        all(getattr(one, name) == getattr(other, name) for name in plain)
        and all(_same(getattr(one, name), getattr(other, name)) for name in arrays)
        and _same(_numbers(one.world_from_sensor), _numbers(other.world_from_sensor))
    )


def _same(one: NDArray[Any] | None, other: NDArray[Any] | None) -> bool:
    if one is None or other is None:
        return one is other
    return one.shape == other.shape and (one is other or bool((one == other).all()))


def _numbers(pose: Rigid | None) -> NDArray[np.float64] | None:
    return None if pose is None else np.concatenate([pose.rotation.ravel(), pose.translation])


def _about(measured: StoredSweep | Sweep, sensors: Sensors) -> dict[str, Any]:
    """Return what is neither array nor truth, as plain values; Python's floats survive JSON exactly."""
    pose = _numbers(measured.world_from_sensor)
    about: dict[str, Any] = {
        "agent": measured.agent,
        "t_ns": None if measured.t_ns is None else int(measured.t_ns),
        "sensor": sensors.number(measured.model),
        "sensor_height_m": None if measured.sensor_height_m is None else float(measured.sensor_height_m),
        "world_from_sensor": None if pose is None else pose.tolist(),
    }
    if isinstance(measured, StoredSweep):
        motion = measured.motion
        numbers = [*motion.velocity_mps, motion.yaw_rate, motion.period_s]
        return about | {"step_m": float(measured.step_m), "motion": [float(value) for value in numbers]}
    return about | {
        "points": len(measured),
        "columns": [name for name in _COLUMNS if getattr(measured, name) is not None],
        "attitude": None if measured.attitude is None else measured.attitude.tolist(),
        "dropped_points": int(measured.dropped_points),
    }


def _pack_image(image: StoredSweep) -> tuple[bytes, bytes]:
    return packing.pack_ranges(image.steps), image.intensity.tobytes()


def _pack_points(sweep: Sweep) -> bytes:
    columns = [getattr(sweep, name) for name in _COLUMNS]
    return b"".join(packing.pack_column(column) for column in (sweep.points, *columns) if column is not None)


def _image(
    about: dict[str, Any], ranges: packing.Buffer | None, intensity: packing.Buffer | None, sensors: Sensors
) -> StoredSweep:
    model = sensors.model(about["sensor"])
    if model is None or ranges is None or intensity is None:
        raise ValueError("a frame without points must have a sensor, ranges and intensity")
    shape = (model.azimuth_columns, model.rings)
    vx, vy, vz, yaw_rate, period_s = about["motion"]
    pose = _pose(about["world_from_sensor"])
    if pose is None:
        raise ValueError("a range image must have a pose")
    return StoredSweep(
        model=model,
        steps=packing.unpack_ranges(ranges, shape),
        intensity=packing.bytes_of(intensity, shape),
        step_m=about["step_m"],
        world_from_sensor=pose,
        motion=Motion((vx, vy, vz), yaw_rate, period_s),
        sensor_height_m=about["sensor_height_m"],
        t_ns=about["t_ns"],
        agent=about["agent"],
    )


def _sweep(about: dict[str, Any], raw: packing.Buffer, sensors: Sensors) -> Sweep:
    count, view = int(about["points"]), memoryview(raw)
    points = packing.unpack_column(view[: 12 * count], np.float32, (count, 3))
    start, columns = 12 * count, {}
    for name in about["columns"]:
        end = start + count * np.dtype(_COLUMNS[name]).itemsize
        columns[name] = packing.unpack_column(view[start:end], _COLUMNS[name], (count,))
        start = end
    return Sweep(
        points=points,
        **columns,
        t_ns=about["t_ns"],
        attitude=None if about["attitude"] is None else np.array(about["attitude"]),
        sensor_height_m=about["sensor_height_m"],
        world_from_sensor=_pose(about["world_from_sensor"]),
        model=sensors.model(about["sensor"]),
        agent=about["agent"],
        dropped_points=int(about["dropped_points"]),
    )


def _pose(numbers: list[float] | None) -> Rigid | None:
    if numbers is None:
        return None
    return Rigid(np.array(numbers[:9]).reshape(3, 3), np.array(numbers[9:]))


def _truth(
    layout: Layout, returns: packing.Buffer, states: packing.Buffer, masks: packing.Buffer
) -> tuple[Truth, NDArray[np.bool_]]:
    shape = layout.grid.shape
    targets, definitions = len(layout.targets), len(layout.definitions)
    counts = packing.bytes_of(returns, (targets, *shape))
    state = packing.unpack_states(states, (targets, *shape))
    bits = packing.unpack_masks(masks, (definitions + 1, *shape))
    truth = Truth(
        layout.grid,
        dict(zip(layout.targets, counts, strict=True)),
        dict(zip(layout.targets, state, strict=True)),
        dict(zip(layout.definitions, bits[:-1], strict=True)),
    )
    return truth, bits[-1]
