"""Drives of ten sweeps: simulated, attacked or corrupted from the middle on; what all evidence says of each sweep."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import Mask
from viewshed.geometry import Rigid
from viewshed.monitor.evidence import EVIDENCE, SECTORS, MonitoredSweep, sector_of
from viewshed.monitor.score import measure_all
from viewshed.monitor.sweep_monitor import EARLIER_SWEEPS, group_of
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sweep import Sweep
from viewshed_lab.data.simulated import ScenePlan, measure_frame
from viewshed_lab.studies.cases import generator, untouched
from viewshed_lab.studies.monitor.archive import DriveEvidence
from viewshed_lab.studies.monitor.plan import (
    ALL_ATTACKS,
    ATTACKED_SPLITS,
    BEFORE,
    CORRUPTED,
    FRAMES,
    FROZEN,
    OLDER,
    ONSET,
    SPLITS,
    MonitorPlan,
)
from viewshed_lab.studies.records import BENIGN, Case
from viewshed_lab.threats.attacks import NULL, Knowledge, at_severity
from viewshed_lab.threats.attacks.base import Attack, Tampered
from viewshed_lab.threats.corruptions import CORRUPTIONS, InTheWorld, Slope

STEADY = ("dropped_sectors", "dead_rings", "fewer_beams", "attitude", "motion", "pose_spoof")
"""What is drawn once for a whole drive: which rings are dead, which way a pose is shifted."""

LASTING = ("rain", "fog", "snow", "glass", "vegetation", "slope")
"""Corruptions that do not come up between two sweeps: weather, and things that stand in the world."""

HONEST = ("benign", "corruption", "null")
"""Kinds of cases in which nothing is inconsistent."""


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """Ten sweeps of one sensor, and what was measured before."""

    plan: MonitorPlan  # of the study
    key: tuple[str, str, int]  # domain, split and number: the seed of all that is done to it
    scene: ScenePlan  # that it is of
    conditions: Case  # what it suffers from its first frame on, ``BENIGN`` for nothing
    sweeps: tuple[Sweep, ...]  # (FRAMES,) as the sensor measured them under these conditions

    @classmethod
    def simulate(cls, plan: MonitorPlan, domain: str, split: str, number: int) -> Drive:
        """Return a drive of the plan."""
        scene = ScenePlan(plan.preset(domain), SPLITS.index(split), number)
        clear = tuple(measure_frame(scene, BEFORE + frame) for frame in range(FRAMES))
        drive = cls(plan, (domain, split, number), scene, BENIGN, clear)
        conditions = _conditions(plan, drive.key)
        if conditions == BENIGN:
            return drive
        return replace(drive, conditions=conditions, sweeps=tuple(t.sweep for t in drive.tamper(conditions, first=0)))

    def tamper(self, case: Case, first: int = ONSET) -> Iterator[Tampered]:
        """Yield the sweeps from frame ``first`` on in a case; an attack keeps its place before the sensor.

        Raises:
            ValueError: the case cannot be made of these sweeps.
        """
        azimuth: float | None = None
        corruption = CORRUPTIONS[case.name](int(case.level)) if case.kind == "corruption" else None
        if isinstance(corruption, InTheWorld):
            yield from map(untouched, self._with_things(corruption, case, first))
            return
        for frame in range(first, FRAMES):
            word = "steady" if case.name in STEADY else str(frame)
            rng = generator(self.plan.seed, *self.key, case.kind.replace("strength", "attack"), case.name, word)
            sweep = self.sweeps[frame]
            if corruption is not None:
                yield untouched(corruption.apply(sweep, rng))
                continue
            tampered = _kept_at(self._attack(case, frame), azimuth).apply(sweep, rng)
            if azimuth is None and tampered.wedge is not None:
                azimuth = tampered.wedge.azimuth
            yield tampered

    def _with_things(self, corruption: InTheWorld, case: Case, first: int) -> Iterator[Sweep]:
        """Yield the sweeps from frame ``first`` on with things that stand still while the sensor passes."""
        poses = [pose for sweep in self.sweeps if (pose := sweep.world_from_sensor) is not None]
        if len(poses) < FRAMES:
            raise ValueError("sweeps must have poses for things to stand still")
        rng = generator(self.plan.seed, *self.key, case.kind, case.name, "steady")
        places = poses[first] @ corruption.place(self.sweeps[first], rng)
        if isinstance(corruption, Slope):
            # The sensor's own poses are level: the slope begins beyond all of them.
            foot, above = places
            reached_m = max(float((pose.translation - foot) @ (above - foot)) for pose in poses)
            places = places + max(reached_m + corruption.start_m, 0.0) * (above - foot)
        for frame in range(first, FRAMES):
            rng = generator(self.plan.seed, *self.key, case.kind, case.name, str(frame))
            yield corruption.apply_at(self.sweeps[frame], poses[frame].inverse() @ places, rng)

    def _attack(self, case: Case, frame: int) -> Attack:
        """Return the attack of a case on one frame: phantoms appear at the onset, replays play what was before."""
        known = Knowledge((self._known(case, frame),), half_extent_m=self.scene.preset.grid.half_extent_m)
        if case.kind == "null":
            return NULL[case.name](None, replace(known, again=measure_frame(self.scene, BEFORE + frame, again=1)))
        if case.kind == "strength":
            attribute, value = case.level.split()
            return at_severity(case.name, attribute, int(value) if value.isdecimal() else float(value), known)
        return ALL_ATTACKS[case.name](int(case.level) if case.level.isdecimal() else None, known)

    def _known(self, case: Case, frame: int) -> Sweep:
        """Return the sweep that the attacker knows beside the one that is attacked."""
        if case.name != "replay":
            return self.sweeps[ONSET]
        if case.level == OLDER:
            return measure_frame(self.scene, frame - ONSET)
        return self.sweeps[ONSET - 1 if case.level == FROZEN else frame - ONSET]


def _conditions(plan: MonitorPlan, key: tuple[str, str, int]) -> Case:
    """Return what a drive suffers: nothing in 70 %, in 30 % one of the corruptions at one of its five severities.

    Drives that are attacked are clear.
    """
    domain, split, number = key
    rng = generator(plan.seed, domain, split, "conditions", number)
    if (plan.cases_of(*key)) or not plan.corruptions or rng.random() >= _corrupted_share(plan, key):
        return BENIGN
    return Case("corruption", str(rng.choice(list(plan.corruptions))), str(rng.integers(1, 6)))


def _corrupted_share(plan: MonitorPlan, key: tuple[str, str, int]) -> float:
    """Return the chance that a drive which is not attacked is corrupted, so that ``CORRUPTED`` of its split are."""
    domain, split, number = key
    place = plan.domains.index(domain)
    drives: int = getattr(plan, split)[place]
    is_attacked = split in ATTACKED_SPLITS and number < drives
    attacked = min(plan.attacked[place], drives) if is_attacked else 0
    return float(min(CORRUPTED * drives / max(drives - attacked, 1), 1.0))


def _kept_at(attack: Attack, azimuth: float | None) -> Attack:
    """Return the attack aimed at an azimuth, if it has one to aim at and aims anew for each sweep."""
    changed: Any = attack
    aims = any(field.name == "azimuth" for field in fields(changed)) and changed.azimuth is None
    return cast(Attack, replace(changed, azimuth=azimuth)) if aims and azimuth is not None else attack


def measure_drive(drive: Drive, cases: Sequence[Case]) -> DriveEvidence:
    """Return what all evidence says of each sweep of a drive, as it is and in several cases."""
    grid = drive.scene.preset.grid
    clean = [level(sweep, grid) for sweep in drive.sweeps]
    benign = np.stack([_measure(clean, frame) for frame in range(FRAMES)])
    unposed = [level(sweep.replace(world_from_sensor=None), grid) for sweep in drive.sweeps[-EARLIER_SWEEPS - 1 :]]
    made, evidence, touched, refused = list[Case](), [], [], list[Case]()
    nothing = np.zeros(SECTORS, np.bool_)
    for case in cases:
        first = 0 if case.kind == "corruption" and case.name in LASTING else ONSET
        try:
            tampered = list(drive.tamper(case, first))
        except ValueError:
            refused.append(case)
            continue
        # What the victim saw: clean sweeps up to the onset, then those of the attacker.
        seen = clean[:first] + [level(one.sweep, grid) for one in tampered]
        made.append(case)
        evidence.append(np.stack([_measure(seen, frame) for frame in range(ONSET, FRAMES)]))
        # What a corruption does is no attacker's, and a null attack leaves all as it would have been measured.
        touched.append([
            touched_sectors(one, clean[frame], seen[frame]) if case.kind not in HONEST else nothing
            for frame, one in enumerate(tampered[-(FRAMES - ONSET):], ONSET)
        ])  # fmt: skip
    return DriveEvidence(
        *drive.key, sensor_of(clean[0]), drive.conditions, tuple(EVIDENCE), benign,
        _measure(unposed, EARLIER_SWEEPS),
        tuple(made), np.array(evidence, np.float32).reshape(-1, FRAMES - ONSET, len(EVIDENCE), SECTORS),
        np.array(touched, np.bool_).reshape(-1, FRAMES - ONSET, SECTORS), tuple(refused),
    )  # fmt: skip


def sensor_of(leveled: LeveledSweep) -> str:
    """Return the name of the sensor with whose sweeps a sweep is calibrated."""
    return group_of(MonitoredSweep(leveled)).sensor


def _measure(seen: Sequence[LeveledSweep], frame: int) -> NDArray[np.float32]:
    """Return all evidence (E, SECTORS) of one of the sweeps that were seen, with five before it if there are."""
    earlier = seen[frame - EARLIER_SWEEPS : frame] if frame >= EARLIER_SWEEPS else ()
    return measure_all(MonitoredSweep(seen[frame], tuple(earlier)))


def touched_sectors(tampered: Tampered, clean: LeveledSweep, seen: LeveledSweep) -> Mask:
    """Return which sectors (SECTORS,) hold a return that an attacker added or removed; all where the pose is false."""
    rows = (
        (seen.level_from_sensor, tampered.sweep.points[tampered.added]),
        (clean.level_from_sensor, clean.sweep.points[tampered.removed]),
    )
    touched = np.zeros(SECTORS, np.bool_)
    for level_from_sensor, points in rows:
        x, y, _ = (level_from_sensor @ points.astype(np.float64)).T
        touched[sector_of(np.arctan2(y, x))] = True
    if _moved(clean.sweep.world_from_sensor, tampered.sweep.world_from_sensor):
        touched[:] = True
    return touched


def _moved(one: Rigid | None, other: Rigid | None) -> bool:
    if one is None or other is None:
        return False
    return not np.allclose(one.as_matrix(), other.as_matrix(), atol=1e-9)
