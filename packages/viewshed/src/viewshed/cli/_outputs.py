"""Results of commands: unique output names, never over an input, progress bars and summary lines.

:class:`Run` is the loop of ``viewshed estimate`` over its sweeps, one by one or in batches.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from viewshed.cli._terminal import BAD_INPUTS, complain, note, one_line, raise_if_interrupted
from viewshed.cli._verdicts import stream_verdicts

if TYPE_CHECKING:
    from rich.progress import Progress, ProgressColumn

    from viewshed.estimators import Estimator
    from viewshed.fov.estimate import FovEstimate
    from viewshed.guarantees.envelope import Threat
    from viewshed.monitor import StreamMonitor
    from viewshed.preprocess.leveling import LeveledSweep
    from viewshed.sweep import Sweep

T = TypeVar("T")

RESULTS = ("png", "geojson", "npz")
"""Default results of an estimate: picture, polygons, arrays. Other formats of ``EXPORTERS`` only on request."""

_SUFFIXES = (
    ".gz", ".zst", ".zstd", ".pcd.bin", ".bin", ".pcd", ".ply", ".npy", ".npz", ".feather", ".pcap", ".bag", ".mcap",
    ".db3", ".las", ".laz", ".csv", ".xyz", ".asc",
)  # fmt: skip


def stem_of(name: str) -> str:
    """Return a file's name without the suffixes of its format.

    >>> stem_of("a.b.pcd.bin.gz")
    'a.b'
    """
    for suffix in _SUFFIXES:
        if name.lower().endswith(suffix) and len(name) > len(suffix):
            name = name[: -len(suffix)]
    return name


def parse_results(text: str, known: Sequence[str] = ()) -> tuple[str, ...]:
    """Parse the requested results, in the order of ``known``: by default ``png`` and the formats of ``EXPORTERS``.

    >>> parse_results("npz,png")
    ('png', 'npz')
    """
    from viewshed.io.export import EXPORTERS

    requested, known = text.split(","), known or tuple(dict.fromkeys((*RESULTS, *EXPORTERS)))
    for name in requested:
        if name not in known:
            raise ValueError(f"results must be some of {','.join(known)}, separated by commas, got {text!r}")
    return tuple(name for name in known if name in requested)


def make_folder(out: Path) -> None:
    """Create the folder of the results."""
    from viewshed.io.export import EXPORTERS

    if out.exists() and not out.is_dir():
        raise ValueError(f"--out must be a folder, got the file {out}")
    endings = {".png", *(exporter.suffix for exporter in EXPORTERS.values())}
    if not out.exists() and out.suffix and out.name.endswith(tuple(endings)):
        raise ValueError(
            f"--out must be a folder for the results, got the name of a file, {out}; leave out {out.suffix}"
        )
    out.mkdir(parents=True, exist_ok=True)


def stem_of_result(name: str, method: str) -> str:
    """Return the file name, without suffix, of a sweep's results: the method is appended unless it is the default.

    >>> stem_of_result("a", "shadow_map"), stem_of_result("a", "unet")
    ('a', 'a_unet')
    """
    from viewshed.estimators import DEFAULT_ESTIMATOR

    return name if method == DEFAULT_ESTIMATOR else f"{name}_{method}"


def output_names(files: Sequence[Path]) -> list[str]:
    """Return one output name for each file; names differ even on file systems that ignore case.

    Files with the same name are prefixed with the name of their folder, then numbered.

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


def free_name(preferred: str, taken: set[str]) -> str:
    """Return ``preferred``, with a number appended if it is taken, and add it to ``taken``."""
    name, number = preferred, 0
    while name.casefold() in taken:
        number += 1
        name = f"{preferred}_{number}"
    taken.add(name.casefold())
    return name


def refuse_inputs(places: Iterable[Path], inputs: Iterable[Path]) -> None:
    """Check that no result would overwrite an input."""
    read = {os.path.realpath(file) for file in inputs}  # Path.resolve raises on circular links
    for place in places:
        if os.path.realpath(place) in read:
            raise ValueError(f"{place} is an input and would be replaced; choose another place")


class Named(NamedTuple):
    """A sweep, the name of its results, its file and its scene; sweeps of another scene are another stream."""

    sweep: Sweep
    name: str
    file: Path
    scene: str = ""


NO_TIMES = "the files have no times, so each is judged alone; give --poses, which adds order and times, or a recording"


@dataclass(slots=True)
class Streams:
    """Tells with which sweeps a new stream begins."""

    is_judged: bool = False  # by a stream monitor: note once that it judges sweeps without times alone
    _scene: str = field(default="", init=False)
    _alone: int = field(default=0, init=False)

    def begins(self, scene: str, sweep: Sweep) -> bool:
        """Return whether the next sweep begins a new stream because it is of another scene."""
        if scene == self._scene:
            return False
        self._scene, self._alone = scene, self._alone + (sweep.t_ns is None)
        if self.is_judged and sweep.t_ns is None and self._alone == 2:
            note(NO_TIMES)
        return True


@dataclass(slots=True)
class Failures:
    """Prints each failure as a line on standard error, and counts them."""

    count: int = 0
    _reported: set[str] = field(default_factory=set, init=False)

    def report(self, file: Path | str, error: Exception) -> None:
        """Report a failure with a file; raise errors that are not caused by bad input."""
        raise_if_interrupted()
        if not isinstance(error, BAD_INPUTS):
            raise error
        self.count += 1
        text = one_line(error)
        line = text if Path(file).name in text else f"{file}: {text}"
        if line not in self._reported:  # print a problem of all sweeps of a file once
            self._reported.add(line)
            complain(line)


def progress_bar(*columns: ProgressColumn | str, transient: bool = False) -> Progress:
    """Return a progress bar on standard error with description, counts, and then ``columns``."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    begin = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    to_terminal = sys.stdout.isatty()  # print lines above the bar only if stdout is the terminal too
    return Progress(*begin, *columns, console=Console(stderr=True), transient=transient, redirect_stdout=to_terminal)


def with_bar(items: Iterable[T], count: int) -> Iterator[T]:
    """Yield the items, with a progress bar if there are several and standard error is a terminal."""
    if count < 2 or not sys.stderr.isatty():
        yield from items
        return
    with progress_bar(transient=True) as bar:
        yield from bar.track(items, total=count, description="sweeps")


@dataclass(slots=True)
class Run:
    """Processes every sweep: estimates, checks, certifies and writes the results."""

    estimator: Estimator
    threshold: float  # probability from which a cell counts as visible
    out: Path  # folder of the results
    results: tuple[str, ...] = RESULTS  # results to write: ``png`` or names of ``EXPORTERS``
    monitor: StreamMonitor | None = None  # checks each sweep, or None
    crs: str | None = None  # reference system of the poses, for formats that have one, or None
    dark: bool = False  # whether pictures have a dark background
    certify: Threat | None = None  # threat for which claims are certified, or None
    _is_warm: bool = field(default=False, init=False)

    def summaries(self, sweeps: Iterable[Named], failures: Failures, batch: int = 1) -> Iterator[Summary]:
        """Yield the summary of each sweep: one by one and timed, or in batches and not timed."""
        if batch > 1:
            yield from self._in_batches(sweeps, failures, batch)
            return
        streams = Streams(is_judged=self.monitor is not None)
        for named in sweeps:
            if streams.begins(named.scene, named.sweep):
                self._begin_anew()
            try:
                yield self.one(named.sweep, named.name)
            except BAD_INPUTS as error:
                failures.report(named.file, error)

    def _begin_anew(self) -> None:
        """Forget the earlier sweeps: the next one begins a new stream."""
        from viewshed.estimators.temporal import TemporalEstimator

        if isinstance(self.estimator, TemporalEstimator):
            self.estimator.reset()
        if self.monitor is not None:
            self.monitor.reset()

    def places(self, name: str) -> list[Path]:
        """Return the result files of a sweep in the order of ``results``, without the images of nav2 maps."""
        from viewshed.io.export import EXPORTERS

        stem = stem_of_result(name, self.estimator.name)
        ends = [".png" if kind == "png" else EXPORTERS[kind].suffix for kind in self.results]
        return [self.out / f"{stem}{end}" for end in ends]

    def one(self, sweep: Sweep, name: str) -> Summary:
        """Level one sweep, estimate, write the results, and return the summary."""
        from viewshed.io.export.crs import crs_named
        from viewshed.preprocess.leveling import level

        if self.crs is not None:
            crs_named(self.crs, sweep.world_from_sensor)
        if not self._is_warm:
            warm_up(self.estimator, sweep)
            self._is_warm = True
        start = time.perf_counter()
        leveled = level(sweep, self.estimator.grid)
        estimate = self.estimator.estimate(leveled)
        elapsed_ms = 1e3 * (time.perf_counter() - start)
        summary = self.write(leveled, name, estimate, elapsed_ms)
        if self.monitor is None:
            return summary
        return replace(summary, verdicts=stream_verdicts(self.monitor.check(leveled)))

    def together(self, sweeps: Iterable[Named], name: str) -> Iterator[Summary]:
        """Yield one summary of all sweeps of a vehicle, if there are any; the picture shows the first one's returns."""
        from viewshed.fov.union import union_of_views
        from viewshed.preprocess.leveling import level

        named = list(sweeps)
        if not named:
            return
        leveled = [level(one.sweep, self.estimator.grid) for one in named]
        for one, sweep in zip(named[1:], leveled[1:], strict=True):
            report_doubts(sweep, one.name)
        estimate = union_of_views([self.estimator.estimate(sweep) for sweep in leveled])
        yield self.write(leveled[0], name, replace(estimate, method=f"{estimate.method} of {len(named)} sensors"))

    def _in_batches(self, sweeps: Iterable[Named], failures: Failures, batch: int) -> Iterator[Summary]:
        """Estimate in batches and write in threads."""
        from viewshed.estimators.batch import cores, in_order

        with closing(in_order(self._written, self._estimated(sweeps, failures, batch), batch, cores())) as written:
            for done in written:
                file, summary = done.result()
                if isinstance(summary, Summary):
                    yield summary
                else:
                    failures.report(file, summary)

    def _estimated(
        self, sweeps: Iterable[Named], failures: Failures, batch: int
    ) -> Iterator[tuple[Named, FovEstimate]]:
        from viewshed.estimators.batch import estimate_all

        taken: deque[Named] = deque()

        def taking() -> Iterator[Sweep]:
            for named in sweeps:
                taken.append(named)
                yield named.sweep

        def on_error(error: Exception) -> None:
            failures.report(taken.popleft().file, error)

        for estimate in estimate_all(self.estimator, taking(), batch, on_error=on_error):
            yield taken.popleft(), estimate

    def _written(self, estimated: tuple[Named, FovEstimate]) -> tuple[Path, Summary | Exception]:
        from viewshed.preprocess.leveling import level

        named, estimate = estimated
        try:
            return named.file, self.write(level(named.sweep, self.estimator.grid), named.name, estimate)
        except BAD_INPUTS as error:
            return named.file, error

    def write(
        self, leveled: LeveledSweep, name: str, estimate: FovEstimate, elapsed_ms: float | None = None
    ) -> Summary:
        """Write the results of an estimate and return its summary."""
        from viewshed._files import write_atomic
        from viewshed.io.export import EXPORTERS, write_export

        report_doubts(leveled, name)
        estimate = replace(estimate, threshold=self.threshold)
        certified: tuple[str, ...] = ()
        if self.certify is not None:
            from viewshed.guarantees.certificate import certify

            certificate = certify(leveled, estimate, self.certify)
            estimate, certified = certificate.withdraw(estimate), (certificate.line,)
        places = self.places(name)
        remarks = (*certified, *_remarks(leveled, estimate))
        summary = Summary(name, estimate, elapsed_ms, tuple(places), remarks)
        for kind, place in zip(self.results, places, strict=True):
            if kind == "png":
                write_atomic(place, estimate.plot(leveled, f"{name}\n{summary_line(estimate, elapsed_ms)}", self.dark))
            else:
                write_export(estimate, kind, place, crs=self.crs if EXPORTERS[kind].has_crs else None)
        return summary


def warm_up(estimator: Estimator, sweep: Sweep) -> None:
    """Run the estimator once on every eighth return, so that printed times do not include loading of code.

    The time stamp is removed, so that an estimator with a history does not remember the sweep.
    """
    import numpy as np

    estimator.estimate(sweep.select(np.arange(0, len(sweep), 8)).replace(t_ns=None))


def report_doubts(leveled: LeveledSweep, name: str) -> None:
    """Print a warning on standard error for each implausible property of a sweep."""
    from viewshed.preprocess.plausibility import check_units, doubts

    check_units(leveled.sweep)
    for doubt in doubts(leveled):
        complain(f"{name}: warning: {doubt}")


def summary_line(estimate: FovEstimate, elapsed_ms: float | None = None) -> str:
    """Return one line with visible area, shares of hidden and unknown cells, method and time (if known)."""
    from viewshed.fov.estimate import CellState

    hidden, unknown = estimate.share(CellState.HIDDEN), estimate.share(CellState.UNKNOWN)
    elapsed = "" if elapsed_ms is None else f", {elapsed_ms:.0f} ms"
    target = "" if estimate.target.name == "car" else f", {estimate.target.name}"
    return (
        f"visible {estimate.area_m2():.0f} m², hidden {hidden:.0%}, unknown {unknown:.0%}"
        f" ({estimate.method}{target}{elapsed})"
    )


@dataclass(frozen=True, slots=True)
class Summary:
    """Summary of one sweep."""

    name: str  # of its results
    estimate: FovEstimate
    elapsed_ms: float | None  # of leveling and estimate; None if not timed
    places: tuple[Path, ...]  # of its results
    remarks: tuple[str, ...] = ()  # caveats in a few words each
    verdicts: str = ""  # of a monitor; empty without one

    @property
    def line(self) -> str:
        """One line of text, up to 100 characters without remarks and verdicts."""
        parts = (summary_line(self.estimate, self.elapsed_ms), *self.remarks, *filter(None, [self.verdicts]))
        return f"{self.name}: {'; '.join(parts)} → {self.places[0]}"

    @property
    def json(self) -> str:
        """One line of JSON with all fields."""
        from viewshed.fov.estimate import CellState

        estimate, basis = self.estimate, self.estimate.basis
        shares = {f"{state.name.lower()}_share": round(estimate.share(state), 6) for state in CellState}
        fields = {
            "name": self.name, "visible_m2": estimate.area_m2(), **shares, "method": estimate.method,
            "target": estimate.target.name, "ms": self.elapsed_ms, "basis": None if basis is None else asdict(basis),
            "remarks": self.remarks, "verdicts": self.verdicts, "results": [str(place) for place in self.places],
        }  # fmt: skip
        return json.dumps(fields, ensure_ascii=False)


def total_line(areas_m2: Sequence[float], times_ms: Sequence[float | None]) -> str:
    """Return one line with mean, minimum and maximum visible area of many sweeps, and the median of the known times."""
    known_ms = sorted(time_ms for time_ms in times_ms if time_ms is not None)
    elapsed = f"; {known_ms[len(known_ms) // 2]:.0f} ms each" if known_ms else ""
    mean_m2 = sum(areas_m2) / len(areas_m2)
    return f"{len(areas_m2)} sweeps: {mean_m2:.0f} m² on average, {min(areas_m2):.0f} to {max(areas_m2):.0f}{elapsed}"


_NOTABLE_SHARE = 0.2
"""A remark is added if a larger share of the view is over unsure ground, or by inferred beams."""


def _remarks(leveled: LeveledSweep, estimate: FovEstimate) -> tuple[str, ...]:
    """Return remarks on an estimate: its sensor height, uncertain parts of the view, returns left out."""
    from viewshed.preprocess.reach import returns_beyond

    if len(leveled.points) == 0:
        return (f"no usable return among {len(leveled.sweep)} points: nothing is known",)
    basis, remarks = estimate.basis, []
    if basis is not None:
        height, is_assumed = f"{basis.sensor_height_m:.2f} m", basis.height_source == "assumed"
        assumed = f"ground not seen, sensor taken to be {height} above it"
        remarks.append(assumed if is_assumed else f"sensor {height} high")
        if estimate.visible().any():
            shares = ((basis.unsure_ground_share, "over unsure ground"), (basis.inferred_share, "by inferred beams"))
            remarks += [f"{share:.0%} of the view {words}" for share, words in shares if share > _NOTABLE_SHARE]
    model = leveled.sweep.model
    beyond = returns_beyond(leveled.sweep.points, model)
    if model is not None and beyond:
        remarks.append(f"{beyond} returns beyond the {model.max_range_m:g} m of {model.name} left out")
    return tuple(remarks)
