"""Ground heights by hand and against the plane of each triangle."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.sim.oracle import ground_depth

from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import World

HILLS = Terrain.of(
    [-30.0, -7.0, -6.97, 4.0, 22.0], [-20.0, 1.0, 1.5, 19.0], lambda x, y: 0.1 * x - 0.02 * y + np.sin(x + 2 * y)
)


def test_a_quad_by_hand() -> None:
    """Cut from (0, 0) to (2, 4): below the cut the corner (2, 0) counts, above it (0, 4)."""
    quad = Terrain(np.array([0.0, 2.0]), np.array([0.0, 4.0]), np.array([[1.0, 9.0], [5.0, 3.0]]))
    assert quad.at([[2.0, 0.0], [0.0, 4.0], [1.0, 2.0]]).tolist() == [5.0, 9.0, 2.0]
    assert quad.at([[1.0, 0.0], [0.0, 2.0]]).tolist() == [3.0, 5.0]


def test_the_edge_holds_beyond_the_lattice() -> None:
    slope = Terrain.plane(10.0, (0.1, 0.2))
    assert slope.at([[99.0, 0.0], [0.0, -50.0]]).tolist() == pytest.approx([1.0, -2.0])


@given(st.floats(-30, 22), st.floats(-20, 19))
def test_heights_lie_on_the_triangles_that_beams_meet(x: float, y: float) -> None:
    down = np.array([[0.0, 0.0, -1.0]])
    above = np.array([[x, y, 100.0]])
    depth = ground_depth(World("hills", HILLS).snapshot(0.0), above, down)
    assert HILLS.at([[x, y]])[0] == pytest.approx(100.0 - depth[0], abs=1e-6)


def test_normals_lean_away_from_the_rise() -> None:
    normals = Terrain.plane(50.0, (0.1, -0.2)).normals_at([[3.0, 4.0]])
    assert normals[0] == pytest.approx(np.array([-0.1, 0.2, 1.0]) / np.sqrt(1.05))


@pytest.mark.parametrize(
    ("x", "heights", "message"),
    [
        ([0.0, 0.0], np.zeros((2, 2)), "x_m must be two or more finite ascending numbers"),
        ([0.0], np.zeros((1, 2)), "x_m must be two or more finite ascending numbers"),
        ([0.0, 1.0], np.full((2, 2), np.nan), "heights_m must be finite"),
        ([0.0, 1.0], np.zeros((3, 2)), "heights_m must be finite"),
    ],
)
def test_a_broken_lattice_is_refused(x: list[float], heights: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Terrain(np.array(x), np.array([0.0, 1.0]), heights)
