"""The drive that the tests of labeling use."""

import pytest
from tests.data.labeling.scene import Shot, shot_at


@pytest.fixture(scope="session")
def drive() -> list[Shot]:
    """Nine revolutions, the one in the middle at the origin."""
    return [shot_at(number) for number in range(-4, 5)]
