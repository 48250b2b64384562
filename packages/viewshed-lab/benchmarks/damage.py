"""Clouds as a driver sends them, and damaged ones; uses numpy alone, for the soak tests."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from viewshed.io.messages.pointcloud2 import PointField
from viewshed.sweep import Sweep

FLOAT32, UINT16 = 7, 4
"""Values of ``PointField.datatype``."""


@dataclass(slots=True)
class Field:
    """The parts of sensor_msgs/PointField."""

    name: str
    offset: int
    datatype: int = FLOAT32
    count: int = 1


@dataclass(slots=True, eq=False)
class Cloud:
    """The fields of sensor_msgs/PointCloud2 that are read."""

    fields: Iterable[PointField]
    width: int
    point_step: int
    row_step: int
    data: NDArray[np.uint8]
    height: int = 1
    is_bigendian: bool = False


def cloud_of(sweep: Sweep) -> Cloud:
    """Return a sweep's points, intensity and ring (if known) as a cloud."""
    names = ["x", "y", "z", "intensity"]
    kinds = [(name, "<f4") for name in names] + ([("ring", "<u2")] if sweep.ring is not None else [])
    table = np.zeros(len(sweep), kinds)
    for axis, name in enumerate("xyz"):
        table[name] = sweep.points[:, axis]
    if sweep.intensity is not None:
        table["intensity"] = sweep.intensity
    fields: list[PointField] = [Field(name, 4 * number) for number, name in enumerate(names)]
    if sweep.ring is not None:
        table["ring"] = sweep.ring
        fields.append(Field("ring", 16, UINT16))
    return Cloud(fields, len(table), table.itemsize, table.nbytes, table.view(np.uint8).reshape(-1))


@dataclass(frozen=True, slots=True)
class Damage:
    """One kind of damage to a cloud."""

    change: Callable[[Cloud], Cloud]  # returns the damaged cloud
    says: str  # part of the error message, or "" if the cloud is consistent and may be accepted
    why: str  # description


def _without(cloud: Cloud, name: str) -> Cloud:
    return replace(cloud, fields=[field for field in cloud.fields if field.name != name])


def _all_nan(cloud: Cloud) -> Cloud:
    rows = cloud.data.copy().reshape(cloud.width, cloud.point_step)
    rows[:, :12] = np.full(3, np.nan, "<f4").view(np.uint8)
    return replace(cloud, data=rows.reshape(-1))


def _swapped(cloud: Cloud) -> Cloud:
    """Return a cloud that is falsely marked as big-endian, so that its numbers are noise."""
    return replace(cloud, is_bigendian=True)


def _moved(cloud: Cloud) -> Cloud:
    first, *others = cloud.fields
    return replace(cloud, fields=[Field(first.name, cloud.point_step - 2, first.datatype), *others])


DAMAGES = {
    "no field x": Damage(lambda cloud: _without(cloud, "x"), "must have fields x, y and z", "a field is missing"),
    "point_step too small": Damage(
        lambda cloud: replace(cloud, point_step=11), "leaves a point of 11 bytes", "its layout contradicts itself"
    ),
    "x beyond its point": Damage(_moved, "leaves a point of", "its layout contradicts itself"),
    "cut off": Damage(
        lambda cloud: replace(cloud, data=cloud.data[: cloud.data.size // 2]), "a cloud is cut off",
        "there is less than its sizes name",
    ),
    "ten million points": Damage(
        lambda cloud: replace(cloud, width=10**7, row_step=10**7 * cloud.point_step), "a cloud",
        "there is less than its sizes name",
    ),
    "no points": Damage(
        lambda cloud: replace(cloud, width=0, row_step=0, data=cloud.data[:0]), "",
        "a sensor that sees nothing: nothing is claimed, and the monitor alarms",
    ),
    "all NaN": Damage(_all_nan, "", "points that are no numbers are left out: none is left, and the monitor alarms"),
    "bytes the other way round": Damage(_swapped, "", "its numbers are noise, and no layout tells"),
}  # fmt: skip
"""By name."""
