"""The process of the node: it ends by a signal whenever that comes, also where it could not be configured."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import pytest


@contextmanager
def started(*parameters: str) -> Iterator["subprocess.Popen[bytes]"]:
    given = [word for parameter in ("autostart:=true", *parameters) for word in ("-p", parameter)]
    command = [sys.executable, "-m", "viewshed_ros.node", "--ros-args", *given]
    process = subprocess.Popen(command, env=os.environ, stderr=subprocess.PIPE)
    try:
        yield process
    finally:
        process.kill()
        process.wait()
        assert process.stderr is not None
        process.stderr.close()


@pytest.mark.parametrize(
    ("parameters", "word"),
    [
        (["method:=nonesuch"], b"not configured: method"),
        (["monitor:=always", "monitor_file:=/nonesuch.npz"], b"not configured:"),
        (["lidar.topic:=no topic"], b"not activated:"),
    ],
)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_node_that_could_not_be_started_ends_by_a_signal(
    parameters: Sequence[str], word: bytes, number: signal.Signals
) -> None:
    with started(*parameters) as process:
        assert process.stderr is not None
        assert any(word in line for line in process.stderr)
        process.send_signal(number)
        said = process.stderr.read()
        assert process.wait(20) == 0, said


def test_why_a_center_cannot_start_is_one_line() -> None:
    command = [sys.executable, "-m", "viewshed_ros.center"]
    ended = subprocess.run(command, check=False, env=os.environ, capture_output=True, text=True, timeout=60)
    assert (ended.returncode, ended.stderr.count("\n")) == (1, 1)
    assert "not started: agents must name agents" in ended.stderr


def test_a_signal_while_it_starts_ends_it() -> None:
    for step in range(4):
        with started() as process:
            time.sleep(0.3 + 0.3 * step)
            process.send_signal(signal.SIGTERM)
            process.wait(20)


def test_a_signal_raises_nothing_where_python_just_is() -> None:
    program = """
import os, signal, time
import rclpy
from viewshed_ros.spinning import until_a_signal
with until_a_signal([]):
    os.kill(os.getpid(), signal.SIGINT)
    while rclpy.ok():
        time.sleep(.01)
"""
    subprocess.run([sys.executable, "-c", program], check=True, env=os.environ, timeout=20)
