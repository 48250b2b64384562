"""PointCloud2: messages packed number by number with struct, read back exactly."""

import struct
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from viewshed.io.messages.pointcloud2 import sweep_of_cloud
from viewshed.sensors import lidar_model

CODES = {1: "b", 2: "B", 3: "h", 4: "H", 5: "i", 6: "I", 7: "f", 8: "d"}
F4, F8, U2, U4 = 7, 8, 4, 6
XYZ = [("x", 0, F4), ("y", 4, F4), ("z", 8, F4)]


def cloud(
    fields: list[tuple[str, int, int]], rows: list[list[tuple[Any, ...]]], step: int, *, big: bool = False, pad: int = 0
) -> Any:
    """A message whose bytes between fields and after rows are 0xEE; ``rows`` hold one tuple a point."""
    content = bytearray()
    for row in rows:
        for point in row:
            block = bytearray(b"\xee" * step)
            for (_, offset, kind), value in zip(fields, point, strict=True):
                struct.pack_into((">" if big else "<") + CODES[kind], block, offset, value)
            content += block
        content += b"\xee" * pad
    width = len(rows[0]) if rows else 0
    return SimpleNamespace(
        height=len(rows), width=width, fields=[field(*entry) for entry in fields], is_bigendian=big, point_step=step,
        row_step=step * width + pad, data=np.frombuffer(bytes(content), np.uint8),
    )  # fmt: skip


def field(name: str, offset: int, datatype: int, count: int = 1) -> SimpleNamespace:
    return SimpleNamespace(name=name, offset=offset, datatype=datatype, count=count)


def changed(made: Any, **changes: Any) -> Any:
    return SimpleNamespace(**(vars(made) | changes))


@pytest.mark.parametrize(
    ("name", "count", "intensity"), [("intensity", 1, [4.0, 8.0]), ("intensity", 2, None), ("z", 0, [4.0, 8.0])]
)
def test_a_field_of_several_numbers_a_point_is_no_column(name: str, count: int, intensity: list[float] | None) -> None:
    """A histogram that a driver calls "intensity" has no one number; some drivers count one number as 0."""
    made = cloud([*XYZ, ("intensity", 12, F4)], [[(1.0, 2.0, 3.0, 4.0), (5.0, 6.0, 7.0, 8.0)]], 20)
    fields = [changed(each, count=count) if each.name == name else each for each in made.fields]
    found = sweep_of_cloud(changed(made, fields=fields)).intensity
    assert (None if found is None else found.tolist()) == intensity


@pytest.mark.parametrize("big", [False, True], ids=["little", "big"])
def test_the_velodyne_driver_layout(big: bool) -> None:
    fields = [*XYZ, ("intensity", 16, F4), ("ring", 20, U2), ("time", 22, F4)]
    points = [(5.0, 3.0, -1.5, 17.0, 0, -0.09), (8.0, -2.5, 0.25, 99.0, 2, 0.0), (-6.0, 1.0, -0.5, 3.0, 1, -0.04)]
    sweep = sweep_of_cloud(cloud(fields, [points], 32, big=big))
    np.testing.assert_array_equal(sweep.points, [point[:3] for point in points])
    assert (sweep.intensity.tolist(), sweep.ring.tolist()) == ([17.0, 99.0, 3.0], [0, 2, 1])
    np.testing.assert_allclose(sweep.time_s, [0.0, 0.09, 0.05], atol=1e-7)


def test_the_ouster_driver_layout_counts_rings_from_the_highest_beam() -> None:
    fields = [*XYZ, ("intensity", 16, F4), ("t", 20, U4), ("reflectivity", 24, U2), ("ring", 26, U2)]
    # Beam 2 has no return, and keeps its place.
    row = [[(6.0, 0.5, 1.5 - ring, 4.0, 25_000_000 * col, 7, ring) for col in range(3)] for ring in (0, 1, 3)]
    sweep = sweep_of_cloud(cloud(fields, row, 48, pad=16))
    assert sweep.ring.tolist() == [3, 3, 3, 2, 2, 2, 0, 0, 0]
    np.testing.assert_allclose(sweep.time_s, [0, 0.025, 0.05] * 3, atol=1e-8)
    np.testing.assert_array_equal(sweep.points[::3, 2], [1.5, 0.5, -1.5])


def test_the_hesai_driver_layout_with_absolute_seconds() -> None:
    fields = [*XYZ, ("intensity", 12, F4), ("timestamp", 16, F8), ("ring", 24, U2)]
    points = [(5.0, 3.0, -1.5, 17.0, 1_700_000_000.25, 0), (7.0, 2.0, 0.5, 18.0, 1_700_000_000.3, 1)]
    sweep = sweep_of_cloud(cloud(fields, [points], 26))
    np.testing.assert_allclose(sweep.time_s, [0.0, 0.05], atol=1e-6)


def test_doubles_bytes_and_fields_in_any_order() -> None:
    fields = [("ring", 0, 2), ("z", 1, F8), ("intensity", 9, 2), ("x", 10, F8), ("y", 18, F8)]
    sweep = sweep_of_cloud(cloud(fields, [[(4, -1.0, 250, 5.0, 3.0), (9, 1.0, 0, 4.0, -2.0)]], 26))
    np.testing.assert_array_equal(sweep.points, [[5.0, 3.0, -1.0], [4.0, -2.0, 1.0]])
    assert (sweep.intensity.tolist(), sweep.ring.tolist()) == ([250.0, 0.0], [4, 9])


def test_points_that_are_not_finite_go_with_their_columns() -> None:
    fields = [*XYZ, ("ring", 12, U2), ("t", 16, U4)]
    nan, far = float("nan"), float("inf")
    rows = [
        [(5.0, 3.0, -1.5, 0, 10_000_000), (nan, nan, nan, 0, 0)],
        [(1.0, far, 1.0, 1, 0), (9.0, 2.0, 1.5, 1, 30_000_000)],
    ]
    sweep = sweep_of_cloud(cloud(fields, rows, 20))
    np.testing.assert_array_equal(sweep.points, [[5.0, 3.0, -1.5], [9.0, 2.0, 1.5]])
    assert sweep.dropped_points == 2
    assert sweep.ring.tolist() == [0, 1]
    np.testing.assert_allclose(sweep.time_s, [0.0, 0.02], atol=1e-8)


def test_rings_in_the_order_of_firing_are_sorted_by_elevation() -> None:
    firing = [-15, 1, -13, 3]  # degrees, as a VLP-16 fires
    fields = [*XYZ, ("ring", 12, U2)]
    points = [
        (10 * np.cos(turn), 10 * np.sin(turn), 10 * np.tan(np.deg2rad(firing[k])), k)
        for turn in np.linspace(0, 5, 40) for k in range(4)
    ]  # fmt: skip
    sweep = sweep_of_cloud(cloud(fields, [points], 16))
    assert sweep.ring[:4].tolist() == [0, 2, 1, 3]


def test_rings_numbered_from_the_top_stay_right_where_the_lowest_beam_has_no_return() -> None:
    model = lidar_model("VLP-16")
    points = [
        (10 * np.cos(turn), 10 * np.sin(turn), 10 * np.tan(model.elevation[15 - k]), k)
        for turn in np.linspace(0, 5, 40) for k in range(15)
    ]  # fmt: skip
    message = cloud([*XYZ, ("ring", 12, U2)], [points], 16)
    assert sweep_of_cloud(message, model).ring[:15].tolist() == list(range(15, 0, -1))
    assert sweep_of_cloud(message).ring[:15].tolist() == list(range(14, -1, -1))  # nothing states a sixteenth beam


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"fields": [field("x", 0, F4), field("z", 8, F4)]}, "y not found among"),
        (
            {"fields": [field("x", 0, F4, 2), field("y", 4, F4), field("z", 8, F4)]},
            "must have .* x, y and z, x not found",
        ),
        ({"width": 3, "row_step": 48}, "cut off: 1 rows of 3 points"),
        ({"fields": [field("x", 0, F4), field("y", 4, F4), field("z", 14, F4)]}, "field 'z' at byte 14 leaves"),
        ({"point_step": 0}, "1 to 1048576 bytes"),
        ({"height": 2, "width": 1, "row_step": 4}, "cut off"),
        ({"height": 100_000, "width": 100_000}, "at most 20000000 points"),
        ({"height": 0, "width": 0, "data": np.zeros(0, np.uint8)}, ""),
        ({"height": 0xFFFFFFFF, "width": 0, "row_step": 0}, ""),
    ],
)
def test_sizes_are_checked(changes: dict[str, Any], words: str) -> None:
    made = changed(cloud(XYZ, [[(5, 3, 1), (4, 2, 1)]], 16), **changes)
    if not words:
        assert len(sweep_of_cloud(made)) == 0
        return
    with pytest.raises(ValueError, match=words):
        sweep_of_cloud(made)
