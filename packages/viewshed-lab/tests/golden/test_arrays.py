"""Estimates of real and simulated sweeps are those of the golden arrays, but for noise of another processor."""

from pathlib import Path

import numpy as np
import pytest
from tests.golden import recorder, stored

pytestmark = pytest.mark.slow


def test_every_sweep_and_method_has_an_array() -> None:
    assert (len(recorder.REAL), len(recorder.SIMULATED)) == (20, 50)
    assert set(stored.sweeps_of_manifest()) == set(map(str, recorder.SWEEPS))
    for method in recorder.METHODS:
        wanted = {str(name) for name in recorder.SWEEPS if method in recorder.methods_of(name)}
        assert set(stored.load(method)) == wanted, method


def test_every_method_and_attack_of_the_tables_is_there() -> None:
    assert recorder.unrecorded() == []


def test_simulated_sweeps_are_estimated_as_before() -> None:
    names = [name for name in recorder.SIMULATED if str(name) in recorder.SHORT]
    assert len(names) >= 12
    assert stored.differences(names, None) == []


def test_real_sweeps_are_estimated_as_before(real_data: Path) -> None:
    names = [name for name in recorder.REAL if str(name) in recorder.SHORT]
    assert len(names) >= 7
    assert stored.differences(names, real_data) == []


@pytest.mark.parametrize("method", recorder.METHODS)
def test_a_shifted_or_mirrored_estimate_is_told_from_the_golden_one(
    method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The check can fail: axes swapped, or one more cell in a row."""
    name = next(each for each in recorder.SIMULATED if method in recorder.methods_of(each))
    golden = stored.load(method)[str(name)]
    step = len(golden.state) // len(golden.prob)
    for turned in (golden.state.T, np.roll(golden.state, 1, axis=0)):
        whole = (np.kron(values, np.ones((step, step), np.uint8)) for values in (golden.prob, golden.std))
        wrong = recorder.Arrays(turned, *whole)
        monkeypatch.setattr(recorder, "methods_of", lambda _: (method,))
        monkeypatch.setattr(recorder, "estimate", lambda *_, found=wrong: found)
        [line] = stored.differences([name], None)
        assert line.startswith(f"{method}: state differs in ")
