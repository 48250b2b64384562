"""Jobs that the engines' tests run in workers; a separate module, so that other processes can import it."""

import os
import signal
import sys
import time
from pathlib import Path

from viewshed._files import write_atomic


def square(job: int) -> int:
    if job == 3:
        raise ValueError("job must not be 3,\ngot 3; leave it out")
    if job == 4:
        raise KeyError("four")
    return job * job


def unlike(job: int) -> object:
    """Return a result that cannot be pickled for job 1."""
    return (lambda: job) if job == 1 else job


def kill_own_process(folder: Path, times: int, job: int) -> int:
    """Square the job; job 2 kills its worker in its first ``times`` attempts."""
    if job == 2:
        with (folder / "begun").open("a") as file:
            file.write("x")
        if len((folder / "begun").read_text()) <= times:
            os.kill(os.getpid(), signal.SIGKILL)
    return job * job


def write_file(folder: Path, job: int) -> tuple[int, int]:
    """Write a file; on the doomed node the third job signals ``hangs`` and waits, to be killed half way."""
    doomed, begun = folder / "doomed", folder / f"begun{os.getppid()}"
    with begun.open("a") as file:
        file.write("x")
    if doomed.exists() and int(doomed.read_text()) == os.getppid() and len(begun.read_text()) > 2:
        (folder / f"hangs{job}").touch()
        time.sleep(120)
    time.sleep(0.05)
    content = f"shard {job}\n".encode() * 1000
    write_atomic(folder / f"{job}.shard", content)
    return len(content), os.getppid()


def process_id(folder: Path, job: int) -> int:
    """Record this process by a file; job 0 returns its id once a second process has started, other jobs hang."""
    (folder / f"{os.getpid()}.pid").touch()
    end_s = time.monotonic() + 120
    while time.monotonic() < end_s and (job > 0 or len(list(folder.glob("*.pid"))) < 2):
        time.sleep(0.05)
    return os.getpid()


def loud(job: int) -> int:
    """Print lines that must not appear next to a progress bar."""
    print("a worker's chatter")
    print("a worker's complaint", file=sys.stderr)
    return job
