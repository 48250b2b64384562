"""Objects in a stream of sweeps: detected, tracked and explained, separately for each agent."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

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
"""Assumed period of sweeps without time stamps."""

Tamper = Callable[[LeveledSweep, Detections], Detections]
"""Attack on the detections of a sweep: returns them as others see them, in its ``level`` frame."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenObjects:
    """Objects of one agent after one sweep."""

    detections: Detections  # of this sweep, in its ``level`` frame
    # all tracks, each with the reason why it is detected or not; in the world, or in ``level`` without poses
    explained: ExplainedTracks
    tracks_from_level: Rigid  # pose of the sweep's ``level`` frame in the frame of the tracks
    ground: HeightMap | None = None  # heights of the ground about the sensor, in ``level``
    seconds: float = 0.0  # run time of detection, tracking and explanation

    @property
    def shown(self) -> NDArray[np.bool_]:
        """(N,) bool, tracks shown to others: confirmed, and either still held by the tracker or accused."""
        return self.explained.tracks.confirmed & (~self.explained.held | self.explained.accused)


@dataclass(slots=True, eq=False)
class _Agent:
    fusion: SingleFusion
    tracker: Tracker = field(default_factory=Tracker)
    last_s: float = -PERIOD_S
    explained: ExplainedTracks | None = None  # after its last sweep


class ObjectStream:
    """Detects, tracks and explains the objects of several agents, sweep by sweep.

    >>> from viewshed import load_estimator, read_sweep
    >>> from viewshed.io.samples import junction_path
    >>> from viewshed.preprocess.leveling import level
    >>> estimator, objects = load_estimator("shadow_map"), ObjectStream()
    >>> leveled = level(read_sweep(junction_path()), estimator.grid)
    >>> seen = objects.follow(leveled, estimator.estimate(leveled))
    >>> len(seen.detections) > 5, len(seen.explained) == len(seen.explained.reasons)
    (True, True)

    Args:
        detector: of objects; None is the default one.
        tamper: attack on the detections, for experiments; None for none.
        model: evidence model for this detector; None is the shipped one.
        clock: for run times.

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
        self._agent("")  # raise now if scipy is not installed
        self.reset()

    def fresh(self) -> ObjectStream:
        """Return a stream with the same settings and no tracks."""
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
            estimate: its field of view.
            report: of its monitor; tracks in sectors under alarm are not judged.

        Raises:
            ValueError: a number of the sweep or of the estimate is out of range.
        """
        start_s = self._clock()
        detections, (tracks, moved_detections, views) = self.observe(leveled, estimate, report)
        # 4. Explain why each track is detected or not; a late sweep, which the tracker leaves out, explains nothing.
        agent = self._agent(leveled.sweep.agent)
        if agent.explained is not None and tracks.t_s > agent.last_s:
            explained = replace(agent.explained, tracks=replace(agent.explained.tracks, notes=tracks.notes))
        else:
            explained = agent.explained = agent.fusion.explain(tracks, moved_detections, views)
        pose = leveled.world_from_level or Rigid.identity()
        return SeenObjects(detections, explained, pose, leveled.ground, self._clock() - start_s)

    def observe(
        self, leveled: LeveledSweep, estimate: FovEstimate, report: IntegrityReport | None = None
    ) -> tuple[Detections, Observed]:
        """Return the detections of an agent's next sweep in ``level``, and the input of fusion.

        Raises:
            ValueError: a number of the sweep or of the estimate is out of range.
        """
        sweep, pose = leveled.sweep, leveled.world_from_level
        agent = self._agent(sweep.agent)
        t_s = agent.last_s + PERIOD_S if sweep.t_ns is None else sweep.t_ns / 1e9
        agent.last_s = t_s

        # 1. Detect objects, in the frame of the tracks.
        detections = self._detector.detect(leveled)
        if self._tamper is not None:
            detections = self._tamper(leveled, detections)
        tracks_from_level = Rigid.identity() if pose is None else pose
        moved_detections = detections.moved(tracks_from_level)
        # 2. Track by what the beams of this sweep could have seen.
        view = BeamView(leveled, t_s)
        tracks = agent.tracker.step(t_s, moved_detections, view)
        # 3. Build the field of view for fusion.
        sensor_view = SensorView(
            sweep.agent, view, tracks_from_level.translation[:2], SeenCells.of(estimate), report, tracks_from_level.yaw
        )
        return detections, (tracks, moved_detections, (sensor_view,))

    def _agent(self, name: str) -> _Agent:
        agent = self._agents.get(name) or _Agent(SingleFusion(self._model))
        remember(self._agents, name, agent)
        return agent
