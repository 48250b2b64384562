"""Objects in a stream of sweeps: detected, tracked and explained, those of each agent by themselves."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from viewshed.detections import Detections
from viewshed.fov.estimate import FovEstimate
from viewshed.fov.height_map import HeightMap
from viewshed.geometry import Rigid
from viewshed.monitor.report import IntegrityReport
from viewshed.objects.cells import SeenCells
from viewshed.objects.detector import Detector
from viewshed.objects.evidence import EvidenceModel
from viewshed.objects.explained import ExplainedTracks
from viewshed.objects.sensor_view import Observed, SensorView
from viewshed.objects.single import SingleFusion
from viewshed.objects.tracker import Tracker
from viewshed.objects.views import BeamView
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.preprocess.streams import remember

PERIOD_S = 0.1
"""Between two sweeps that do not tell their times."""

Tamper = Callable[[LeveledSweep, Detections], Detections]
"""Returns the detections of a sweep as an attacker lets others see them, in its ``level`` frame."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenObjects:
    """The objects of one agent after one of its sweeps."""

    detections: Detections  # of this sweep, in its ``level`` frame
    # all tracks, each with why it is detected or not; in the world, or in ``level`` without poses
    explained: ExplainedTracks
    tracks_from_level: Rigid  # pose of the sweep's ``level`` frame in the frame of the tracks
    ground: HeightMap | None = None  # about the sensor, in ``level``
    seconds: float = 0.0  # that detecting, tracking and explaining took

    @property
    def shown(self) -> NDArray[np.bool_]:
        """(N,) bool, tracks that others are shown: confirmed ones that the tracker still holds, and accused ones."""
        return self.explained.tracks.confirmed & (~self.explained.held | self.explained.accused)


@dataclass(slots=True, eq=False)
class _Agent:
    fusion: SingleFusion
    tracker: Tracker = field(default_factory=Tracker)
    last_s: float = -PERIOD_S


class ObjectStream:
    """Detects, tracks and explains the objects of several agents, sweep after sweep.

    >>> from viewshed import load_estimator, read_sweep
    >>> from viewshed.io.samples import junction_path
    >>> from viewshed.preprocess.leveling import level
    >>> estimator, objects = load_estimator("shadow_map"), ObjectStream()
    >>> leveled = level(read_sweep(junction_path()), estimator.grid)
    >>> seen = objects.follow(leveled, estimator.estimate(leveled))
    >>> len(seen.detections) > 5, len(seen.explained) == len(seen.explained.reasons)
    (True, True)

    Args:
        detector: finds the objects; None is the usual one.
        tamper: an attack on the detections, for trials; None for none.
        model: what evidence is worth for this detector; None is the shipped one.
        clock: of the time that it takes.

    Raises:
        ImportError: scipy is not installed.
    """

    def __init__(
        self,
        detector: Detector | None = None,
        tamper: Tamper | None = None,
        model: EvidenceModel | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._detector = Detector() if detector is None else detector
        self._tamper, self._clock = tamper, clock
        self._model = model
        self._agents: dict[str, _Agent] = {}
        self._agent("")  # what is not installed is reported now
        self.reset()

    def fresh(self) -> ObjectStream:
        """Return a stream like this one, without any track."""
        return ObjectStream(self._detector, self._tamper, self._model, self._clock)

    def reset(self) -> None:
        """Forget all tracks of all agents."""
        self._agents.clear()

    def follow(
        self, leveled: LeveledSweep, estimate: FovEstimate, report: IntegrityReport | None = None
    ) -> SeenObjects:
        """Return the objects of an agent after its next sweep.

        Args:
            leveled: the sweep.
            estimate: what it sees.
            report: of its monitor: where it alarms, nothing is claimed of tracks.

        Raises:
            ValueError: a number of the sweep or of the estimate is out of range.
        """
        begun_s = self._clock()
        detections, (tracks, found, views) = self.observe(leveled, estimate, report)
        # 4. Why each is detected or not.
        explained = self._agent(leveled.sweep.agent).fusion.explain(tracks, found, views)
        pose = leveled.world_from_level or Rigid.identity()
        return SeenObjects(detections, explained, pose, leveled.ground, self._clock() - begun_s)

    def observe(
        self, leveled: LeveledSweep, estimate: FovEstimate, report: IntegrityReport | None = None
    ) -> tuple[Detections, Observed]:
        """Return the detections of an agent's next sweep in ``level``, and what fusion is given of it.

        Raises:
            ValueError: a number of the sweep or of the estimate is out of range.
        """
        sweep, pose = leveled.sweep, leveled.world_from_level
        agent = self._agent(sweep.agent)
        t_s = agent.last_s + PERIOD_S if sweep.t_ns is None else sweep.t_ns / 1e9
        agent.last_s = t_s

        # 1. What the detector finds, in the frame of the tracks.
        detections = self._detector.detect(leveled)
        if self._tamper is not None:
            detections = self._tamper(leveled, detections)
        tracks_from_level = Rigid.identity() if pose is None else pose
        found = detections.moved(tracks_from_level)
        # 2. Tracks, by what the beams of this sweep could have seen.
        view = BeamView(leveled, t_s)
        tracks = agent.tracker.step(t_s, found, view)
        # 3. What the field of view says of them.
        seen = SensorView(
            sweep.agent, view, tracks_from_level.translation[:2], SeenCells.of(estimate), report, tracks_from_level.yaw
        )
        return detections, (tracks, found, (seen,))

    def _agent(self, name: str) -> _Agent:
        agent = self._agents.get(name) or _Agent(SingleFusion(self._model))
        remember(self._agents, name, agent)
        return agent
