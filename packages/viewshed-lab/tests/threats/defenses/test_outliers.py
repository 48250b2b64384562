"""Outlier removal: by hand, by laws, and against scipy's k-d tree and graphs."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from viewshed.arrays import F32
from viewshed.sweep import Sweep
from viewshed_lab.threats.defenses import ClusteringOutlierRemoval, RadiusOutlierRemoval, StatisticalOutlierRemoval


@st.composite
def clouds(draw: st.DrawFn) -> F32:
    """Clumps, a line and scattered points, some of them twice."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    count = draw(st.integers(3, 300))
    middles = rng.uniform(-30, 30, (draw(st.integers(1, 8)), 3))
    points = middles[rng.integers(len(middles), size=count)] + rng.normal(0, draw(st.floats(0.01, 3)), (count, 3))
    points[: count // 5] = points[0]
    points[count // 5 : count // 3, 1:] = 0
    return points.astype(np.float32)


def _dropped(defense: object, points: F32) -> NDArray[np.bool_]:
    mask: NDArray[np.bool_] = defense.apply(Sweep(points)).dropped  # type: ignore[attr-defined]
    return mask


@given(clouds())
def test_statistical_removal_is_pcls_rule(points: F32) -> None:
    k = min(10, len(points) - 1)
    wide = points.astype(np.float64)
    means = cKDTree(wide).query(wide, k=k + 1)[0].sum(axis=1) / k
    limit = means.mean() + 1.5 * np.sqrt(((means - means.mean()) ** 2).sum() / (len(points) - 1))
    clear = np.abs(means - limit) > 1e-4 * limit + 1e-5  # neither side is right where it hangs on rounding
    found = _dropped(StatisticalOutlierRemoval(10, 1.5), points)
    assert np.array_equal(found[clear], (means > limit)[clear])


def test_statistical_removal_by_hand() -> None:
    # Neighbors in a line 1 m apart: mean distance 1 to both sides; the ends have 1 and 2, mean 1.5; the far one 7.5.
    line = np.array([[x, 2.0, 0.5] for x in (0, 1, 2, 3, 4, 5, 12)], np.float32)
    # Means: 1.5, 1, 1, 1, 1, 1.5, 7.5: average 2.07, σ 2.40, so that one σ above lies at 4.47.
    assert _dropped(StatisticalOutlierRemoval(2, 1.0), line).tolist() == [False] * 6 + [True]
    assert not _dropped(StatisticalOutlierRemoval(2, 3.0), line).any()


@given(clouds(), st.floats(0.05, 5), st.integers(1, 8))
def test_radius_removal_counts_as_scipy_does(points: F32, radius_m: float, neighbors: int) -> None:
    wide = points.astype(np.float64)
    tree = cKDTree(wide)
    low, high = (tree.query_ball_point(wide, radius_m * f, return_length=True) - 1 for f in (1 - 1e-9, 1 + 1e-9))
    found = _dropped(RadiusOutlierRemoval(radius_m, neighbors), points)
    assert np.array_equal(found[low == high], (low < neighbors)[low == high])


@settings(max_examples=50)
@given(clouds(), st.floats(0.05, 3), st.integers(2, 9))
def test_clustering_drops_the_noise_of_dbscan(points: F32, radius_m: float, fewest: int) -> None:
    """Noise as the definition has it: clusters are components of cores, and noise belongs to none."""
    wide = points.astype(np.float64)
    apart = np.linalg.norm(wide[:, None] - wide, axis=2)
    if (np.abs(apart - radius_m) < 1e-6).any():
        return
    near = apart <= radius_m
    core = near.sum(axis=1) >= fewest
    _, label = connected_components(csr_matrix(near & core[:, None] & core))
    in_cluster = np.zeros(len(points), np.bool_)
    for cluster in np.unique(label[core]):
        in_cluster |= near[core & (label == cluster)].any(axis=0)
    assert np.array_equal(_dropped(ClusteringOutlierRemoval(radius_m, fewest), points), ~in_cluster)
