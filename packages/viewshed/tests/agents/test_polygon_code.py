"""The code of a polygon keeps it inner and small, and refuses bytes that are no polygon."""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from shapely import MultiPolygon, Polygon

from viewshed import BevGrid
from viewshed.agents.polygon_code import MAX_BYTES, decode_polygon, encode_inner_polygon, encode_polygon
from viewshed.fov.polygons import claims_only, polygon_of_mask

RING = Polygon([(0, 0), (4, 0), (4, 4), (0, 4)], [[(1, 1), (1, 2), (2, 2), (2, 1)]])
ISLAND = Polygon([(-3, -2), (-1, -2.5), (-2, -1)])


def test_polygons_with_holes_come_back() -> None:
    shape = MultiPolygon([RING, ISLAND])
    code = encode_polygon(shape, 0.5)
    assert decode_polygon(code).equals(shape)
    # Step 500 mm, two polygons, of two rings and one, of 4, 4 and 3 corners, and 11 corners of two numbers.
    assert list(code[:7]) == [0x80 | 500 % 128, 500 // 128, 2, 2, 1, 4, 4]
    assert len(code) == 8 + 22


def test_corners_are_rounded_to_steps() -> None:
    found = decode_polygon(encode_polygon(MultiPolygon([ISLAND]), 0.3))
    assert shapely.hausdorff_distance(found, MultiPolygon([ISLAND])) <= 0.15 * np.sqrt(2) + 1e-9


def test_no_polygon_is_a_polygon_of_nothing() -> None:
    assert decode_polygon(encode_polygon(MultiPolygon(), 0.1)).is_empty


@given(hnp.arrays(np.bool_, st.integers(1, 10).map(lambda n: (n, n))), st.sampled_from([64, 100, MAX_BYTES]))
def test_an_inner_polygon_claims_no_other_cell_when_decoded(mask: np.ndarray, max_bytes: int) -> None:
    grid = BevGrid(len(mask), 0.37 * len(mask), (0.4, -1.3))
    code = encode_inner_polygon(mask, grid, max_bytes)
    found = decode_polygon(code)
    assert len(code) <= max_bytes
    assert shapely.difference(found, polygon_of_mask(mask, grid)).area == 0.0
    assert claims_only(found, mask, grid)


def test_an_inner_polygon_of_a_street_keeps_most_of_it_in_few_bytes() -> None:
    rng, grid = np.random.default_rng(0), BevGrid(128, 32.0)
    distance = np.hypot(*np.moveaxis(grid.centers, -1, 0))
    angle = np.arctan2(grid.centers[..., 1], grid.centers[..., 0])
    mask = (distance < 25 + 3 * np.sin(3 * angle)) & (distance > 3)
    for at, near in zip(rng.uniform(-3, 3, 20), rng.uniform(6, 20, 20), strict=True):
        mask &= (np.abs(angle - at) > 1 / near) | (distance < near)
    code = encode_inner_polygon(mask, grid)
    found = decode_polygon(code)
    assert len(code) <= MAX_BYTES
    assert polygon_of_mask(mask, grid).covers(found)
    assert found.area > 0.8 * mask.sum() * grid.cell_area_m2


@given(st.binary(max_size=60))
def test_rubbish_is_refused_or_a_valid_polygon(code: bytes) -> None:
    try:
        found = decode_polygon(code)
    except ValueError:
        return
    assert found.is_valid


def number(value: int) -> bytes:
    digits = [value % 128]
    while value := value // 128:
        digits.append(value % 128)
    return bytes([*(digit | 128 for digit in digits[:-1]), digits[-1]])


def numbers(*values: int) -> bytes:
    return b"".join(map(number, values))


BAD = [
    (b"", "end with a whole number"),
    (b"\x81", "end with a whole number"),
    (b"\xff\xff\xff\xff\xff\x01", "at most 5 bytes"),
    (numbers(1), "begin with a step and at most 64 polygons"),
    (numbers(0, 1), "begin with a step"),
    (numbers(1, 65), "at most 64 polygons"),
    (numbers(1, 2, 1), "one ring at least"),
    (numbers(1, 1, 257), "all together at most 256"),
    (numbers(1, 1, 0), "one ring at least"),
    (numbers(1, 1, 1, 2, 0, 0, 2, 2), "three corners at least"),
    (numbers(1, 1, 1, 3, 0, 0, 2, 2), "as many as follow"),
    (numbers(1, 1, 1, 2**34), "as many as follow"),
    (numbers(1, 1, 1, 3, 0, 0, 2, 2, 2, 2), "must be valid"),
    (numbers(1000, 1, 1, 3, 0, 0, 2**34, 0, 0, 2**34), "within 10 km"),
]


@pytest.mark.parametrize(("code", "message"), BAD)
def test_what_is_no_polygon_is_refused(code: bytes, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        decode_polygon(code)


def test_each_shorter_code_is_refused() -> None:
    code = encode_polygon(MultiPolygon([RING, ISLAND]), 0.1)
    for end in range(len(code)):
        with pytest.raises(ValueError, match=r"polygon|code"):
            decode_polygon(code[:end])


def test_less_than_64_bytes_hold_no_polygon() -> None:
    with pytest.raises(ValueError, match="max_bytes must be at least 64, got 10"):
        encode_inner_polygon(np.ones((4, 4), bool), BevGrid(4, 2.0), 10)
