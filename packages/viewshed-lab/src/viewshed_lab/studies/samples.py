"""The sweeps that a study attacks, with exact truth, simulated as needed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from viewshed.fov.truth import Truth
from viewshed.fov.visibility import Target
from viewshed.grid import polar_of_cells
from viewshed.sweep import Sweep
from viewshed_lab.data import Sample
from viewshed_lab.data.presets import preset_named
from viewshed_lab.data.simulated import ScenePlan, simulate_frame

BEFORE_S = (2.0, 0.5)
"""How long before the sweep the earlier ones were measured."""

_GOLDEN = (5**0.5 - 1) / 2


@dataclass(frozen=True, slots=True, eq=False)
class StudySample:
    """One sweep with exact truth, and what the same sensor measured before."""

    sample: Sample  # the sweep, its truth and where that is known
    # sweeps of the same sensor about ``BEFORE_S`` before, the oldest first; fewer where there are none
    earlier: tuple[Sweep, ...] = ()
    # the scene and the number of the frame that was simulated, or None for a recorded sample
    frame: tuple[ScenePlan, int] | None = None

    @property
    def sweep(self) -> Sweep:
        """What the sensor measured."""
        return self.sample.sweep

    @property
    def truth(self) -> Truth:
        """What it could have seen."""
        return self.sample.truth

    @property
    def known(self) -> NDArray[np.bool_]:
        """Where that is known."""
        return self.sample.known


def sample_of(domain: str, number: int, count: int, seed: int) -> StudySample:
    """Return the sample ``number`` of ``count`` of a preset: each is of a scene of its own, and agents take turns."""
    preset = preset_named(domain)
    frames = preset.frames[-1] // preset.scenes[-1] * count
    preset = replace(preset, splits=("held_out",), scenes=(count,), frames=(frames,), seed=seed)
    scene = ScenePlan(preset, 0, number)
    steps = [max(round(before_s / preset.interval_s), 1) for before_s in BEFORE_S]
    times = scene.frames // preset.agents
    first = min(max(steps), times - 1)
    time = first + int(number * _GOLDEN % 1.0 * (times - first))
    agent = number % preset.agents
    earlier = tuple(
        simulate_frame(scene, (time - step) * preset.agents + agent).sweep for step in steps if step <= time
    )
    frame = time * preset.agents + agent
    return StudySample(simulate_frame(scene, frame), earlier, (scene, frame))


CLEAR = "clear of the threshold"
"""Part of the cells whose true number of returns is not next to that from which on a target is visible."""

SENSOR = "sensor "
"""Begins the name of a part that is all of a sensor's sweeps."""


def parts_of(sample: Sample, target: Target, bands: Sequence[float], margin: int) -> dict[str, NDArray[np.bool_]]:
    """Return parts of a view by name, masks (cells, cells): clear of the threshold, bands of range, the sensor's.

    Args:
        sample: with its truth.
        target: what would have to be seen.
        bands: edges of the bands of range, as shares of half the grid's side.
        margin: returns that a clear cell is more than apart from the threshold.
    """
    grid, returns = sample.truth.grid, sample.truth.expected_returns[target.name].astype(np.int64)
    range_m, _ = polar_of_cells(grid)
    parts = {CLEAR: np.abs(returns - min(target.min_returns, 255)) > margin}
    for low_m, high_m in pairwise(edge * grid.half_extent_m for edge in bands):
        name = f"{low_m:g} to {high_m:.3g} m" if high_m < np.inf else f"from {low_m:g} m on"
        parts[name] = (range_m >= low_m) & (range_m < high_m)
    if sample.sweep.model is not None:
        parts[SENSOR + sample.sweep.model.name] = np.ones(grid.shape, np.bool_)
    return parts
