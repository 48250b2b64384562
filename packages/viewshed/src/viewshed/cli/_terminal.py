"""Messages of commands on standard error, and the errors caused by bad input."""

from __future__ import annotations

import typer

BAD_INPUTS = (ValueError, OSError, ImportError, MemoryError)
"""Errors that the library raises for bad input; any other error is a bug and may show a traceback."""


def complain(line: str) -> None:
    """Print a problem as one line on standard error."""
    typer.echo(f"viewshed: {line}", err=True)


def note(line: str) -> None:
    """Print a note on standard error about an assumption or omission that is no problem."""
    typer.echo(f"viewshed: note: {line}", err=True)


def one_line(error: BaseException) -> str:
    r"""Return an error's message without line breaks.

    >>> one_line(ValueError("a\nb"))
    'a b'
    """
    if isinstance(error, OSError) and error.strerror is not None and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split()) or type(error).__name__
