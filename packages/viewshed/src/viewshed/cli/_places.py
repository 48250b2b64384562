"""Resolve command-line paths: files, patterns, folders of sweeps and recordings; and paths of results."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from glob import glob
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from viewshed._files import by_numbers
from viewshed.cli._terminal import note

if TYPE_CHECKING:
    from viewshed.io import IndexEntry

_MAX_FOLDERS = 200
"""Maximum number of subfolders searched for a hint where sweeps are."""

_PATTERN = re.compile(r"[*?\[]")
_ADDRESS = re.compile(r"[a-z][a-z0-9+.-]+:/", re.IGNORECASE)
"""Start of a URL such as ``s3://bucket/sweeps`` after conversion to a path, which keeps one slash."""


def chosen_files(files: list[Path], index: Path | None) -> Iterator[tuple[Path, IndexEntry | None]]:
    """Yield each file with its index entry; without files, all sweeps of the index."""
    if index is None:
        if not files:
            raise ValueError("give at least one FILE, or an --index")
        yield from ((file, None) for place in files for file in files_in(place))
        return
    from viewshed.io import read_index

    entries = {entry.file: entry for entry in read_index(index)}
    if not files:
        named = [(file, entry) for file, entry in entries.items() if entry.points]
        if not named:
            raise ValueError(
                f"{index} must name a sweep, got none: the entry of a sweep has a number of points in its stats"
            )
        yield from named
    for file in files:
        entry = entries.get(Path(os.path.realpath(file)))
        if entry is None:
            raise ValueError(f"{file} is not in the index {index}")
        yield file, entry


def files_in(place: Path) -> list[Path]:
    """Return the files and recordings at a path, in the order of the numbers in their names.

    A pattern is expanded; a folder of sweeps gives its sweeps and bags; any other path is returned itself.
    """
    if _PATTERN.search(str(place)) and not place.exists():
        matches = sorted((Path(name) for name in glob(str(place), recursive=True)), key=by_numbers)  # noqa: PTH207
        if not matches:
            raise ValueError(f"no file matches {place}")
        return [file for match in matches for file in files_in(match)]
    if _ADDRESS.match(str(place)) and not place.exists():
        raise ValueError(
            f"{str(place).replace(':/', '://', 1)} must be a file or a folder, got a URL; copy its content to this"
            " machine first"
        )
    return _files_of_folder(place) if place.is_dir() else [place]


def _files_of_folder(folder: Path) -> list[Path]:
    """Return the sweeps and bags in a folder, or the folder itself if it is a recording."""
    from viewshed.io.formats import BAG_SUFFIXES, all_formats
    from viewshed.recordings.read import SOURCES
    from viewshed.recordings.recording import is_data_set

    if is_data_set(folder):
        return [folder]
    plain = tuple(dict.fromkeys(suffix for known in all_formats().values() for suffix in known.suffixes))
    endings = tuple(suffix + packed for suffix in plain for packed in ("", ".gz"))
    content = sorted(folder.iterdir(), key=by_numbers)
    sweeps = [file for file in content if file.name.lower().endswith(endings) and file.is_file()]
    layout = next((name for name, known in SOURCES.items() if known.fits(folder)), None)
    if layout is not None and not (layout == "bag" and sweeps):
        return [folder]
    if sweeps:
        files = [file for file in content if file in sweeps or file.name.lower().endswith(BAG_SUFFIXES)]
        folders = sum(1 for file in content if file.is_dir())
        if folders:
            note(f"{folder}: {len(files)} files are read, {folders} folders in it are not")
        return files
    inner = next((path for path in islice(_folders_in(folder), _MAX_FOLDERS) if _holds_sweeps(path, endings)), None)
    hint = f"; {inner} has some" if inner is not None else f"; sweeps end in {', '.join(plain)}"
    layouts = ", ".join(SOURCES)
    raise ValueError(f"{folder} is a folder without sweeps and no recording ({layouts}){hint}")


def _folders_in(folder: Path) -> Iterator[Path]:
    """Yield all folders below a folder by name; symbolic links are not followed."""
    for here, inner, _ in os.walk(folder):
        inner.sort()
        yield Path(here)


def _holds_sweeps(folder: Path, endings: tuple[str, ...]) -> bool:
    try:
        return any(file.name.lower().endswith(endings) for file in folder.iterdir())
    except OSError:
        return False


def place_of_result(out: str | None, name: str) -> Path:
    """Return the path of a single result: the file ``out``, or ``name`` in the folder ``out`` or the current one.

    ``out`` with a suffix is a file. Otherwise it is a folder, as for commands with several results, and is created.

    >>> place_of_result(None, "a.geojson").name, place_of_result("b.json", "a.geojson").name
    ('a.geojson', 'b.json')
    """
    if out is None:
        return Path(name)
    place = Path(out)
    if place.exists() and not place.is_dir():
        return place
    if out.endswith(("/", os.sep)) or not place.suffix:
        place.mkdir(parents=True, exist_ok=True)
    if place.is_dir():
        return place / name
    if name.endswith(".png") and place.suffix.lower() != ".png":
        raise ValueError(f"--out must be a folder or a file NAME.png, got {out}")
    return place
