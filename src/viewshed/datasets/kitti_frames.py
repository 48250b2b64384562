"""What KITTI's three layouts share: sweeps named by numbers, and lines of text files that belong to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from viewshed.datasets.number_text import numbers_of, text_lines
from viewshed.datasets.source import SweepRef
from viewshed.geometry import Rigid
from viewshed.io import read_sweep
from viewshed.sweep import Sweep

SENSOR = "hdl64e"
"""Beam table of KITTI's LiDAR."""
SENSOR_HEIGHT_M = 1.73
"""Height of the LiDAR above the ground (https://www.cvlibs.net/datasets/kitti/setup.php)."""


def sweep_files(folder: Path, damage: list[str]) -> list[Path]:
    """Return the ``.bin`` files of a folder by their numbers; others are told in ``damage``."""
    files = sorted(folder.glob("*.bin"))
    damage.extend(f"{file}: must be named by a number; it is left out" for file in files if not file.stem.isdecimal())
    return sorted((file for file in files if file.stem.isdecimal()), key=lambda file: int(file.stem))


def timed_refs(scene: str, files: Sequence[Path], times: Sequence[int | None]) -> tuple[SweepRef, ...]:
    """Return the refs of a scene; in the order of their times where all have one, else of their numbers."""
    refs = [SweepRef(scene, 0, str(file), t_ns, sensor="velodyne", key=file.stem)
            for file, t_ns in zip(files, times, strict=True)]  # fmt: skip
    if None not in times:
        refs.sort(key=lambda ref: ref.t_ns or 0)
    return tuple(replace(ref, index=index) for index, ref in enumerate(refs))


def times_of(place: Path, files: Sequence[Path], damage: list[str], *, seconds: bool) -> list[int | None]:
    """Return the time of each file, nanoseconds: the line of its number, or its own where there is one a file.

    Args:
        place: the text file; what is missing or wrong in it is told in ``damage``, and that time is None.
        files: the sweeps.
        damage: lines are added to it.
        seconds: whether the lines are seconds; else they are dates, taken as UTC.
    """
    try:
        lines = text_lines(place)
    except (ValueError, OSError) as error:
        damage.append(f"{error}; the sweeps have no times")
        return [None] * len(files)
    numbers = [int(file.stem) for file in files]
    if numbers and numbers[-1] >= len(lines) == len(files):
        numbers = list(range(len(files)))
    times: list[int | None] = []
    for number in numbers:
        try:
            text = line_of(lines, number, place)
            times.append(_seconds_ns(text, f"{place}, line {number + 1}") if seconds else _date_ns(text, place))
        except ValueError as error:
            damage.append(f"{error}; that sweep has no time")
            times.append(None)
    _tell_order(times, place, damage)
    return times


def _tell_order(times: Sequence[int | None], place: Path, damage: list[str]) -> None:
    known = [t_ns for t_ns in times if t_ns is not None]
    back = next((late for late, early in zip(known[1:], known, strict=False) if late <= early), None)
    if back is not None:
        damage.append(f"{place}: times must ascend, {back} ns is not after the one before; sweeps are sorted by time")


def line_of(lines: Sequence[str], number: int, place: Path) -> str:
    """Return one line of a file.

    Raises:
        ValueError: it has no such line.
    """
    if number >= len(lines):
        raise ValueError(f"{place}: has {len(lines)} lines, none for sweep {number}")
    return lines[number]


def _seconds_ns(text: str, where: str) -> int:
    return round(float(numbers_of(text, 1, where)[0]) * 1e9)


def _date_ns(text: str, place: Path) -> int:
    """Return nanoseconds since 1970 of ``2011-09-26 13:02:25.964389445``."""
    date, _, fraction = text.strip().partition(".")
    try:
        seconds = int(datetime.fromisoformat(date).replace(tzinfo=UTC).timestamp())
        return seconds * 1_000_000_000 + int(fraction[:9].ljust(9, "0"))
    except ValueError as error:
        raise ValueError(f"{place}: must be dates and times, got {text[:40]!r}") from error


def read_frame(ref: SweepRef, pose: Rigid | None) -> Sweep:
    """Return the sweep of a ref with KITTI's beams and height.

    Raises:
        ValueError: it is damaged.
        OSError: its file cannot be read.
    """
    sweep = read_sweep(ref.file, format="kitti", sensor=SENSOR, sensor_height_m=SENSOR_HEIGHT_M, world_from_sensor=pose)
    return sweep if ref.t_ns is None else sweep.replace(t_ns=ref.t_ns)


def found(scenes: dict[str, tuple[SweepRef, ...]], scene: str) -> tuple[SweepRef, ...]:
    """Return the refs of a scene.

    Raises:
        ValueError: there is no such scene.
    """
    if scene not in scenes:
        raise ValueError(f"scene must be one of {', '.join(scenes)[:200]}, got {scene!r}")
    return scenes[scene]
