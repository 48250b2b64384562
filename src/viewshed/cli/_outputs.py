"""Where results go: one name for each sweep, and never over an input.

What ``viewshed estimate`` does with its sweeps, one by one or in batches, and the lines that it tells.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import typer

from viewshed.cli._options import BAD_INPUTS, one_line, timed

if TYPE_CHECKING:
    from viewshed.fov.estimate import FovEstimate, FovEstimator
    from viewshed.preprocess.leveling import LeveledSweep
    from viewshed.sweep import Sweep


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
    read = {os.path.realpath(file) for file in inputs}  # Path.resolve raises where links lead in a circle
    for place in places:
        if os.path.realpath(place) in read:
            raise ValueError(f"{place} is an input and would be replaced; choose another --out")


class Named(NamedTuple):
    """A sweep, the name of its results and the file that it came from."""

    sweep: Sweep
    name: str
    file: Path


@dataclass(slots=True)
class Failures:
    """Tells each failure in a line on standard error, and counts them."""

    count: int = 0

    def tell(self, file: Path, error: Exception) -> None:
        """Tell what went wrong with a file; an error that is no fault of the input is raised."""
        if not isinstance(error, BAD_INPUTS):
            raise error
        self.count += 1
        text = one_line(error)
        typer.echo(f"viewshed: {text if file.name in text else f'{file}: {text}'}", err=True)


@dataclass(slots=True)
class Run:
    """What is done with every sweep.

    Attributes:
        estimator: what looks at it.
        threshold: probability from which a cell counts as visible.
        out: folder of the results.
        results: which of ``RESULTS`` are written.
    """

    estimator: FovEstimator
    threshold: float
    out: Path
    results: tuple[str, ...] = RESULTS
    _warm: bool = field(default=False, init=False)

    def lines(self, sweeps: Iterable[Named], failures: Failures, batch: int = 1) -> Iterator[str]:
        """Yield the summary line of each sweep, one by one and timed, or so many of them together."""
        return self._each(sweeps, failures) if batch == 1 else self._in_batches(sweeps, failures, batch)

    def _each(self, sweeps: Iterable[Named], failures: Failures) -> Iterator[str]:
        for one in sweeps:
            try:
                yield self.one(one.sweep, one.name)
            except BAD_INPUTS as error:
                failures.tell(one.file, error)

    def one(self, sweep: Sweep, name: str) -> str:
        """Write the results of one sweep and return its summary line."""
        if not self._warm:  # the first call loads compiled code, which is no time of the estimator
            self.estimator.estimate(sweep)
            self._warm = True
        return self.write(sweep, name, *timed(self.estimator, sweep))

    def _in_batches(self, sweeps: Iterable[Named], failures: Failures, batch: int) -> Iterator[str]:
        """Estimate in batches and write in threads."""
        from viewshed._jobs import cores
        from viewshed.estimators.batch import in_order

        threads = 1 if "png" in self.results else cores()  # matplotlib is for one thread
        with closing(in_order(self._written, self._estimated(sweeps, failures, batch), batch, threads)) as written:
            for each in written:
                file, told = each.result()
                if isinstance(told, str):
                    yield told
                else:
                    failures.tell(file, told)

    def _estimated(
        self, sweeps: Iterable[Named], failures: Failures, batch: int
    ) -> Iterator[tuple[Named, FovEstimate]]:
        from viewshed.estimators.batch import estimate_all

        taken: deque[Named] = deque()

        def taking() -> Iterator[Sweep]:
            for each in sweeps:
                taken.append(each)
                yield each.sweep

        def failed(error: Exception) -> None:
            failures.tell(taken.popleft().file, error)

        for found in estimate_all(self.estimator, taking(), batch, on_error=failed):
            yield taken.popleft(), found

    def _written(self, estimated: tuple[Named, FovEstimate]) -> tuple[Path, str | Exception]:
        (sweep, name, file), found = estimated
        try:
            return file, self.write(sweep, name, found)
        except BAD_INPUTS as error:
            return file, error

    def write(self, sweep: Sweep, name: str, found: FovEstimate, elapsed_ms: float | None = None) -> str:
        """Write the results of an estimate and return its summary line; without a time it tells none."""
        from viewshed._files import write_atomic
        from viewshed.preprocess.leveling import level

        leveled = level(sweep, self.estimator.grid)
        summary = summary_line(found, self.threshold, elapsed_ms)
        title = f"{name}\n{summary}"
        content = {kind: self._content(kind, found, leveled, title) for kind in self.results}
        for kind, made in content.items():
            write_atomic(self.out / f"{name}.{kind}", made)
        return f"{name}: {summary}{_doubt(sweep, leveled)} → {self.out / name}.{self.results[0]}"

    def _content(self, kind: str, found: FovEstimate, leveled: LeveledSweep, title: str) -> bytes:
        from viewshed.io.export import to_geojson, to_npz

        if kind == "npz":
            return to_npz(found)
        if kind == "geojson":
            return _json(to_geojson(found, self.threshold))
        from viewshed.estimators.unet import LEARNED
        from viewshed.plot import Panel, maps_picture, picture

        drawn = maps_picture if found.method in LEARNED else picture
        return drawn(Panel(found, title, leveled, self.threshold))


def summary_line(found: FovEstimate, threshold: float, elapsed_ms: float | None = None) -> str:
    """Return visible area, shares of hidden and unknown cells, method and time if any, in one line."""
    from viewshed.fov.estimate import CellState

    hidden, unknown = found.share(CellState.HIDDEN), found.share(CellState.UNKNOWN)
    time = "" if elapsed_ms is None else f", {elapsed_ms:.1f} ms"
    return (
        f"visible {found.area_m2(threshold):.0f} m², hidden {hidden:.0%}, unknown {unknown:.0%} "
        f"({found.method}, {found.target.name}{time})"
    )


def _doubt(sweep: Sweep, leveled: LeveledSweep) -> str:
    if len(leveled.points) == 0:
        return f"; no usable return among {len(sweep)} points: nothing is known"
    if leveled.ground.support == 0 and sweep.sensor_height_m is None:
        assumed = f"; ground not seen, sensor taken to be {leveled.sensor_height_m:.2f} m above it"
        return f"{assumed} (give --height, or --file-frame if the file's z points down)"
    return ""


def _json(content: object) -> bytes:
    import json

    return json.dumps(content, allow_nan=False).encode()
