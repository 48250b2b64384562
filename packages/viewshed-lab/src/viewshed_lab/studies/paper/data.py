"""The data of the study: simulated archives, and the held-out sweeps on which models are evaluated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path

from viewshed_lab._jobs import Engine
from viewshed_lab.data import Archive, Storage
from viewshed_lab.data.presets import Preset, preset_named
from viewshed_lab.data.simulated import simulate
from viewshed_lab.studies.cases import case_generator
from viewshed_lab.studies.evaluate import Evaluation, Reference
from viewshed_lab.studies.paper.plan import PaperPlan
from viewshed_lab.studies.paper.protocols import ProtocolSetting
from viewshed_lab.studies.records import STRICT
from viewshed_lab.studies.samples import BEFORE_S, StudySample
from viewshed_lab.studies.suite import EstimatorSuite

SPLITS = ("train", "test")


def preset_of(plan: PaperPlan, domain: str, split: str) -> Preset:
    """Return the preset that simulates a split: scenes with the split's seed, all of one length."""
    number = plan.domains.index(domain)
    train = split == "train"
    scenes = (plan.train_scenes if train else plan.test_scenes)[number]
    times = (plan.train_times if train else plan.test_times)[number]
    preset = preset_named(domain)
    return replace(
        preset, name=f"{plan.name}-{domain}-{split}", splits=(split,), scenes=(scenes,),
        frames=(scenes * times * preset.agents,), interval_s=plan.interval_s[number], grid_cells=plan.cells,
        seed=plan.seed if train else plan.test_seed,
    )  # fmt: skip


def archive_path(folder: Path, domain: str, split: str) -> Path:
    """Return the folder of the archive of a split."""
    return folder / "data" / f"{domain}-{split}"


def make_archive(
    plan: PaperPlan, folder: Path, part: tuple[str, str], engine: Engine, on_progress: Callable[[int], None]
) -> Archive:
    """Return the archive of a part (domain, split); simulate what is missing.

    ``on_progress`` is called with the number of newly finished sweeps.
    """
    store = Storage.of(archive_path(folder, *part))
    return simulate(preset_of(plan, *part), store, engine, lambda shard: on_progress(shard.frames))


@lru_cache(maxsize=8)
def open_archive(folder: Path, domain: str, split: str) -> Archive:
    """Return an existing archive."""
    return Archive.open(archive_path(folder, domain, split))


def held_out(plan: PaperPlan, folder: Path, domain: str, number: int) -> StudySample:
    """Return held-out sweep ``number`` with earlier sweeps of the same sensor.

    Numbers go through the scenes, then through the agents, at the last time of the scenes; then at the time before.
    """
    preset, archive = preset_of(plan, domain, "test"), open_archive(folder, domain, "test")
    scenes, agents = preset.scenes[0], preset.agents
    times = preset.frames[0] // (scenes * agents)
    scene, turn = number % scenes, number // scenes
    time = times - 1 - turn // agents
    index = (scene * times + time) * agents + (turn + scene) % agents
    steps = [max(round(before_s / preset.interval_s), 1) for before_s in BEFORE_S]
    earlier = tuple(archive[index - step * agents].sweep for step in steps if step <= time)
    return StudySample(archive[index], earlier)


def evaluation_of(
    plan: PaperPlan, folder: Path, setting: ProtocolSetting, suite: EstimatorSuite, number: int
) -> Evaluation:
    """Return the evaluation of a suite on a held-out sweep of the setting's domain, with the setting's truth."""
    sample = held_out(plan, folder, setting.domain, number)
    rng_of = partial(case_generator, plan.test_seed, setting.domain, number)
    reference = Reference.exact(sample) if setting.protocol == STRICT else Reference.label(sample, setting.grid)
    return Evaluation(sample, suite, reference, setting.domain, number, rng_of, setting.protocol)
