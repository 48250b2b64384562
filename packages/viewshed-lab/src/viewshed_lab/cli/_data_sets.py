"""Progress bar and summary line of commands that make data sets."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from viewshed.cli._outputs import progress_bar
from viewshed.cli._terminal import complain, raise_if_interrupted

if TYPE_CHECKING:
    from viewshed_lab.data import Archive
    from viewshed_lab.data.archive.build import ShardResult


def build_with_bar(
    name: str, total: int | None, build: Callable[[Callable[[ShardResult], None]], Archive]
) -> tuple[Archive, int]:
    """Build a data set with a progress bar that counts sweeps; return it and the number of reported problems.

    ``build`` makes the data set; its argument is the function to call with each finished shard.
    """
    from rich.progress import TextColumn, TimeElapsedColumn, TimeRemainingColumn

    problems: list[str] = []

    def report(result: ShardResult) -> None:
        raise_if_interrupted()
        problems.extend(result.problems)
        for problem in result.problems:
            complain(problem)
        bar.advance(task, result.frames)

    with progress_bar(TextColumn("sweeps"), TimeElapsedColumn(), TimeRemainingColumn()) as bar:
        task = bar.add_task(name, total=total)
        return build(report), len(problems)


def data_set_line(archive: Archive, content: str) -> str:
    """Return one line with a data set's location, content, number of shards and size."""
    size = sum(shard.bytes for shard in archive.shards)
    return f"{archive.store.place}: {content}, {len(archive.shards)} shards, {size / 1e6:.1f} MB"
