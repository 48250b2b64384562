"""Messages of commands on standard error, the errors caused by bad input, and Ctrl-C."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace

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


_ctrl_c = SimpleNamespace(is_pressed=False)  # no threading.Event: a second Ctrl-C would wait for its lock


@contextmanager
def heeding_interrupts() -> Iterator[None]:
    """Remember that Ctrl-C was pressed, because compiled code can drop the KeyboardInterrupt.

    When an array is compared with a member of an Enum, NumPy looks up attributes of the Enum and drops any error of
    that (numpy issue 20596). In Python 3.11 this lookup runs Python code, where the interrupt is raised. So loops call
    :func:`raise_if_interrupted`. A handler that is not Python's own stays.
    """
    _ctrl_c.is_pressed = False
    is_pythons = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if not is_pythons or threading.current_thread() is not threading.main_thread():
        yield
        return
    signal.signal(signal.SIGINT, _interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def was_interrupted() -> bool:
    """Return whether Ctrl-C was pressed during this command."""
    return bool(_ctrl_c.is_pressed)


def raise_if_interrupted() -> None:
    """Raise KeyboardInterrupt if Ctrl-C was pressed during this command and compiled code dropped it."""
    if _ctrl_c.is_pressed:
        raise KeyboardInterrupt


def _interrupt(*_: object) -> None:
    _ctrl_c.is_pressed = True
    raise KeyboardInterrupt
