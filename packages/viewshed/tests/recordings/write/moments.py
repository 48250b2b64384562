"""Moments for the tests of recorders: of a simulated drive, or of any sweeps, with the answers of a pipeline."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from viewshed import Sweep, load_estimator
from viewshed.monitor import IntegrityReport
from viewshed.monitor.evidence import SECTORS
from viewshed.monitor.stream_monitor import StreamReport
from viewshed.pipeline import Answer, Pipeline
from viewshed.recordings.write.moment import DriveTruth, Moment, RisingTimes
from viewshed.recordings.write.recorder import open_recorder
from viewshed_lab.data.drive import drive_plan, drive_sweeps
from viewshed_lab.data.presets import preset_named


def drive_moments() -> list[Moment]:
    """Return the moments of two vehicles and a mast, four sweeps each."""
    preset = replace(preset_named("nuscenes-small"), roadside=1)
    plan = drive_plan(preset, seconds=0.4, hz=10.0, agents=2, world="street", seed=3)
    return moments_of(drive_sweeps(plan))


def doubted(moment: Moment) -> Moment:
    """Return the moment with a monitor report of something impossible ahead on the left."""
    suspect = np.zeros(SECTORS, np.bool_)
    suspect[40:42] = True  # 20° to 30°
    now = IntegrityReport("by hand", 2.0, 1.0, 0.01, suspect=suspect, reasons=("a wall hangs in the air", "and moves"))
    report = StreamReport(now, alarm=True, delay_s=0.2, suspect=now.suspect, doubtful_sweeps=3)
    return replace(moment, answer=replace(moment.answer, report=report))


def moments_of(sweeps: Iterable[tuple[Sweep, DriveTruth | None]]) -> list[Moment]:
    stream = list(sweeps)
    answers: list[Answer] = []
    with Pipeline(load_estimator("shadow_map"), answers.append, lossless=True) as pipeline:
        for sweep, _ in stream:
            pipeline.put(sweep, sweep.agent)
    times = RisingTimes()
    return [
        Moment(sweep.agent, times.of(sweep.agent, sweep.t_ns), sweep, answer, truth)
        for (sweep, truth), answer in zip(stream, answers, strict=True)
    ]


def write(place: Path, moments: list[Moment], schemas: str = "ros") -> Path:
    with open_recorder(place, schemas) as record:
        for moment in moments:
            record(moment)
    return place
