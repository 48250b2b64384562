"""Status line on a terminal while a command prints nothing: that it is at work, and for how long."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from typing import Any, TextIO, cast

QUIET_S = 1.0
"""The line appears after this time without output."""

_PERIOD_S = 0.2

_COMPILED = frozenset(
    {"attack", "corrupt", "crossval", "evaluate", "label", "quantize", "record", "simulate", "study", "train"}
)
"""Commands of viewshed-lab whose loops are compiled on first use."""

_ERASED = "\r\x1b[K"


@dataclass(slots=True)
class _Line:
    """The status line, and when other output was last printed."""

    terminal: TextIO
    text: str
    begun_s: float = field(default_factory=time.monotonic)  # when the command began
    printed_s: float = field(default_factory=time.monotonic)  # when other output was last printed
    is_shown: bool = False  # whether it is on the terminal

    def erase(self) -> None:
        """Erase the line before other output."""
        if self.is_shown:
            self.is_shown = False
            self.terminal.write(_ERASED)
            self.terminal.flush()
        self.printed_s = time.monotonic()

    def update(self) -> None:
        """Show the line if nothing was printed for ``QUIET_S``."""
        now_s = time.monotonic()
        if now_s - self.printed_s >= QUIET_S:
            self.is_shown = True
            self.terminal.write(f"{_ERASED}{self.text}, {now_s - self.begun_s:.0f} s")
            self.terminal.flush()


class _ErasingStream:
    """Wraps a stream: erases the status line before each write."""

    def __init__(self, stream: TextIO, line: _Line) -> None:
        self._stream, self._line = stream, line

    def write(self, text: str) -> int:
        """Erase the line, then write."""
        self._line.erase()
        return self._stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def status_line(command: str) -> Iterator[None]:
    """Show that a command is at work whenever it has printed nothing for a second; only if stderr is a terminal."""
    if not sys.stderr.isatty():
        yield
        return
    hint = " (its loops are compiled when they first run)" if command in _COMPILED else ""
    line, ended = _Line(sys.stderr, f"viewshed {command}: at work{hint}"), threading.Event()

    def watch() -> None:
        while not ended.wait(_PERIOD_S):
            line.update()

    # Both streams may be the terminal, so both erase the line before they write.
    out, err = (cast(TextIO, _ErasingStream(stream, line)) for stream in (sys.stdout, sys.stderr))
    watcher = threading.Thread(target=watch, name="status line", daemon=True)
    watcher.start()
    try:
        with redirect_stdout(out), redirect_stderr(err):
            yield
    finally:
        ended.set()
        watcher.join()
        line.erase()
