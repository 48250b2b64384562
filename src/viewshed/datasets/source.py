"""SweepSource: the role of a recording that somebody else made, read where it lies."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.sweep import Sweep

_A = TypeVar("_A")
_R = TypeVar("_R")


@dataclass(frozen=True, slots=True)
class SweepRef:
    """Where one sweep of a recording is: light, hashable, and fit to travel to other processes.

    Attributes:
        scene: name of the scene that it belongs to.
        index: its place among the refs of the scene, from 0.
        file: the file that holds it, as a path.
        t_ns: time of the sweep in nanoseconds, or None where the recording has none.
        agent: who measured it.
        sensor: the recording's own name of the sensor.
        keyframe: whether the recording marks it as one to annotate; True where it marks none.
        key: how the source finds it again: a token, a number, a topic.
    """

    scene: str
    index: int
    file: str
    t_ns: int | None = None
    agent: str = "ego"
    sensor: str = "lidar"
    keyframe: bool = True
    key: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class ObjectBox:
    """One annotated object.

    Attributes:
        world_from_box: pose of the box's frame: origin at its center, x along its heading, y left, z up. Where the
            sweep has no pose, its sensor's frame stands for the world.
        size_m: its length (x), width (y) and height (z), metres.
        category: what it is, in the recording's own words.
        track: the same for one object over time, or None.

    Raises:
        ValueError: a size is not finite and positive.
    """

    world_from_box: Rigid
    size_m: tuple[float, float, float]
    category: str
    track: str | None = None

    def __post_init__(self) -> None:
        size = np.asarray(self.size_m, np.float64)
        if size.shape != (3,) or not (np.isfinite(size).all() and (size > 0).all()):
            raise ValueError(f"size_m must be three positive numbers, got {self.size_m}")

    @property
    def center(self) -> NDArray[np.float64]:
        """Center of the box in the world, (3,), metres."""
        return self.world_from_box.translation

    @property
    def yaw(self) -> float:
        """Heading of the box in the world, radians, counter-clockwise from x."""
        return self.world_from_box.yaw


class SweepSource(Protocol):
    """A recording on disk. It is never written to, and may be sent to other processes."""

    def scenes(self) -> tuple[str, ...]:
        """Return the names of the scenes, in the recording's order."""
        ...

    def refs(self, scene: str) -> Sequence[SweepRef]:
        """Return the sweeps of a scene in time order; those of several agents or sensors follow each other by time.

        Raises:
            ValueError: there is no such scene, or its files do not tell what sweeps there are.
            OSError: a file of the scene cannot be read.
        """
        ...

    def read(self, ref: SweepRef) -> Sweep:
        """Return a sweep with its time, agent, and, where the recording tells them, pose, beams, height and attitude.

        Raises:
            ValueError: the sweep is damaged, or what the recording says about it is; one line that names the file.
            OSError: its file cannot be read.
        """
        ...

    def boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        """Return the annotated objects at the time of a sweep, in the world; None where nobody annotated it.

        Raises:
            ValueError: the annotations are damaged; one line that names the file.
            OSError: their file cannot be read.
        """
        ...

    def damage(self) -> tuple[str, ...]:
        """Return one line for each thing that was found wrong on opening and that no ref stands for."""
        ...


@dataclass(frozen=True, slots=True)
class SourceKind:
    """One layout that can be opened.

    Attributes:
        layout: what is looked for, in a few words, for messages.
        fits: whether a folder (or file) has this layout, from names alone.
        open: opens it; a ValueError or an OSError of one line where it cannot.
    """

    layout: str
    fits: Callable[[Path], bool]
    open: Callable[[Path], SweepSource]


def each_sweep(
    source: SweepSource,
    scenes: Iterable[str] | None = None,
    on_damage: Callable[[str, str], None] | None = None,
) -> Iterator[tuple[SweepRef, Sweep]]:
    """Yield the sweeps of a recording with their refs, scene by scene, in time order.

    Args:
        source: the recording.
        scenes: which scenes; None is all of them.
        on_damage: is told the scene ("" for none) and one line for whatever cannot be read, and the rest goes on;
            None raises instead.

    Raises:
        ValueError: something is damaged, and nobody is told of it.
        OSError: a file cannot be read, and nobody is told of it.
    """
    if on_damage is not None:
        for problem in source.damage():
            on_damage("", problem)
    for scene in source.scenes() if scenes is None else scenes:
        for ref in _tried(source.refs, scene, scene, on_damage) or ():
            sweep = _tried(source.read, ref, scene, on_damage)
            if sweep is not None:
                yield ref, sweep


def _tried(
    action: Callable[[_A], _R], argument: _A, scene: str, on_damage: Callable[[str, str], None] | None
) -> _R | None:
    try:
        return action(argument)
    except (ValueError, OSError) as error:
        if on_damage is None:
            raise
        on_damage(scene, str(error))
        return None
