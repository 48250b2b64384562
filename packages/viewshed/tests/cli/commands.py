"""Run a command in this process, as a user types it."""

import contextlib
import io
from pathlib import Path
from typing import NamedTuple

import pytest

from viewshed.cli import main


class Done(NamedTuple):
    """Exit code, standard output and standard error."""

    returncode: int
    stdout: str
    stderr: str


def run(*arguments: object, cwd: Path | None = None) -> Done:
    """Run a command, in the working directory ``cwd`` if given."""
    out, err = io.StringIO(), io.StringIO()
    with (
        contextlib.redirect_stdout(out), contextlib.redirect_stderr(err),
        contextlib.chdir(cwd or Path.cwd()), pytest.raises(SystemExit) as exit_,
    ):  # fmt: skip
        main([*map(str, arguments)])
    return Done(int(exit_.value.code or 0), out.getvalue(), err.getvalue())
