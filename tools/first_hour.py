"""The first hour of a user, run word for word in an empty home: install, the README's questions, a sweep of one's own.

    python tools/first_hour.py [--wheel FILE | --installed BIN] [--times 3] [--page docs/first_hour.md]

Each time begins with an empty home and nothing of the caller's environment. Without ``--wheel`` a fresh copy of the
checkout is taken and ``make demo`` is run in it, as the README says; with it, the wheel is installed into an empty
environment; ``--installed`` names the folder of an environment's programs and installs nothing. Then come the README's
other commands as they stand there, on a terminal. The transcript of the last time is the page.
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
    """An empty home with the commands typed in it so far."""

    folder: Path
    path: str = "/usr/local/bin:/usr/bin:/bin"
    typed: list[Typed] = field(default_factory=list)

    def type(self, command: str, cwd: Path) -> Typed:
        """Run a command on a terminal as a shell would, with nothing in its environment but HOME and PATH."""
        words = ["bash", "-c", command]
        env = {"HOME": str(self.folder), "PATH": self.path, "LANG": "C.UTF-8", "TERM": "xterm"}
        began = last = time.monotonic()
        silent, parts = 0.0, []
        ours, theirs = pty.openpty()
        with subprocess.Popen(words, cwd=cwd, env=env, stdin=theirs, stdout=theirs, stderr=theirs) as running:
            os.close(theirs)
            while piece := _piece(ours):
                silent, last = max(silent, time.monotonic() - last), time.monotonic()
                parts.append(piece)
        os.close(ours)
        silent, ended = max(silent, time.monotonic() - last), time.monotonic()
        text = shown(b"".join(parts).decode(errors="replace")).replace(str(self.folder), "~")
        done = Typed(command, text.rstrip(), running.returncode, ended - began, silent)
        self.typed.append(done)
        return done


def _piece(terminal: int) -> bytes:
    """Return what was printed, or nothing when the program has ended."""
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


def one_hour(wheel: Path | None, installed: Path | None, python: str) -> tuple[Home, list[str]]:
    """Run the first hour in a new home; return it and what went wrong."""
    home = Home(Path(tempfile.mkdtemp(prefix="home")), f"{Path(python).parent}:/usr/local/bin:/usr/bin:/bin")
    work, wrong = home.folder / "try", []
    work.mkdir()
    commands = [command for command in readme_commands() if not command.startswith("make ")]
    if installed is not None:
        home.path = f"{installed.resolve()}:{home.path}"
    elif wheel is None:
        checkout = home.folder / "viewshed"
        checkout.mkdir()
        archived = subprocess.run(["git", "archive", "HEAD"], cwd=ROOT, check=True, capture_output=True).stdout
        subprocess.run(["tar", "x"], input=archived, cwd=checkout, check=True)
        wrong += faults(home.type(f"make demo PYTHON={Path(python).name}", checkout), checkout)
        install = (
            f"{checkout}/.venv/bin/python -m pip install --disable-pip-version-check {checkout}/packages/viewshed-lab"
        )
        wrong += faults(home.type(install, work), work)
        home.path = f"{checkout}/.venv/bin:{home.path}"
    else:
        wrong += faults(home.type(f"{Path(python).name} -m venv ~/env", work), work)
        wheels = sorted(wheel.parent.glob("*.whl"))  # that of the laboratory lies beside it
        for each in wheels:
            shutil.copy2(each, home.folder)
        names = " ".join(f"~/{each.name}" for each in wheels)
        install = f"~/env/bin/python -m pip install --disable-pip-version-check {names}"
        wrong += faults(home.type(install, work), work)
        home.path = f"{home.folder}/env/bin:{home.path}"
    own = ["viewshed info demo/sweep.pcd.bin.gz", "viewshed compare demo/sweep.pcd.bin.gz --out demo/compare.png",
           "viewshed export demo/sweep.pcd.bin.gz --to nav2_map --out demo", "viewshed"]  # fmt: skip
    for command in [*commands, *own]:
        wrong += faults(home.type(command, work), work)
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
    parser.add_argument("--installed", type=Path, help="programs of an environment that has viewshed already")
    parser.add_argument("--times", type=int, default=1)
    parser.add_argument("--python", default=sys.executable, help="the Python that the user has")
    parser.add_argument("--page", type=Path)
    given = parser.parse_args()
    wrong: list[str] = []
    for number in range(given.times):
        home, found = one_hour(given.wheel and given.wheel.resolve(), given.installed, given.python)
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
