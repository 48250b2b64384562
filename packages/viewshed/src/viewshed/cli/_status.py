"""A line on a terminal while a command prints nothing: that it is at work, and for how long."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from typing import Any, TextIO, cast

QUIET_S = 1.0
"""A terminal that was silent for this time gets a line."""

_PERIOD_S = 0.2

_COMPILED = frozenset(
    {"attack", "corrupt", "crossval", "evaluate", "label", "quantize", "record", "simulate", "study", "train"}
)
"""Commands of the laboratory, whose loops are compiled when they first run."""

_ERASED = "\r\x1b[K"


@dataclass(slots=True)
class _Line:
    """The line, and when something else was last printed."""

    terminal: TextIO  # where it is shown
    text: str  # what it says
    begun_s: float = field(default_factory=time.monotonic)  # when the command began
    printed_s: float = field(default_factory=time.monotonic)  # when something was last printed
    is_shown: bool = False  # whether it stands on the terminal

    def erase(self) -> None:
        """Make room for what is printed now."""
        if self.is_shown:
            self.is_shown = False
            self.terminal.write(_ERASED)
            self.terminal.flush()
        self.printed_s = time.monotonic()

    def update(self) -> None:
        """Show the line where the terminal has been silent."""
        now_s = time.monotonic()
        if now_s - self.printed_s >= QUIET_S:
            self.is_shown = True
            self.terminal.write(f"{_ERASED}{self.text}, {now_s - self.begun_s:.0f} s")
            self.terminal.flush()


class _Watched:
    """A stream that erases the line before it is written to; all else is the stream's own."""

    def __init__(self, stream: TextIO, line: _Line) -> None:
        self._stream, self._line = stream, line

    def write(self, text: str) -> int:
        """Write after the line is erased."""
        self._line.erase()
        return self._stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def status_line(command: str) -> Iterator[None]:
    """Show on a terminal that a command is at work, whenever it has printed nothing for a second.

    Nothing is shown where standard error is no terminal.
    """
    if not sys.stderr.isatty():
        yield
        return
    hint = " (its loops are compiled when they first run)" if command in _COMPILED else ""
    line, ended = _Line(sys.stderr, f"viewshed {command}: at work{hint}"), threading.Event()

    def watch() -> None:
        while not ended.wait(_PERIOD_S):
            line.update()

    # Both streams may be the terminal: each erases the line before it prints.
    out, err = (cast(TextIO, _Watched(stream, line)) for stream in (sys.stdout, sys.stderr))
    watcher = threading.Thread(target=watch, name="status line", daemon=True)
    watcher.start()
    try:
        with redirect_stdout(out), redirect_stderr(err):
            yield
    finally:
        ended.set()
        watcher.join()
        line.erase()
