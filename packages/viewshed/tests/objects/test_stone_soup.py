"""The same scenario by Stone Soup: predictions, updates and assignments are the same."""

import numpy as np
import pytest
from tests.objects.stone_soup import RULES, XVYV, ours, scenario, theirs


@pytest.mark.parametrize("seed", range(2))
def test_states_covariances_and_assignments_are_those_of_stone_soup(seed: int) -> None:
    sweeps = scenario(np.random.default_rng(seed))
    for mine, other in zip(ours(sweeps, RULES), theirs(sweeps), strict=True):
        assert mine.ids.tolist() == list(other)
        for k, (of, state) in enumerate(other.values()):
            assert mine.detection[k] == of
            np.testing.assert_allclose(mine.states[k], np.array(state.state_vector)[XVYV, 0], rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(mine.covariances[k], state.covar[np.ix_(XVYV, XVYV)], rtol=1e-9, atol=1e-9)
