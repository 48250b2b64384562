"""A small sample."""

from dataclasses import replace

import pytest

from viewshed_lab.data.presets import preset_named
from viewshed_lab.studies.samples import StudySample, sample_of_preset


@pytest.fixture(scope="session")
def sample() -> StudySample:
    preset = replace(preset_named("nuscenes-small"), grid_cells=32, grid_half_extent_m=64.0)
    return sample_of_preset(preset, 1, 3, 77)
