"""SweepSource: the protocol of recordings of other projects, and helpers shared by their readers."""

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
    """Reference to one sweep of a recording: small, hashable and picklable."""

    scene: str  # name of its scene
    index: int  # index in the refs of the scene, from 0
    file: str  # path of its file
    t_ns: int | None = None  # time of the sweep in nanoseconds, or None if unknown
    agent: str = "ego"  # agent that measured it
    sensor: str = "lidar"  # name of the sensor in the recording
    keyframe: bool = True  # whether it is a keyframe (annotated sweep); True if the recording has no keyframes
    key: str = ""  # key of the sweep in the source: a token, a number, positions in a bag


@dataclass(frozen=True, slots=True, eq=False)
class ObjectBox:
    """One annotated object.

    Raises:
        ValueError: a size is not finite and positive.
    """

    # pose of the box: origin at its center, x along its heading, y left, z up; in the sensor's frame instead of the
    # world if the sweep has no pose
    world_from_box: Rigid
    size_m: tuple[float, float, float]  # length (x), width (y) and height (z), meters
    category: str  # category name in the recording
    track: str | None = None  # track id, constant over time, or None
    returns: int | None = None  # number of returns in the box, from the recording, or None

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
    """A recording on disk, read-only and picklable."""

    def scenes(self) -> tuple[str, ...]:
        """Return the names of the scenes, in the recording's order."""
        ...

    def refs(self, scene: str) -> Sequence[SweepRef]:
        """Return the sweeps of a scene in time order, with all agents and sensors merged.

        Raises:
            ValueError: the scene is unknown, or its sweeps cannot be listed.
            OSError: a file of the scene cannot be read.
        """
        ...

    def read(self, ref: SweepRef) -> Sweep:
        """Read a sweep with time, agent and, if in the recording, pose, beam table, sensor height and attitude.

        Raises:
            ValueError: the sweep or its metadata are damaged; one line that names the file.
            OSError: its file cannot be read.
        """
        ...

    def boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        """Return the annotated objects at the time of a sweep, in the world; None if it is not annotated.

        Raises:
            ValueError: the annotations are damaged; one line that names the file.
            OSError: their file cannot be read.
        """
        ...

    def damage(self) -> tuple[str, ...]:
        """Return one line for each problem found on opening that does not belong to a ref."""
        ...

    def notes(self) -> tuple[str, ...]:
        """Return one line for each missing or unsupported part of the recording that is no damage."""
        ...


class RecordingSource(ABC):
    """Base of the readers, a :class:`SweepSource`: errors on reading are one line that names a file."""

    place: Path  # its location
    sweeps: Mapping[str, Sequence[SweepRef]]  # scene → its sweeps, in the order of :meth:`SweepSource.refs`
    problems: Sequence[str] = ()  # the lines of :meth:`SweepSource.damage`; reading may add to them
    remarks: Sequence[str] = ()  # the lines of :meth:`SweepSource.notes`

    @abstractmethod
    def _read(self, ref: SweepRef) -> Sweep:
        """Read a sweep; may raise any exception."""

    def _boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        """Return the annotated objects at the time of a sweep; None if it is not annotated."""
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
        """Read a sweep; errors as :meth:`SweepSource.read`."""
        self._check(ref)
        with errors_with_path(ref.file, self.place.parent):
            return self._read(ref)

    def boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        """Return the annotated objects at the time of a sweep; errors as :meth:`SweepSource.boxes`."""
        self._check(ref)
        with errors_with_path(ref.file, self.place.parent):
            return self._boxes(ref)

    def damage(self) -> tuple[str, ...]:
        """Return one line for each problem found so far that does not belong to a ref."""
        return tuple(self.problems)

    def notes(self) -> tuple[str, ...]:
        """Return one line for each missing or unsupported part of the recording."""
        return tuple(self.remarks)

    def _check(self, ref: SweepRef) -> None:
        refs = self.refs(ref.scene)
        if not 0 <= ref.index < len(refs) or (refs[ref.index].file, refs[ref.index].key) != (ref.file, ref.key):
            raise ValueError(f"ref must be one of {self.place}, got {ref.file}")


@dataclass(frozen=True, slots=True)
class SourceKind:
    """One supported layout of recordings."""

    layout: str  # short description of the layout, for messages
    # yields the parts of a place (itself, or entries of it) with this layout, judged by file names alone
    find: Callable[[Path], Iterable[object]]
    open: Callable[[Path], RecordingSource]  # opens a place; may raise any exception

    def fits(self, place: Path) -> bool:
        """Return whether a folder (or file) has this layout, judged by file names alone."""
        return any(True for _ in self.find(place))


def each_sweep(
    source: SweepSource, scenes: Iterable[str] | None = None, on_damage: Callable[[str, str], None] | None = None
) -> Iterator[tuple[SweepRef, Sweep]]:
    """Yield the sweeps of a recording with their refs, scene by scene, in time order.

    Args:
        source: the recording.
        scenes: which scenes; None is all of them.
        on_damage: called with the scene (or "") and one line for each problem; unreadable sweeps are skipped. None
            raises on the first unreadable sweep and ignores :meth:`SweepSource.damage`.

    Raises:
        ValueError: a sweep is damaged, and ``on_damage`` is None.
        OSError: a file cannot be read, and ``on_damage`` is None.
    """
    if on_damage is not None:
        for problem in source.damage():
            on_damage("", problem)
    for scene in source.scenes() if scenes is None else scenes:
        for ref in _read_or_report(source.refs, scene, scene, on_damage) or ():
            sweep = _read_or_report(source.read, ref, scene, on_damage)
            if sweep is not None:
                yield ref, sweep


def _read_or_report(
    action: Callable[[_A], _R], argument: _A, scene: str, on_damage: Callable[[str, str], None] | None
) -> _R | None:
    try:
        return action(argument)
    except (ValueError, OSError) as error:
        if on_damage is None:
            raise
        on_damage(scene, str(error))
        return None


_MAX_DAMAGE_LINES = 1000
_MAX_NUMBER = 1e12


def note_damage(damage: list[str], problem: str) -> None:
    """Append one line to the damage of a recording; after a thousand lines, a final one says that there is more."""
    if len(damage) < _MAX_DAMAGE_LINES:
        damage.append(one_line(problem))
    elif len(damage) == _MAX_DAMAGE_LINES:
        damage.append(f"there is more damage; only the first {_MAX_DAMAGE_LINES} lines are printed")


@contextmanager
def error_prefix(what: str) -> Iterator[None]:
    """Convert errors raised inside to a one-line ValueError that begins with ``what``."""
    try:
        yield
    except (ValueError, OSError) as error:
        raise ValueError(one_line(f"{what}: {error}")) from error


def numbered(files: Iterable[Path], damage: list[str], how: str = "a number") -> list[Path]:
    """Return files sorted by the number in their names; report files without a number in ``damage``."""
    valid = []
    for file in sorted(files):
        if file.stem.isascii() and file.stem.isdecimal() and len(file.stem) <= 18:
            valid.append(file)
        else:
            note_damage(damage, f"{file}: must be named by {how}; it is left out")
    return sorted(valid, key=lambda file: int(file.stem))


def read_optional(path: Path, read: Callable[[Path], Any], damage: list[str]) -> Any:
    """Return ``read(path)``; None if the file is missing, or damaged (which is reported in ``damage``)."""
    if not path.is_file():
        return None
    try:
        return read(path)
    except (ValueError, OSError) as error:
        note_damage(damage, f"{error}; left out")
        return None


def numbers_in(values: object, count: int, what: str) -> tuple[float, ...]:
    """Convert a list of ``count`` numbers (or numeric texts) from a JSON, YAML or CSV file to floats.

    Raises:
        ValueError: it is not such a list, or a number is not finite or exceeds 10¹²; the message begins with ``what``.

    >>> numbers_in([1, "2.5"], 2, "size")
    (1.0, 2.5)
    """
    if isinstance(values, list | tuple) and len(values) == count:
        try:
            numbers = tuple(float(value) for value in values if isinstance(value, int | float | str))
        except (ValueError, OverflowError):
            numbers = ()
        if len(numbers) == count and all(abs(number) <= _MAX_NUMBER for number in numbers):
            return numbers
    raise ValueError(f"{what} must be {count} finite numbers, got {one_line(values, 60)}")
