"""Samples of the studies: sweeps with exact truth, simulated on demand."""

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
"""Ages of the earlier sweeps, relative to the sweep."""

_TIME_STEP = 2 ** (1 / 3)
"""Multiples of it modulo 1 are the shares of a scene before its sample.

Scenes take kind of world, weather and sensor from multiples of other irrational numbers: each is sampled at all times.
"""


@dataclass(frozen=True, slots=True, eq=False)
class StudySample:
    """One sweep with exact truth, and earlier sweeps of the same sensor."""

    sample: Sample  # the sweep, its truth and the mask of known truth
    # sweeps of the same sensor about ``BEFORE_S`` earlier, the oldest first; fewer at the start of a scene
    earlier: tuple[Sweep, ...] = ()
    # scene and number of the simulated frame, or None for a recorded sample
    frame: tuple[ScenePlan, int] | None = None

    @property
    def sweep(self) -> Sweep:
        """The measured sweep."""
        return self.sample.sweep

    @property
    def truth(self) -> Truth:
        """The exact truth."""
        return self.sample.truth

    @property
    def known(self) -> NDArray[np.bool_]:
        """Mask (cells, cells) of known truth."""
        return self.sample.known


def sample_of(domain: str, number: int, count: int, seed: int) -> StudySample:
    """Return sample ``number`` of ``count`` of a preset: each is from its own scene, and agents alternate."""
    preset = preset_named(domain)
    frames = preset.frames[-1] // preset.scenes[-1] * count
    preset = replace(preset, splits=("held_out",), scenes=(count,), frames=(frames,), seed=seed)
    scene = ScenePlan(preset, 0, number)
    steps = [max(round(before_s / preset.interval_s), 1) for before_s in BEFORE_S]
    times = scene.frames // preset.agents
    first = min(max(steps), times - 1)
    time = first + int(number * _TIME_STEP % 1.0 * (times - first))
    agent = number % preset.agents
    earlier = tuple(
        simulate_frame(scene, (time - step) * preset.agents + agent).sweep for step in steps if step <= time
    )
    frame = time * preset.agents + agent
    return StudySample(simulate_frame(scene, frame), earlier, (scene, frame))


CLEAR = "clear of the threshold"
"""Part: cells whose true number of returns is not near the minimum of a visible target."""

SENSOR = "sensor "
"""Prefix of the name of a part that holds all cells of one sensor's sweeps."""


def parts_of(sample: Sample, target: Target, bands: Sequence[float], margin: int) -> dict[str, NDArray[np.bool_]]:
    """Return masks (cells, cells) of parts of a view by name: ``CLEAR``, range bands, and all cells of the sensor.

    Args:
        sample: sample with truth.
        target: target whose visibility counts.
        bands: edges of the range bands, as shares of the grid's half extent.
        margin: a clear cell differs from the minimum number of returns by more than this.
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
