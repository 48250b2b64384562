"""Files of a training: whole or not there, and a full disk is told in one line."""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Callable, Sequence
from pathlib import Path

from viewshed.atomic import write_bytes
from viewshed.engines import LocalEngine
from viewshed.engines.role import J

_FULL = (errno.ENOSPC, errno.EDQUOT)


def save(path: Path, content: bytes) -> None:
    """Write a file, whole or not at all; one that exists is replaced.

    Raises:
        OSError: it cannot be written; what was there before is still there.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(path, content)
    except OSError as error:
        what = "the disk is full; free some space" if error.errno in _FULL else f"{error.strerror or error}; mend that"
        named = type(error)(f"{path}: {what} and start the same command again, it goes on from the last whole epoch")
        named.errno = error.errno
        raise named from error


def make_files(work: Callable[[J], int], jobs: Sequence[J], workers: int, told: Callable[[int], None] | None) -> None:
    """Do jobs that each leave a file and return how many frames it holds, in so many processes.

    Raises:
        OSError: a job failed; files that are finished stay.
    """
    with contextlib.closing(LocalEngine(workers).run(work, jobs)) as run:
        for done in run:
            if done.result is None:
                raise OSError(f"{done.error}; what is finished is kept, the same command goes on from here")
            if told is not None:
                told(done.result)
