"""A cluster of two nodes, one killed in the middle, gives what this machine gives."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from tests.jobs import jobs

from viewshed_lab._jobs import LocalEngine, RayEngine

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
JOBS = 24
WRITE_FILES = """
import json, sys
from functools import partial
from pathlib import Path
from tests.jobs import jobs
from viewshed_lab._jobs import RayEngine

run = RayEngine(2).run(partial(jobs.write_file, Path(sys.argv[1])), range(int(sys.argv[2])))
print(json.dumps([[one.index, one.result, one.error] for one in run]))
"""
CHATTER = """
from tests.jobs import jobs
from viewshed_lab._jobs import RayEngine
import ray

print(sorted(one.result for one in RayEngine(2).run(jobs.loud, range(3))))
assert not ray.is_initialized()
"""


def _program(script: str, address: str, *words: object) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", script, *map(str, words)],
        env={**os.environ, "PYTHONPATH": str(ROOT), "RAY_ADDRESS": address},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def _raylet(node: Any) -> int:
    (raylet,) = node.all_processes["raylet"]
    return int(raylet.process.pid)


def _wait_for(true: Callable[[], object], within_s: float = 200.0) -> None:
    end_s = time.monotonic() + within_s
    while not true():
        assert time.monotonic() < end_s, "nothing happened"
        time.sleep(0.02)


def _shards(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.glob("*.shard")}


def test_a_node_dies_in_the_middle(cluster: Any, tmp_path: Path) -> None:
    alone, together = tmp_path / "alone", tmp_path / "together"
    alone.mkdir()
    together.mkdir()
    expected: Any = {one.index: one.result for one in LocalEngine(1).run(partial(jobs.write_file, alone), range(JOBS))}
    node = cluster.add_node(num_cpus=1)
    (together / "doomed").write_text(str(_raylet(node)))
    program = _program(WRITE_FILES, cluster.address, together, JOBS)
    _wait_for(lambda: list(together.glob("hangs*")))
    cluster.remove_node(node, allow_graceful=False)
    said, complained = program.communicate(timeout=300)
    assert complained == ""
    done = json.loads(said.splitlines()[-1])  # before it Ray may say that a node is gone
    assert sorted(index for index, _, _ in done) == list(range(JOBS))
    assert [error for _, _, error in done] == [None] * JOBS
    assert {index: size for index, (size, _), _ in done} == {index: size for index, (size, _) in expected.items()}
    assert len({raylet for _, (_, raylet), _ in done}) == 2, "only one node worked"
    assert len(_shards(alone)) == JOBS
    assert _shards(together) == _shards(alone)


def test_its_own_cluster_is_quiet_and_ends() -> None:
    pytest.importorskip("ray", reason="ray is not installed: clusters are not tested")
    said, complained = _program(CHATTER, "local").communicate(timeout=300)
    assert (said, complained) == ("[0, 1, 2]\n", "")


def test_a_cluster_that_is_not_there_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ray", reason="ray is not installed: clusters are not tested")
    monkeypatch.setenv("RAY_ADDRESS", "127.0.0.1:1")
    message = r"^RAY_ADDRESS must name a running Ray cluster, got 127\.0\.0\.1:1 \(.*refused\); start one"
    with pytest.raises(OSError, match=message) as raised:
        list(RayEngine(2).run(jobs.square, [1]))
    assert "\n" not in str(raised.value)
