"""Presets have the paper's numbers of sweeps and scenes; scenes and shards add up."""

from collections import Counter
from pathlib import Path
from typing import Any

import pytest

import viewshed_lab
from viewshed_lab.data.presets import Preset, preset_named, preset_names
from viewshed_lab.data.simulated import ScenePlan, jobs_of

TABLES = Path(viewshed_lab.__file__).parent / "data" / "preset_tables"


@pytest.mark.parametrize(("name", "frames", "scenes", "agents"), [
    ("carla", (8000, 2000), (4, 1), (5, 5)),
    ("nuscenes", (27533, 6019), (700, 150), (1, 0)),
    ("ugv", (8684, 2372), (2, 1), (1, 0)),
])  # fmt: skip
def test_compositions_are_the_published_ones(
    name: str, frames: tuple[int, ...], scenes: tuple[int, ...], agents: tuple[int, int]
) -> None:
    preset, small = preset_named(name), preset_named(f"{name}-small")
    assert (preset.frames, preset.scenes, (preset.moving, preset.roadside)) == (frames, scenes, agents)
    assert (small.worlds, small.sensors, small.moving, small.roadside) == (
        preset.worlds, preset.sensors, preset.moving, preset.roadside,
    )  # fmt: skip
    assert 100 <= small.sweeps <= 1000


@pytest.mark.parametrize("name", preset_names())
def test_shards_hold_every_frame_once(name: str) -> None:
    preset = preset_named(name)
    frames: Counter[tuple[str, int]] = Counter()
    ends: dict[str, int] = {}
    for job in jobs_of(preset):
        made: Any = job.samples
        scene, first, last = made.args
        assert first == ends.get(scene.name, 0)
        assert 0 < last - first <= 50
        ends[scene.name] = last
        frames[scene.split_name, scene.number] += last - first
    for split, wanted, scenes in zip(preset.splits, preset.frames, preset.scenes, strict=True):
        counts = [count for (name, _), count in frames.items() if name == split]
        assert sum(counts) == wanted
        assert len(counts) == scenes
        assert max(counts) - min(counts) <= 1
    assert len({job.name for job in jobs_of(preset)}) == len(jobs_of(preset))


@pytest.mark.parametrize("name", preset_names())
@pytest.mark.parametrize("sweeps", [3, 1000])
def test_scaling_keeps_ratio_and_length_of_scenes(name: str, sweeps: int) -> None:
    preset = preset_named(name)
    scaled = preset.scaled(sweeps)
    assert scaled.sweeps == sweeps
    for split in range(len(preset.splits)):
        wanted = sweeps * preset.frames[split] / preset.sweeps
        assert scaled.frames[split] == pytest.approx(wanted, abs=1.5)
        length, before = (one.frames[split] / one.scenes[split] for one in (scaled, preset))
        assert length <= before * 1.5 + 1
        assert length >= before / 2 or scaled.scenes[split] == 1
    assert scaled.scaled(sweeps) == scaled


def test_scenes_take_worlds_and_weather_by_weight() -> None:
    preset = preset_named("nuscenes")
    scenes = [ScenePlan(preset, 0, number) for number in range(700)]
    for names, weights, got in (
        (preset.worlds, preset.world_weights, Counter(scene.world_kind for scene in scenes)),
        (preset.conditions, preset.condition_weights, Counter(scene.conditions for scene in scenes)),
    ):
        for name, weight in zip(names, weights, strict=True):
            assert got[name] == pytest.approx(700 * weight / sum(weights), abs=3)


@pytest.mark.parametrize(("change", "message"), [
    ({"worlds": ["moon"], "world_weights": [1.0]}, "worlds must be among .*, got 'moon'"),
    ({"sensors": ["nosuch"]}, "sensor must be one of"),
    ({"scenes": [1]}, "splits must be different names with scenes"),
    ({"frames": [4, 4]}, "train must have a frame for each scene"),
    ({"seed": 2**32}, "seed must lie in"),
    ({"moving": 0}, "at least one agent"),
    ({"grid_cells": 4096}, "1 to 2048 cells a side, got 4096: a frame would not fit"),
    ({"more": 1}, "missing or unknown: more"),
])  # fmt: skip
def test_a_bad_table_is_one_line(change: dict[str, object], message: str) -> None:
    table = preset_named("nuscenes-small").to_json() | change
    with pytest.raises(ValueError, match=message):
        Preset.from_json(table)


def test_no_two_frames_share_their_luck() -> None:
    """Agents, times, scenes and splits all draw anew."""
    preset = preset_named("carla-small")
    plans = [ScenePlan(preset, split, number) for split in (0, 1) for number in range(preset.scenes[split])]
    states = [tuple(plan.seed(1, frame).generate_state(2)) for plan in plans for frame in range(25)]
    assert len(set(states)) == len(states)
