"""The line on a terminal while a command is silent, seen as a terminal sees it."""

import os
import pty
import subprocess
import sys
import time

import pytest

from viewshed.cli._status import QUIET_S, status_line

SLOW = """
import sys, time
from viewshed.cli._status import status_line
with status_line(sys.argv[1]):
    time.sleep(float(sys.argv[2]))
    print("done")
"""


def on_a_terminal(command: str, silent_s: float) -> tuple[str, float]:
    """Return what a terminal receives, and its longest silence in seconds."""
    mine, theirs = pty.openpty()
    words = [sys.executable, "-c", SLOW, command, str(silent_s)]
    shown, longest_s, last_s = b"", 0.0, None
    with subprocess.Popen(words, stdin=theirs, stdout=theirs, stderr=theirs):
        os.close(theirs)
        while True:
            try:
                part = os.read(mine, 4096)
            except OSError:
                break
            now_s = time.monotonic()
            longest_s = longest_s if last_s is None else max(longest_s, now_s - last_s)
            last_s, shown = now_s, shown + part
    os.close(mine)
    return shown.decode(), longest_s


def test_a_silent_command_says_that_it_is_at_work_and_leaves_no_line_behind() -> None:
    shown, longest_s = on_a_terminal("attack", QUIET_S + 1.5)
    assert "viewshed attack: at work (its loops are compiled when they first run), 2 s" in shown
    assert shown.endswith("\r\x1b[Kdone\r\n")
    assert longest_s < QUIET_S + 1.0


def test_a_quick_command_says_nothing_of_it() -> None:
    assert on_a_terminal("info", 0.1)[0] == "done\r\n"


def test_nothing_is_shown_where_nobody_looks(capsys: pytest.CaptureFixture[str]) -> None:
    with status_line("info"):
        print("done")
        time.sleep(0.1)
    assert capsys.readouterr() == ("done\n", "")
