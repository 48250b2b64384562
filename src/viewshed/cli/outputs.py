"""Where results go: one name for each sweep, and never over an input."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

RESULTS = ("png", "geojson", "npz")
"""What can be written of an estimate: picture, polygons, arrays."""
_SUFFIXES = (".gz", ".pcd.bin", ".bin", ".pcd", ".ply", ".npy", ".npz", ".feather", ".pcap")


def stem_of(name: str) -> str:
    """Return a file's name without the endings of its format.

    >>> stem_of("a.b.pcd.bin.gz")
    'a.b'
    """
    for suffix in _SUFFIXES:
        if name.lower().endswith(suffix) and len(name) > len(suffix):
            name = name[: -len(suffix)]
    return name


def parse_results(text: str) -> tuple[str, ...]:
    """Return which of ``RESULTS`` are asked for, in their order.

    >>> parse_results("npz,png")
    ('png', 'npz')
    """
    asked = text.split(",")
    for each in asked:
        if each not in RESULTS:
            raise ValueError(f"results must be some of {','.join(RESULTS)}, with commas, got {text!r}")
    return tuple(each for each in RESULTS if each in asked)


def output_names(files: Sequence[Path]) -> list[str]:
    """Return one output name for each file, all different on every file system.

    Files of one name get their folder's before it, then a number.

    >>> output_names([Path("a/x.bin"), Path("b/x.bin"), Path("y.pcd.bin.gz"), Path("b/x.bin")])
    ['a_x', 'b_x', 'y', 'b_x_1']
    """
    stems = [stem_of(file.name) for file in files]
    folded = [stem.casefold() for stem in stems]
    names: list[str] = []
    taken: set[str] = set()
    for file, stem in zip(files, stems, strict=True):
        shared = folded.count(stem.casefold()) > 1 and file.absolute().parent.name
        names.append(free_name(f"{file.absolute().parent.name}_{stem}" if shared else stem, taken))
    return names


def free_name(wanted: str, taken: set[str]) -> str:
    """Return ``wanted``, with a number behind it if it is taken, and take it."""
    name, number = wanted, 0
    while name.casefold() in taken:
        number += 1
        name = f"{wanted}_{number}"
    taken.add(name.casefold())
    return name


def refuse_inputs(places: Iterable[Path], inputs: Iterable[Path]) -> None:
    """Check that no result replaces a file that is read.

    Raises:
        ValueError: one would.
    """
    read = {file.resolve() for file in inputs}
    for place in places:
        if place.resolve() in read:
            raise ValueError(f"{place} is an input and would be replaced; choose another --out")
