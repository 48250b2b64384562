"""The soak: its damages are refused for the reason that it expects, and all that it sends is accounted for."""

import numpy as np
import pytest
from benchmarks.damage import DAMAGES, cloud_of
from benchmarks.soak import CLOCKS, Kind, Script, Soaked, faults_of, growth_faults, plain, soak_pipeline

from viewshed import read_sweep
from viewshed.io.messages.pointcloud2 import sweep_of_cloud
from viewshed.io.samples import junction_path

SWEEP = read_sweep(junction_path())


def test_a_cloud_that_is_whole_is_the_sweep_it_was_made_of() -> None:
    again = sweep_of_cloud(cloud_of(SWEEP))
    np.testing.assert_array_equal(again.points, SWEEP.points)
    assert SWEEP.ring is not None
    np.testing.assert_array_equal(again.ring, SWEEP.ring)


@pytest.mark.parametrize("name", [name for name, damage in DAMAGES.items() if "usable" not in damage.says])
def test_a_damaged_cloud_is_refused_for_its_reason(name: str) -> None:
    damage = DAMAGES[name]
    damaged = damage.change(cloud_of(SWEEP))
    if not damage.says:
        assert len(sweep_of_cloud(damaged)) <= len(SWEEP)
        return
    with pytest.raises(ValueError, match=damage.says):
        sweep_of_cloud(damaged)


def test_the_script_sends_what_it_says() -> None:
    script, kinds, at_once, times = Script(np.random.default_rng(0)), [], [], []
    for _ in range(20_000):
        kind, t_ns, is_more = script.next()
        kinds.append(kind)
        times.append(t_ns)
        at_once.append(is_more)
    assert {*DAMAGES, *CLOCKS, "good"} == set(kinds)
    assert sum(kind in DAMAGES for kind in kinds) / len(kinds) == pytest.approx(0.01, rel=0.3)
    repeats = [number for number, kind in enumerate(kinds) if kind == "time repeats"]
    assert all(times[number] == times[number - 1] and kinds[number - 1] == "good" for number in repeats)
    assert any(at_once)


@pytest.mark.slow
def test_a_short_soak_accounts_for_every_sweep() -> None:
    soaked = soak_pipeline(6.0, np.random.default_rng(0))
    assert not [fault for fault in soaked.faults if "memory" not in fault]
    assert soaked.kinds["good"].answered > 20
    assert soaked.log[-1][1] == sum(kind.sent for kind in soaked.kinds.values())


def test_what_is_not_accounted_for_and_memory_that_grows_are_faults() -> None:
    kinds = {name: Kind() for name in ("good", *DAMAGES, *CLOCKS)}
    log = [[float(second), 1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 100.0] for second in range(10)]
    assert faults_of(Soaked(kinds=kinds, log=log)) == []
    kinds["good"].sent, kinds["cut off"].sent, kinds["cut off"].answered = 2, 1, 1
    assert faults_of(Soaked(kinds=kinds, log=log)) == ["good: of 2 sent only 0 are known", "cut off: 1 were answered"]
    assert growth_faults([100.0, 104.0]) == []
    assert growth_faults([100.0, 106.0]) == ["memory grew by 6.0%, from 100 MB on"]
    assert plain("60.1 s and -3") == "# s and #"
