"""What commands say on standard error, and which errors are the input's."""

from __future__ import annotations

import typer

BAD_INPUTS = (ValueError, OSError, ImportError, MemoryError)
"""What the library raises for input that it cannot use; anything else is a fault of ours and may trace."""


def complain(line: str) -> None:
    """Print a line about what is wrong on standard error."""
    typer.echo(f"viewshed: {line}", err=True)


def note(line: str) -> None:
    """Print a line on standard error about what was assumed or left out; nothing is wrong."""
    typer.echo(f"viewshed: note: {line}", err=True)


def one_line(error: BaseException) -> str:
    r"""Return an error's message without line breaks.

    >>> one_line(ValueError("a\nb"))
    'a b'
    """
    if isinstance(error, OSError) and error.strerror is not None and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split()) or type(error).__name__
