"""Profiles: each names what exists, and what it names can be loaded together."""

import pytest

from viewshed import load_estimator
from viewshed.estimators import ESTIMATORS
from viewshed.grid import GRIDS
from viewshed.pipeline.profiles import PROFILES, Profile, profile_named
from viewshed.pipeline.reactions import RULES


@pytest.mark.parametrize("name", PROFILES)
def test_a_profile_names_a_method_and_a_grid_that_exist(name: str) -> None:
    profile = profile_named(name)
    assert profile.method in ESTIMATORS
    assert profile.grid in GRIDS
    assert not profile.history or load_estimator(profile.method, grid=profile.grid).uses_history


def test_a_name_that_does_not_exist_and_negative_numbers_are_refused() -> None:
    with pytest.raises(ValueError, match=r"profile must be one of robot, .* got 'car'"):
        profile_named("car")
    with pytest.raises(ValueError, match="must not be negative, got -1"):
        Profile("shadow_map", "road", -1, False, RULES, 0.0)
