import numpy as np

from viewshed import CAR, BevGrid, FovEstimator
from viewshed.estimators.first_blocker import FirstBlocker
from viewshed.estimators.majority_vote import MajorityVote
from viewshed.estimators.shadow_map import NoReturn, ShadowMap
from viewshed.sensors import LidarModel
from viewshed_lab.sim import Box, Scene, cast

GRID = BevGrid(128, 32.0)
MODEL = LidarModel("test", np.deg2rad(np.linspace(-25, 8, 32)), azimuth_columns=720)
SWEEP = cast(MODEL, Scene((Box(9, 2, 0.5, 6, 2), Box(7, -5, 4, 2, 0.8), Box(-12, 4, 1, 30, 5))), 1.8)


def test_three_of_five_decide() -> None:
    rules: tuple[NoReturn, ...] = ("unknown", "max_range", "fill")
    voters: list[FovEstimator] = [ShadowMap(GRID, CAR, rule) for rule in rules]
    blockers: list[FovEstimator] = [FirstBlocker(GRID, CAR, limit_farthest=limit) for limit in (True, False)]
    votes = sum(v.estimate(SWEEP).visible().astype(int) for v in (*voters, *blockers))
    estimate = MajorityVote(GRID).estimate(SWEEP)
    assert (estimate.visible() == (votes >= 3)).all()
    assert np.allclose(estimate.visible_prob * 5, votes)
    assert 0 < estimate.visible().mean() < 1
