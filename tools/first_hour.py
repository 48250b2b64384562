"""The first hour of a user, run word for word in an empty home: install, the README's questions, a sweep of one's own.

    python tools/first_hour.py [--wheel FILE] [--times 3] [--page docs/first_hour.md]

Each time begins with an empty home and nothing of the caller's environment, and the README's commands are typed from
top to bottom into one shell, on a terminal. Without ``--wheel`` that is in a fresh copy of the checkout; with it, the
wheels are installed in place of ``make demo`` and of the laboratory's folder. The last time's transcript is the page.
Exit code 1 where a command failed, printed a traceback or left out a file that it named.
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
_MOST_LINES = 50

_ABOUT = """A transcript of what a newcomer types in an empty home, and of all that is printed. Seconds were measured on
this machine, under whatever load it had; *silent* is the longest wait without a line."""


@dataclass(slots=True)
class Typed:
    """A command, what it printed, how long it took, and the longest time without any output."""

    command: str
    output: str
    code: int
    seconds: float
    silent_s: float


@dataclass(slots=True)
class Home:
    """An empty home with one shell on a terminal, and the commands typed in it so far.

    Use it as a context: the shell ends with it. Nothing of the caller's environment is in it but PATH.
    """

    folder: Path
    path: str = "/usr/local/bin:/usr/bin:/bin"
    typed: list[Typed] = field(default_factory=list)
    _ours: int = field(default=-1, init=False)
    _shell: subprocess.Popen[bytes] | None = field(default=None, init=False)

    def __enter__(self) -> Home:
        env = {"HOME": str(self.folder), "PATH": self.path, "LANG": "C.UTF-8", "TERM": "xterm"}
        self._ours, theirs = pty.openpty()
        self._shell = subprocess.Popen(
            ["bash", "--noprofile", "--norc"], cwd=self.folder, env=env, stdin=subprocess.PIPE, stdout=theirs,
            stderr=theirs,
        )  # fmt: skip
        os.close(theirs)
        return self

    def __exit__(self, *_: object) -> None:
        if self._shell is not None:
            self._shell.communicate()
        os.close(self._ours)

    def type(self, command: str) -> Typed:
        """Type a command into the shell, and wait until it has ended."""
        shell = self._shell
        if shell is None or shell.stdin is None:
            raise RuntimeError("a home must be entered before commands are typed: with Home(folder) as home")
        # In braces a command may change the shell, as `source` does; what it prints ends with its exit code.
        shell.stdin.write(f"{{ {command}\n}} </dev/null; printf '\\001%d\\001' $?\n".encode())
        shell.stdin.flush()
        began = last = time.monotonic()
        silent, printed = 0.0, b""
        while not (ended := re.search(rb"\001(\d+)\001", printed)) and (piece := _piece(self._ours)):
            silent, last = max(silent, time.monotonic() - last), time.monotonic()
            printed += piece
        text = shown(printed.partition(b"\001")[0].decode(errors="replace")).replace(str(self.folder), "~")
        code = int(ended[1]) if ended else -1
        done = Typed(command, text.rstrip(), code, time.monotonic() - began, silent)
        self.typed.append(done)
        return done


def _piece(terminal: int) -> bytes:
    """Return what was printed, or nothing when the shell has ended."""
    try:
        return os.read(terminal, 65536)
    except OSError:  # how Linux says that nobody has the other end
        return b""


def shown(printed: str) -> str:
    r"""Return what stays on a terminal: no escapes, and of a line that was written anew the last.

    >>> shown("at work\r\x1b[Kdone\r\nnext\r\n")
    'done\nnext\n'
    """
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", printed).replace("\r\n", "\n")
    return "\n".join(line.rpartition("\r")[2] for line in plain.split("\n"))


def readme_commands() -> list[str]:
    """Return the lines of the README's shell blocks, without comments."""
    blocks = re.findall(
        r"^```sh\n(.*?)^```", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )
    return [line.partition(" #")[0].strip() for block in blocks for line in block.splitlines() if line.strip()]


def faults(typed: Typed, cwd: Path) -> list[str]:
    """Return what is wrong with a command: its exit code, a traceback, or a file that it names and did not write."""
    found = [f"exit code {typed.code}"] if typed.code else []
    found += ["a traceback"] if "Traceback (most recent call last)" in typed.output else []
    named = re.findall(r"→ (\S+)$", typed.output, re.MULTILINE)
    found += [f"{name} is not there" for name in named if not (cwd / name).exists()]
    return [f"{typed.command}: {one}" for one in found]


def instead(command: str, given: Sequence[str] | None, python: str) -> list[str]:
    """Return what is typed in place of a command of the README.

    Args:
        command: as the README has it.
        given: wheels that are installed in place of a checkout; None takes the README at its word.
        python: the Python that the user has.

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
    """Run the first hour in a new home, in one shell; return it and what went wrong."""
    home = Home(Path(tempfile.mkdtemp(prefix="home")), f"{Path(python).parent}:/usr/local/bin:/usr/bin:/bin")
    work, wrong = home.folder / "viewshed", []
    work.mkdir()
    given: list[str] | None = None
    if wheel is None:
        archived = subprocess.run(["git", "archive", "HEAD"], cwd=ROOT, check=True, capture_output=True).stdout
        subprocess.run(["tar", "x"], input=archived, cwd=work, check=True)
    else:
        wheels = sorted(wheel.parent.glob("*.whl"))  # that of the laboratory lies beside it
        given = [f"~/{each.name}" for each in wheels]
        for each in wheels:
            shutil.copy2(each, home.folder)
    commands = [each for command in readme_commands() for each in instead(command, given, Path(python).name)]
    own = ["viewshed info demo/sweep.pcd.bin.gz", "viewshed compare demo/sweep.pcd.bin.gz --out demo/compare.png",
           "viewshed export demo/sweep.pcd.bin.gz --to nav2_map --out demo", "viewshed"]  # fmt: skip
    if wheel is not None:  # the laboratory's wheel has all that the published cases need
        own.append("viewshed study cases --scenes 1 --page demo/cases.md")
    with home:
        home.type("cd viewshed")
        for command in [*commands, *own]:
            wrong += faults(home.type(command), work)
    return home, wrong


def transcript(home: Home) -> str:
    """Return what was typed and printed as Markdown."""
    return "\n\n".join(
        f"```console\n$ {one.command.replace(str(home.folder), '~')}\n{_shortened(one.output)}\n```\n\n"
        f"{one.seconds:.1f} s, silent for {one.silent_s:.1f} s."
        for one in home.typed
    )


def _shortened(output: str) -> str:
    """Return what was printed, of an install only its last line."""
    lines = output.splitlines()
    return output if len(lines) <= _MOST_LINES else f"… {len(lines) - 1} lines …\n{lines[-1]}"


def main() -> int:
    """Run the first hours and write the page; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--wheel", type=Path)
    parser.add_argument("--times", type=int, default=1)
    parser.add_argument("--python", default=sys.executable, help="the Python that the user has")
    parser.add_argument("--page", type=Path)
    given = parser.parse_args()
    wrong: list[str] = []
    for number in range(given.times):
        home, found = one_hour(given.wheel and given.wheel.resolve(), given.python)
        wrong += found
        silent = [one.command for one in home.typed if one.silent_s > SILENT_S]
        print(f"time {number + 1} of {given.times}: {len(home.typed)} commands, {len(found)} wrong, "
              f"{len(silent)} silent for more than {SILENT_S:g} s {silent or ''}", flush=True)  # fmt: skip
        print("\n".join(found), flush=True)
        shutil.rmtree(home.folder, ignore_errors=True)
    if given.page:
        load = f"{os.getloadavg()[1]:.0f} in the five minutes before the end, on {os.cpu_count()} cores"
        about = facts(command="`python tools/first_hour.py`", times=str(given.times), wrong=str(len(wrong)), load=load)
        given.page.write_text(page("The first hour", about, _ABOUT, transcript(home)), encoding="utf-8")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
