"""The estimators by name: ``ESTIMATORS[name](grid)`` makes one with sound parameters."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from viewshed.estimators.concave_hull import ConcaveHull
from viewshed.estimators.delaunay import Delaunay
from viewshed.estimators.first_blocker import FirstBlocker
from viewshed.estimators.majority_vote import MajorityVote
from viewshed.estimators.ray_trace import ContinuousRayTrace, QuantizedRayTrace, TrimmedRayTrace
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.fov.estimate import FovEstimator
from viewshed.grid import BevGrid
from viewshed.preprocess.azimuth_bins import Crop

EstimatorFactory = Callable[[BevGrid], FovEstimator]

ESTIMATORS: dict[str, EstimatorFactory] = {
    "continuous": ContinuousRayTrace,
    "quantized": QuantizedRayTrace,
    "concave_hull": ConcaveHull,
    "polygon_fit": Delaunay,
    "first_blocker": FirstBlocker,
    "first_blocker_median": partial(FirstBlocker, median_bins=5, name="first_blocker_median"),
    "trimmed": TrimmedRayTrace,
    "shadow_map": ShadowMap,
    "vote": MajorityVote,
}
"""Ours: rays start at the sensor, bins follow the measured azimuth step, no return means UNKNOWN."""


def paper_estimators(max_range_m: float) -> dict[str, EstimatorFactory]:
    """Return the estimators with the settings of arXiv 2503.07375 and its code, for returns up to ``max_range_m``.

    Returns from 3 m below to 3 m above the sensor count, in its level attitude. ``paper_label`` is the published
    label: rays from the centroid of the points. The threshold there is ``PAPER_THRESHOLD``; these estimates are 0 or 1.
    """
    crop = Crop(max_range_m, (-3.0, 3.0))
    label = partial(QuantizedRayTrace, azimuth_bins=100, range_bins=100, max_range_m=max_range_m, about_centroid=True)
    quantized = partial(QuantizedRayTrace, azimuth_bins=128, range_bins=128, max_range_m=min(70.0, max_range_m))
    return {
        "paper_label": partial(label, crop=crop, name="paper_label"),
        "paper_quantized": partial(quantized, crop=crop, name="paper_quantized"),
        "paper_continuous": partial(ContinuousRayTrace, window=0.05, margin_m=0.0, crop=crop, name="paper_continuous"),
        "paper_concave_hull": partial(
            ConcaveHull, concavity=1.0, length_threshold_m=4.0, crop=crop, name="paper_concave_hull"
        ),
        "paper_polygon_fit": partial(Delaunay, crop=crop, name="paper_polygon_fit"),
    }


PAPER_THRESHOLD = 0.7
"""Probability from which the paper calls a cell visible."""

PAPER_ESTIMATORS: dict[str, EstimatorFactory] = paper_estimators(100.0)
"""The paper's, for cars on roads."""

PAPER_INDOOR_ESTIMATORS: dict[str, EstimatorFactory] = paper_estimators(20.0)
"""The paper's, for its indoor robot."""
