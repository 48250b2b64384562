"""Processes of this machine: nothing is left behind, whoever ends the run."""

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from tests.jobs import jobs

from viewshed_lab._jobs import LocalEngine

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
_PATH = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
SCRIPT = """
import signal, sys
from functools import partial
from pathlib import Path
from tests.jobs import jobs
from viewshed_lab._jobs import LocalEngine

signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where the tests run in the background
if __name__ == "__main__":
    for done in LocalEngine(2).run(partial(jobs.process_id, Path(sys.argv[1])), range(9)):
        print("one done", flush=True)
"""


def _alive(pid: int) -> bool:
    stat = Path(f"/proc/{pid}/stat")
    try:
        return stat.read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def _workers(folder: Path) -> list[int]:
    return [int(path.stem) for path in folder.glob("*.pid")]


def _gone(pids: list[int], within_s: float) -> bool:
    end_s = time.monotonic() + within_s
    while any(map(_alive, pids)) and time.monotonic() < end_s:
        time.sleep(0.05)
    return not any(map(_alive, pids))


@pytest.mark.skipif(not Path("/proc").exists(), reason="processes are looked up in /proc")
def test_closing_the_run_ends_the_workers(tmp_path: Path) -> None:
    run: Any = LocalEngine(2).run(partial(jobs.process_id, tmp_path), range(9))
    first = next(run)
    pids = _workers(tmp_path)
    assert first.result in pids
    assert os.getpid() not in pids
    run.close()
    assert not any(map(_alive, pids))


@pytest.mark.skipif(not Path("/proc").exists(), reason="processes are looked up in /proc")
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL], ids=["ctrl-c", "terminate", "kill"])
def test_workers_end_with_the_program(how: signal.Signals, tmp_path: Path) -> None:
    (tmp_path / "program.py").write_text(SCRIPT)
    program = subprocess.Popen(
        [sys.executable, tmp_path / "program.py", tmp_path],
        env={**os.environ, "PYTHONPATH": _PATH}, start_new_session=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert program.stdout.readline() == "one done\n"
    pids = _workers(tmp_path)
    if how == signal.SIGINT:
        os.killpg(program.pid, how)  # a terminal sends it to all
    else:
        program.send_signal(how)
    _, said = program.communicate(timeout=120)
    assert len(pids) == 2
    assert _gone(pids, within_s=20)
    assert said.count("Traceback") == (how == signal.SIGINT)  # the program's own KeyboardInterrupt, no worker's


def test_a_script_without_a_guard_is_told_so(tmp_path: Path) -> None:
    (tmp_path / "program.py").write_text(SCRIPT.replace('if __name__ == "__main__":', "if True:"))
    ended = subprocess.run(
        [sys.executable, tmp_path / "program.py", tmp_path],
        env={**os.environ, "PYTHONPATH": _PATH}, check=False, capture_output=True, text=True,
    )  # fmt: skip
    assert ended.returncode == 1
    assert "a worker process must start, but ended before its first job 3 times; call the engine" in ended.stderr
