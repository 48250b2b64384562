"""A small subject."""

from dataclasses import replace

import pytest

from viewshed.datasets.presets import preset_named
from viewshed.studies.suite import Subject, subject_of_preset


@pytest.fixture(scope="session")
def subject() -> Subject:
    preset = replace(preset_named("nuscenes-small"), grid_cells=32, grid_half_extent_m=64.0)
    return subject_of_preset(preset, 1, 3, 77)
