"""The soak: its damages are refused for the reason that it expects, and all that it sends is accounted for."""

import numpy as np
import pytest
from benchmarks.damage import DAMAGES, cloud_of
from benchmarks.soak import soak_pipeline

from viewshed import read_sweep
from viewshed.io.messages.pointcloud2 import sweep_of_cloud
from viewshed.io.samples import junction_path

SWEEP = read_sweep(junction_path())


@pytest.mark.parametrize("name", [name for name, damage in DAMAGES.items() if "usable" not in damage.says])
def test_a_damaged_cloud_is_refused_for_its_reason(name: str) -> None:
    damage = DAMAGES[name]
    damaged = damage.change(cloud_of(SWEEP))
    if not damage.says:
        assert len(sweep_of_cloud(damaged)) <= len(SWEEP)
        return
    with pytest.raises(ValueError, match=damage.says):
        sweep_of_cloud(damaged)


@pytest.mark.slow
def test_a_short_soak_accounts_for_every_sweep() -> None:
    soaked = soak_pipeline(3.0, np.random.default_rng(0))
    assert not [fault for fault in soaked.faults if "memory" not in fault]
    assert soaked.kinds["good"].answered > 20
    assert soaked.log[-1][1] == sum(kind.sent for kind in soaked.kinds.values())
