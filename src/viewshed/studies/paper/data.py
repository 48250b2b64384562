"""The data of the study: simulated archives, and the held-out sweeps that models are tried on.

What is kept of contestants on held-out sweeps: counts of each sweep, and all their probabilities together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed._jobs import Engine
from viewshed.datasets import Archive, Storage
from viewshed.datasets.presets import Preset, preset_named
from viewshed.datasets.simulated import simulate
from viewshed.estimators import PAPER_ESTIMATORS, PAPER_INDOOR_ESTIMATORS
from viewshed.metrics import Scores
from viewshed.studies.paper.plan import StudyPlan
from viewshed.studies.paper.protocols import MIXTURES, Setting, generator
from viewshed.studies.statistics import average_precision, counts
from viewshed.studies.suite import BEFORE_S, LABEL, Subject
from viewshed.sweep import Sweep
from viewshed.threats.attacks import Knowledge

SPLITS = ("train", "test")


def preset_of(plan: StudyPlan, domain: str, split: str) -> Preset:
    """Return how the sweeps of a split are simulated: scenes of its own seed, all of one length."""
    place = plan.domains.index(domain)
    train = split == "train"
    scenes = (plan.train_scenes if train else plan.test_scenes)[place]
    times = (plan.train_times if train else plan.test_times)[place]
    preset = preset_named(domain)
    return replace(
        preset, name=f"{plan.name}-{domain}-{split}", splits=(split,), scenes=(scenes,),
        frames=(scenes * times * preset.agents,), interval_s=plan.interval_s[place], grid_cells=plan.cells,
        seed=plan.seed if train else plan.test_seed,
    )  # fmt: skip


def place_of(folder: Path, domain: str, split: str) -> Path:
    """Return where the archive of a split lies."""
    return folder / "data" / f"{domain}-{split}"


def make_archive(
    plan: StudyPlan, folder: Path, part: tuple[str, str], engine: Engine, progress: Callable[[int], None]
) -> Archive:
    """Return the archive of a part (domain, split), simulated as far as it is not there.

    Args:
        plan: what it is made for.
        folder: of the study.
        part: domain and split.
        engine: makes the shards.
        progress: is told how many more sweeps are there.
    """
    store = Storage.of(place_of(folder, *part))
    return simulate(preset_of(plan, *part), store, engine, lambda shard: progress(shard.frames))


@lru_cache(maxsize=8)
def open_archive(folder: Path, domain: str, split: str) -> Archive:
    """Return an archive that was made.

    Raises:
        ValueError: it is not there or not finished.
        OSError: it cannot be read.
    """
    return Archive.open(place_of(folder, domain, split))


def subject_of(plan: StudyPlan, folder: Path, domain: str, number: int) -> Subject:
    """Return a held-out sweep with what the same sensor measured before.

    Scene after scene and agent after agent at the last time of the scenes, then the same at the time before.
    """
    preset, archive = preset_of(plan, domain, "test"), open_archive(folder, domain, "test")
    scenes, agents = preset.scenes[0], preset.agents
    times = preset.frames[0] // (scenes * agents)
    scene, turn = number % scenes, number // scenes
    time = times - 1 - turn // agents
    index = (scene * times + time) * agents + (turn + scene) % agents
    steps = [max(round(before_s / preset.interval_s), 1) for before_s in BEFORE_S]
    earlier = tuple(archive[index - step * agents].sweep for step in steps if step <= time)
    return Subject(archive[index], earlier)


@dataclass(frozen=True, slots=True, eq=False)
class TestSweep:
    """One held-out sweep, benign and attacked, with what estimates are held against.

    Attributes:
        scene: it is from.
        attack: name of what was done to the second one.
        benign: as measured.
        attacked: as the attack leaves it.
        visible: (cells, cells) bool, truth.
        known: (cells, cells) bool, where the truth counts.
    """

    scene: str
    attack: str
    benign: Sweep
    attacked: Sweep
    visible: NDArray[np.bool_]
    known: NDArray[np.bool_]


def test_sweeps(plan: StudyPlan, folder: Path, setting: Setting, count: int) -> Iterator[TestSweep]:
    """Yield ``count`` held-out sweeps of the setting's domain, as many from each scene as can be."""
    return (test_sweep(plan, folder, setting, number) for number in range(count))


def test_sweep(plan: StudyPlan, folder: Path, setting: Setting, number: int) -> TestSweep:
    """Return one of the held-out sweeps of the setting's domain, benign and attacked."""
    subject = subject_of(plan, folder, setting.domain, number)
    name, attacked = _attacked(plan, setting, subject, number)
    visible, known = truth_of(setting, subject)
    return TestSweep(subject.sample.scene, name, subject.sample.sweep, attacked, visible, known)


def truth_of(setting: Setting, subject: Subject) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the truth (cells, cells) of the clean sweep and where it counts."""
    sample = subject.sample
    if setting.truth == LABEL:
        table = PAPER_INDOOR_ESTIMATORS if setting.indoor else PAPER_ESTIMATORS
        label = table[LABEL](setting.grid).estimate(sample.sweep).visible(setting.threshold)
        return label, np.ones(setting.grid.shape, np.bool_)
    return sample.truth.visible(), sample.known


def _attacked(plan: StudyPlan, setting: Setting, subject: Subject, number: int) -> tuple[str, Sweep]:
    knowledge = Knowledge(subject.earlier[:1], half_extent_m=setting.grid.half_extent_m)
    name, attack = setting.attack(number, knowledge)
    rng = generator(plan.test_seed, setting.protocol, setting.domain, number)
    return name, attack.apply(subject.sample.sweep, rng).sweep


Said = tuple[NDArray[np.float32], NDArray[np.float32] | None]
"""(cells, cells) probability of visible, and its deviation or None."""

Predict = Callable[[Sweep], Said]

DECIMALS = 5


@dataclass(slots=True, eq=False)
class Measured:
    """What one contestant says of one set of sweeps.

    Attributes:
        frames: for each sweep both, only claimed, only true, neither, and average precision (NaN where none).
        scores: the cells of all of them.
    """

    frames: list[list[float]] = field(default_factory=list)
    scores: Scores = field(default_factory=Scores)

    def add(self, said: Said, threshold: float, visible: NDArray[np.bool_], known: NDArray[np.bool_]) -> None:
        """Count one sweep over the cells whose truth is ``known``."""
        prob, true = said[0][known], visible[known]
        self.scores.add(prob, true, None if said[1] is None else said[1][known])
        self.frames.append([*counts(prob >= np.float32(threshold), true), average_precision(prob, true)])

    def to_json(self) -> dict[str, Any]:
        """Return it as plain values."""
        frames = [[*map(int, row[:4]), None if np.isnan(row[4]) else round(row[4], DECIMALS)] for row in self.frames]
        return {"frames": frames, "scores": self.scores.to_json()}

    @classmethod
    def from_json(cls, told: Mapping[str, Any]) -> Measured:
        """Return what :meth:`to_json` told.

        Raises:
            ValueError: it is damaged or of another version.
        """
        frames = [[float("nan") if value is None else float(value) for value in row] for row in told["frames"]]
        return cls(frames, Scores.from_json(told["scores"]))

    @property
    def counts(self) -> NDArray[np.float64]:
        """(sweeps, 4) cells of each sweep: both, only claimed, only true, neither."""
        return np.array(self.frames, np.float64).reshape(-1, 5)[:, :4]

    @property
    def areas(self) -> NDArray[np.float64]:
        """(sweeps,) average precision of each sweep."""
        return np.array(self.frames, np.float64).reshape(-1, 5)[:, 4]


def score_contestants(
    sweeps: Iterable[TestSweep], contestants: Mapping[str, Predict], threshold: float
) -> dict[str, Any]:
    """Return what every contestant says of the sweeps, benign and attacked, as plain values.

    Args:
        sweeps: held-out ones.
        contestants: by name.
        threshold: probability from which a cell is claimed.
    """
    found = {name: {mixture: Measured() for mixture in MIXTURES} for name in contestants}
    scenes, attacks = [], []
    for test in sweeps:
        scenes.append(test.scene)
        attacks.append(test.attack)
        for name, predict in contestants.items():
            for mixture, sweep in zip(MIXTURES, (test.benign, test.attacked), strict=True):
                found[name][mixture].add(predict(sweep), threshold, test.visible, test.known)
    scores = {name: {mixture: each.to_json() for mixture, each in both.items()} for name, both in found.items()}
    return {"scenes": scenes, "attacks": attacks, "scores": scores}
