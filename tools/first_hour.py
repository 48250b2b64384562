"""Run a user's first hour in an empty home: install, the README's commands, and a sweep of one's own.

    python tools/first_hour.py [--wheel FILE] [--times 3] [--page docs/first_hour.md]

Each run begins with an empty home and without the caller's environment, and types the README's commands from top to
bottom into one shell on a terminal. Without ``--wheel`` this happens in a fresh copy of the checkout; with it, the
wheels are installed in place of ``make demo`` and of the laboratory's folder. The page is the last run's transcript.
The exit code is 1 if a command failed, printed a traceback or did not write a file that it named.
"""

from __future__ import annotations

import argparse
import os
import pty
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from viewshed_lab._page import facts, page

ROOT = Path(__file__).resolve().parents[1]
SILENT_S = 3.0
_MAX_LINES = 50

_ABOUT = """A transcript of what a newcomer types in an empty home, and of all that is printed. Seconds were measured on
the machine named at the end, under whatever load it had; *silent* is the longest wait without a line."""


@dataclass(slots=True)
class Typed:
    """A typed command: its output, exit code, duration, and longest time without output."""

    command: str
    output: str
    code: int
    seconds: float
    silent_s: float


@dataclass(slots=True)
class Home:
    """An empty home with one shell on a terminal, and the commands typed so far.

    Use it as a context manager, which ends the shell. Of the environment only PATH is passed on.
    """

    folder: Path
    path: str = "/usr/local/bin:/usr/bin:/bin"
    typed: list[Typed] = field(default_factory=list)
    _terminal: int = field(default=-1, init=False)
    _shell: subprocess.Popen[bytes] | None = field(default=None, init=False)

    def __enter__(self) -> Home:
        env = {"HOME": str(self.folder), "PATH": self.path, "LANG": "C.UTF-8", "TERM": "xterm"}
        self._terminal, shell_end = pty.openpty()
        self._shell = subprocess.Popen(
            ["bash", "--noprofile", "--norc"], cwd=self.folder, env=env, stdin=subprocess.PIPE, stdout=shell_end,
            stderr=shell_end,
        )  # fmt: skip
        os.close(shell_end)
        return self

    def __exit__(self, *_: object) -> None:
        if self._shell is not None:
            self._shell.communicate()
        os.close(self._terminal)

    def type(self, command: str) -> Typed:
        """Type a command into the shell, and wait until it ends."""
        shell = self._shell
        if shell is None or shell.stdin is None:
            raise RuntimeError("a home must be entered before commands are typed: with Home(folder) as home")
        # Braces run it in the shell itself (as `source` needs). The exit code, between two \001, marks the end.
        shell.stdin.write(f"{{ {command}\n}} </dev/null; printf '\\001%d\\001' $?\n".encode())
        shell.stdin.flush()
        began = last = time.monotonic()
        silent, printed = 0.0, b""
        while not (ended := re.search(rb"\001(\d+)\001", printed)) and (chunk := _read(self._terminal)):
            silent, last = max(silent, time.monotonic() - last), time.monotonic()
            printed += chunk
        text = shown(printed.partition(b"\001")[0].decode(errors="replace")).replace(str(self.folder), "~")
        code = int(ended[1]) if ended else -1
        done = Typed(command, text.rstrip(), code, time.monotonic() - began, silent)
        self.typed.append(done)
        return done


def _read(terminal: int) -> bytes:
    """Return the next output, empty if the shell has ended."""
    try:
        return os.read(terminal, 65536)
    except OSError:  # on Linux: the other end is closed
        return b""


def shown(printed: str) -> str:
    r"""Return the text that remains on a terminal: no escapes, and only the last version of an overwritten line.

    >>> shown("at work\r\x1b[Kdone\r\nnext\r\n")
    'done\nnext\n'
    """
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", printed).replace("\r\n", "\n")
    return "\n".join(line.rpartition("\r")[2] for line in plain.split("\n"))


def readme_commands() -> list[str]:
    """Return the commands of the README's shell blocks, without comments."""
    blocks = re.findall(
        r"^```sh\n(.*?)^```", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )
    return [line.partition(" #")[0].strip() for block in blocks for line in block.splitlines() if line.strip()]


def faults(typed: Typed, cwd: Path) -> list[str]:
    """Return the faults of a command: a nonzero exit code, a traceback, files that it named but did not write."""
    problems = [f"exit code {typed.code}"] if typed.code else []
    problems += ["a traceback"] if "Traceback (most recent call last)" in typed.output else []
    named = re.findall(r"→ (\S+)$", typed.output, re.MULTILINE)
    problems += [f"{name} is not there" for name in named if not (cwd / name).exists()]
    return [f"{typed.command}: {problem}" for problem in problems]


def instead(command: str, given: Sequence[str] | None, python: str) -> list[str]:
    """Return the commands to type in place of a command of the README.

    Args:
        command: the README's command.
        given: wheels to install in place of a checkout; None to follow the README.
        python: the user's Python.

    >>> instead("make demo", ["~/a.whl", "~/b.whl"], "python3")
    ['python3 -m venv .venv', '.venv/bin/pip install --disable-pip-version-check ~/a.whl']
    """
    is_first = command.startswith("make ")
    if is_first and given is None:
        return [f"{command} PYTHON={python}"]
    if given is None or not command.startswith(("make ", "pip install")):
        return [command]
    install = f".venv/bin/pip install --disable-pip-version-check {given[0 if is_first else 1]}"
    return [f"{python} -m venv .venv", install] if is_first else [install]


def one_hour(wheel: Path | None, python: str) -> tuple[Home, list[str]]:
    """Run the first hour in a new home; return the home and the faults."""
    home = Home(Path(tempfile.mkdtemp(prefix="home")), f"{Path(python).parent}:/usr/local/bin:/usr/bin:/bin")
    work, wrong = home.folder / "viewshed", []
    work.mkdir()
    given: list[str] | None = None
    if wheel is None:
        archived = subprocess.run(["git", "archive", "HEAD"], cwd=ROOT, check=True, capture_output=True).stdout
        subprocess.run(["tar", "x"], input=archived, cwd=work, check=True)
    else:
        wheels = sorted(wheel.parent.glob("*.whl"))  # with the laboratory's wheel beside it
        given = [f"~/{file.name}" for file in wheels]
        for file in wheels:
            shutil.copy2(file, home.folder)
    commands = [line for command in readme_commands() for line in instead(command, given, Path(python).name)]
    own = ["viewshed info demo/sweep.pcd.bin.gz", "viewshed compare demo/sweep.pcd.bin.gz --out demo/compare.png",
           "viewshed export demo/sweep.pcd.bin.gz --to nav2_map --out demo", "viewshed"]  # fmt: skip
    if wheel is not None:  # the laboratory's wheel has all that `study cases` needs
        own.append("viewshed study cases --scenes 1 --page demo/cases.md")
    with home:
        home.type("cd viewshed")
        for command in [*commands, *own]:
            wrong += faults(home.type(command), work)
    return home, wrong


def transcript(home: Home) -> str:
    """Return the typed commands and their output as Markdown."""
    return "\n\n".join(
        f"```console\n$ {typed.command.replace(str(home.folder), '~')}\n{_shortened(typed.output)}\n```\n\n"
        f"{typed.seconds:.1f} s, silent for {typed.silent_s:.1f} s."
        for typed in home.typed
    )


def _shortened(output: str) -> str:
    """Return the output; if it is long, as of an install, only its last line."""
    lines = output.splitlines()
    return output if len(lines) <= _MAX_LINES else f"… {len(lines) - 1} lines …\n{lines[-1]}"


def main() -> int:
    """Run the first hour some times and write the page; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--wheel", type=Path)
    parser.add_argument("--times", type=int, default=1)
    parser.add_argument("--python", default=sys.executable, help="the user's Python")
    parser.add_argument("--page", type=Path)
    given = parser.parse_args()
    wrong: list[str] = []
    for number in range(given.times):
        home, problems = one_hour(given.wheel and given.wheel.resolve(), given.python)
        wrong += problems
        silent = [typed.command for typed in home.typed if typed.silent_s > SILENT_S]
        print(f"time {number + 1} of {given.times}: {len(home.typed)} commands, {len(problems)} wrong, "
              f"{len(silent)} silent for more than {SILENT_S:g} s {silent or ''}", flush=True)  # fmt: skip
        print("\n".join(problems), flush=True)
        shutil.rmtree(home.folder, ignore_errors=True)
    if given.page:
        load = f"{os.getloadavg()[1]:.0f} in the five minutes before the end, on {os.cpu_count()} cores"
        about = facts(command="`python tools/first_hour.py`", times=str(given.times), wrong=str(len(wrong)), load=load)
        given.page.write_text(page("The first hour", about, _ABOUT, transcript(home)), encoding="utf-8")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
