"""SweepSource: the role of a recording that somebody else made, read where it lies; and what its readers share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.io._input import errors_with_path, one_line
from viewshed.sweep import Sweep

_A = TypeVar("_A")
_R = TypeVar("_R")


@dataclass(frozen=True, slots=True)
class SweepRef:
    """Where one sweep of a recording is: light, hashable, and fit to travel to other processes."""

    scene: str  # name of the scene that it belongs to
    index: int  # its place among the refs of the scene, from 0
    file: str  # the file that holds it, as a path
    t_ns: int | None = None  # time of the sweep in nanoseconds, or None where the recording has none
    agent: str = "ego"  # who measured it
    sensor: str = "lidar"  # the recording's own name of the sensor
    keyframe: bool = True  # whether the recording marks it as one to annotate; True where it marks none
    key: str = ""  # how the source finds it again: a token, a number, a topic


@dataclass(frozen=True, slots=True, eq=False)
class ObjectBox:
    """One annotated object.

    Raises:
        ValueError: a size is not finite and positive.
    """

    # pose of the box's frame: origin at its center, x along its heading, y left, z up. Where the sweep has no pose, its
    # sensor's frame stands for the world.
    world_from_box: Rigid
    size_m: tuple[float, float, float]  # its length (x), width (y) and height (z), meters
    category: str  # what it is, in the recording's own words
    track: str | None = None  # the same for one object over time, or None
    returns: int | None = None  # of the sweep in the box, as the recording counts them; None where it does not

    def __post_init__(self) -> None:
        size = np.asarray(self.size_m, np.float64)
        if size.shape != (3,) or not (np.isfinite(size).all() and (size > 0).all()):
            raise ValueError(f"size_m must be three positive numbers, got {self.size_m}")

    @property
    def center(self) -> NDArray[np.float64]:
        """Center of the box in the world, (3,), meters."""
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

    def notes(self) -> tuple[str, ...]:
        """Return one line for each thing that the recording lacks, or that is not read, without being damaged."""
        ...


class RecordingSource(ABC):
    """An opened recording as a :class:`SweepSource`: whatever reading raises is one line that names a file."""

    place: Path  # where it lies
    sweeps: Mapping[str, Sequence[SweepRef]]  # scene → its sweeps, in the order of :meth:`SweepSource.refs`
    problems: Sequence[str] = ()  # the lines of :meth:`SweepSource.damage`; reading may add to them
    remarks: Sequence[str] = ()  # the lines of :meth:`SweepSource.notes`

    @abstractmethod
    def _read(self, ref: SweepRef) -> Sweep:
        """Return a sweep; errors may be of any type."""

    def _boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        """Return the annotated objects at the time of a sweep; None where nobody annotated it."""
        return None

    def scenes(self) -> tuple[str, ...]:
        """Return the names of the scenes, in the recording's order."""
        return tuple(self.sweeps)

    def refs(self, scene: str) -> Sequence[SweepRef]:
        """Return the sweeps of a scene; errors as :meth:`SweepSource.refs`."""
        if scene not in self.sweeps:
            names = one_line(", ".join(self.sweeps), 200)
            raise ValueError(f"{self.place}: scene must be one of {names}, got {scene!r}")
        return self.sweeps[scene]

    def read(self, ref: SweepRef) -> Sweep:
        """Return a sweep; errors as :meth:`SweepSource.read`."""
        self._check(ref)
        with errors_with_path(ref.file, self.place.parent):
            return self._read(ref)

    def boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        """Return the annotated objects at the time of a sweep; errors as :meth:`SweepSource.boxes`."""
        self._check(ref)
        with errors_with_path(ref.file, self.place.parent):
            return self._boxes(ref)

    def damage(self) -> tuple[str, ...]:
        """Return one line for each thing that was found wrong so far and that no ref stands for."""
        return tuple(self.problems)

    def notes(self) -> tuple[str, ...]:
        """Return one line for each thing that the recording lacks, or that is not read."""
        return tuple(self.remarks)

    def _check(self, ref: SweepRef) -> None:
        refs = self.refs(ref.scene)
        if not 0 <= ref.index < len(refs) or (refs[ref.index].file, refs[ref.index].key) != (ref.file, ref.key):
            raise ValueError(f"ref must be one of {self.place}, got {ref.file}")


@dataclass(frozen=True, slots=True)
class SourceKind:
    """One layout that can be opened."""

    layout: str  # what is looked for, in a few words, for messages
    # yields the parts of a place (itself, or what lies in it) that have this layout, from names alone
    find: Callable[[Path], Iterable[object]]
    open: Callable[[Path], RecordingSource]  # opens a place; whatever it raises says why it cannot

    def fits(self, place: Path) -> bool:
        """Return whether a folder (or file) has this layout, from names alone."""
        return any(True for _ in self.find(place))


def each_sweep(
    source: SweepSource, scenes: Iterable[str] | None = None, on_damage: Callable[[str, str], None] | None = None
) -> Iterator[tuple[SweepRef, Sweep]]:
    """Yield the sweeps of a recording with their refs, scene by scene, in time order.

    Args:
        source: the recording.
        scenes: which scenes; None is all of them.
        on_damage: called with the scene ("" for none) and one line for whatever cannot be read, and the rest goes on;
            None raises where a sweep cannot, and passes over :meth:`SweepSource.damage`.

    Raises:
        ValueError: a sweep is damaged, and ``on_damage`` is None.
        OSError: a file cannot be read, and ``on_damage`` is None.
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


_DAMAGE_LINES_MAX = 1000
_NUMBER_MAX = 1e12


def note_damage(damage: list[str], problem: str) -> None:
    """Add one line to a recording's damage; after the first thousand, only that there is more."""
    if len(damage) < _DAMAGE_LINES_MAX:
        damage.append(one_line(problem))
    elif len(damage) == _DAMAGE_LINES_MAX:
        damage.append(f"there is more damage; only the first {_DAMAGE_LINES_MAX} lines are named")


@contextmanager
def problems_of(what: str) -> Iterator[None]:
    """Begin what is wrong inside with the name of what it is about."""
    try:
        yield
    except (ValueError, OSError) as error:
        raise ValueError(one_line(f"{what}: {error}")) from error


def numbered(files: Iterable[Path], damage: list[str], how: str = "a number") -> list[Path]:
    """Return files in the order of the numbers that they are named by; others are named in ``damage``."""
    found = []
    for file in sorted(files):
        if file.stem.isascii() and file.stem.isdecimal() and len(file.stem) <= 18:
            found.append(file)
        else:
            note_damage(damage, f"{file}: must be named by {how}; it is left out")
    return sorted(found, key=lambda file: int(file.stem))


def read_optional(path: Path, read: Callable[[Path], Any], damage: list[str]) -> Any:
    """Return what ``read`` says of a file; None where it is not there, or where it is damaged, with a line."""
    if not path.is_file():
        return None
    try:
        return read(path)
    except (ValueError, OSError) as error:
        note_damage(damage, f"{error}; left out")
        return None


def numbers_in(values: object, count: int, what: str) -> tuple[float, ...]:
    """Return a list of ``count`` numbers (or texts of numbers) of a JSON, YAML or CSV file as floats.

    Raises:
        ValueError: it is something else, or one is not finite or beyond 10¹²; the message begins with ``what``.

    >>> numbers_in([1, "2.5"], 2, "size")
    (1.0, 2.5)
    """
    if isinstance(values, list | tuple) and len(values) == count:
        try:
            numbers = tuple(float(value) for value in values if isinstance(value, int | float | str))
        except (ValueError, OverflowError):
            numbers = ()
        if len(numbers) == count and all(abs(number) <= _NUMBER_MAX for number in numbers):
            return numbers
    raise ValueError(f"{what} must be {count} finite numbers, got {one_line(values, 60)}")
