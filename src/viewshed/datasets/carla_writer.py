"""The files of a CARLA recording, written tick by tick; what has been written can be read at any time."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np

from viewshed._files import write_atomic
from viewshed.datasets.recordings.carla import POSE_COLUMNS, rotation_of_carla
from viewshed.io import write_sweep
from viewshed.sweep import Sweep


@dataclass(frozen=True, slots=True)
class Carrier:
    """What carries an agent's sensor.

    Attributes:
        actor: number of the vehicle, or None for a mast.
        sensor_height_m: height of the sensor above the road.
        beams: arguments of :func:`viewshed.datasets.recordings.carla.lidar_of_carla`.
    """

    actor: int | None
    sensor_height_m: float
    beams: Mapping[str, float | int]


@dataclass(frozen=True, slots=True, eq=False)
class RecordingWriter:
    """Writes one recording, from :meth:`create`."""

    folder: Path
    _open: ExitStack
    _poses: dict[str, IO[str]] = field(default_factory=dict)

    @classmethod
    @contextmanager
    def create(cls, folder: Path) -> Iterator[RecordingWriter]:
        """Give a writer into a new or empty folder, and close its files.

        Raises:
            ValueError: the folder is not empty.
            OSError: it cannot be written.
        """
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise ValueError(f"out must be a new or empty folder, {folder} is not empty")
        with ExitStack() as files:
            yield cls(folder, files)

    def describe(self, town: str, carla: str, step_s: float, carriers: Mapping[str, Carrier]) -> None:
        """Write ``recording.json``: the axes of the points, the town, and the sensor of each agent."""
        agents = {
            agent: {"sensor_height_m": carrier.sensor_height_m, "lidar": dict(carrier.beams)}
            for agent, carrier in carriers.items()
        }
        about = {"axes": "sensor", "town": town, "carla": carla, "step_s": step_s, "agents": agents}
        write_atomic(self.folder / "recording.json", json.dumps(about, indent=1).encode())

    def write(self, agent: str, frame: int, t_ns: int, sweep: Sweep, transform: Any) -> None:
        """Write one sweep, and the ``carla.Transform`` of its sensor as it is."""
        (self.folder / agent).mkdir(exist_ok=True)
        write_sweep(sweep, self.folder / agent / f"{frame:06d}.ply")
        if agent not in self._poses:
            self._poses[agent] = self._file(f"{agent}/poses.csv")
            csv.writer(self._poses[agent]).writerow(POSE_COLUMNS)
        csv.writer(self._poses[agent]).writerow((frame, t_ns, *_numbers(transform)))
        self._poses[agent].flush()

    def write_actors(self, frame: int, t_ns: int, actors: Iterable[Any], agents: Mapping[int | None, str]) -> None:
        """Write the boxes of a tick's ``carla.Actor``s; ``agents`` tells which actor carries which agent."""
        rows = [_actor(actor, agents.get(actor.id)) for actor in actors]
        with (self.folder / "actors.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps({"frame": frame, "t_ns": t_ns, "actors": rows}) + "\n")

    def _file(self, name: str) -> IO[str]:
        return self._open.enter_context((self.folder / name).open("w", encoding="utf-8", newline=""))


def _numbers(transform: Any) -> tuple[float, ...]:
    place, turn = transform.location, transform.rotation
    return place.x, place.y, place.z, turn.roll, turn.pitch, turn.yaw


def _actor(actor: Any, agent: str | None) -> dict[str, Any]:
    """Return one actor as a row: the center of its box in CARLA's world, its turn, half of its size."""
    x, y, z, roll, pitch, yaw = _numbers(actor.get_transform())
    box = actor.bounding_box
    ahead = rotation_of_carla(roll, pitch, yaw) @ np.array([box.location.x, box.location.y, box.location.z])
    center = dict(zip("xyz", (np.array([x, y, z]) + ahead).tolist(), strict=True))
    extent = [box.extent.x, box.extent.y, box.extent.z]
    row = {"id": actor.id, "type": actor.type_id, **center, "roll": roll, "pitch": pitch, "yaw": yaw, "extent": extent}
    return row if agent is None else row | {"agent": agent}
