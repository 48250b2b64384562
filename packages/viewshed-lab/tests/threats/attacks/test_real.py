"""Real sweeps, with rings and without: what is not touched stays, and no beam gets a second return."""

from pathlib import Path

import numpy as np
import pytest
from tests.threats.attacks.drawn import MOVE_RETURNS

from viewshed import Sweep
from viewshed.io import read_index, read_indexed
from viewshed.preprocess.ring_recovery import recover_rings
from viewshed_lab.threats.attacks import ATTACKS, FREE_FORM, INFORMED, Knowledge

pytestmark = pytest.mark.slow

ALL = ATTACKS | INFORMED
FILES = ("nuscenes", "kitti/odometry00", "ouster/decoded/OS-1-128", "outdoor_vlp16_apollo")


@pytest.fixture(scope="module", params=FILES)
def sweep(request: pytest.FixtureRequest, real_data: Path) -> Sweep:
    """One real sweep."""
    entries = read_index(real_data / "index.json")
    entry = next(entry for entry in entries if str(entry.file).startswith(str(real_data / request.param)))
    return read_indexed(entry)


@pytest.mark.parametrize("name", sorted(set(ALL) - {"pose_spoof"}))
def test_untouched_returns_stay_and_beams_stay_single(name: str, sweep: Sweep) -> None:
    attack, rng = ALL[name](None, Knowledge((sweep,))), np.random.default_rng(2)
    if recover_rings(sweep).source == "elevation bins" and name not in FREE_FORM | MOVE_RETURNS:
        with pytest.raises(ValueError, match="beams of this sweep must be known"):
            attack.apply(sweep, rng)
        return
    tampered = attack.apply(sweep, rng)
    assert tampered.sweep.points[~tampered.added].tobytes() == sweep.points[~tampered.removed].tobytes()
    assert tampered.added.any() or tampered.removed.any()
    if name in FREE_FORM or tampered.wedge is None:
        return
    for points in (tampered.sweep.points[tampered.added], sweep.points[tampered.removed]):
        assert tampered.wedge.holds(np.arctan2(points[:, 1], points[:, 0])).all()
    before, after = recover_rings(sweep), recover_rings(tampered.sweep)
    if before.source == "file" and name not in {
        "jamming",
        "removal",
        "removal_aimed",
    }:  # few returns, or none, tell the columns less
        assert after.alone_share > before.alone_share - 0.02
