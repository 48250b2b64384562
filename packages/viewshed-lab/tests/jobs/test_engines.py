"""Every engine gives one result for every job, and outlives what the work and its workers do."""

import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from tests.jobs import jobs

from viewshed_lab._jobs import ENGINES, TRIES, engine_named

RAY = pytest.param("ray", marks=pytest.mark.slow)
CASES = [("local", 1), ("local", 2), ("local", None), ("ray", 2)]


@pytest.fixture(
    params=[pytest.param(case, marks=pytest.mark.slow if case[0] == "ray" else ()) for case in CASES],
    ids=lambda case: f"{case[0]}-{case[1]}",
)
def engine(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Any:
    name, workers = request.param
    if name == "ray":
        monkeypatch.setenv("RAY_ADDRESS", request.getfixturevalue("cluster").address)
    return ENGINES[name](workers)


def _in_order(done: Any) -> list[Any]:
    return sorted(done, key=lambda one: one.index)


def test_every_job_is_done_once_and_a_failure_is_one_line(engine: Any) -> None:
    done = _in_order(engine.run(jobs.square, range(7)))
    assert [one.index for one in done] == list(range(7))
    assert [one.result for one in done] == [0, 1, 4, None, None, 25, 36]
    assert done[3].error == "job must not be 3, got 3; leave it out"
    assert done[4].error.startswith("KeyError: 'four' (jobs.py:")
    assert [one.error for one in done if one.index not in {3, 4}] == [None] * 5


class _Counted(Sequence[Any]):
    """A million jobs that notes which were asked for; one cannot be sent."""

    def __init__(self) -> None:
        self.asked: set[int] = set()

    def __len__(self) -> int:
        return 1_000_000

    def __getitem__(self, index: Any) -> Any:
        self.asked.add(index)
        return index


def test_jobs_are_made_when_a_worker_is_free(engine: Any) -> None:
    counted = _Counted()
    run = engine.run(jobs.square, counted)
    indices = {next(run).index for _ in range(3)}
    run.close()
    assert len(indices) == 3
    assert len(counted.asked) <= 3 + (engine.workers or os.cpu_count() or 1)


@pytest.mark.parametrize("name", ["local", RAY])
def test_what_cannot_travel_is_an_error_of_its_job(name: str, request: pytest.FixtureRequest) -> None:
    if name == "ray":
        request.getfixturevalue("monkeypatch").setenv("RAY_ADDRESS", request.getfixturevalue("cluster").address)
    engine: Any = ENGINES[name](2)
    done = _in_order(engine.run(jobs.unlike, [0, 1, 2]))
    if name == "local":  # Ray can send functions
        assert "job 1 cannot be passed between processes" in str(done[1].error)
    assert [done[0].result, done[2].result] == [0, 2]
    unsent = _in_order(engine.run(jobs.unlike, [5, (_ for _ in ()), 6]))
    assert [one.result for one in unsent] == [5, None, 6]
    assert "job 1 cannot be sent to a worker" in str(unsent[1].error)
    assert "\n" not in str(unsent[1].error)


@pytest.mark.parametrize(
    ("name", "times", "result"),
    [("local", TRIES - 1, 4), ("local", TRIES, None), pytest.param("ray", TRIES, None, marks=pytest.mark.slow)],
)
def test_a_killed_worker_is_replaced(
    name: str, times: int, result: int | None, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    if name == "ray":
        request.getfixturevalue("monkeypatch").setenv("RAY_ADDRESS", request.getfixturevalue("cluster").address)
    done = _in_order(ENGINES[name](2).run(partial(jobs.kill_own_process, tmp_path, times), range(5)))
    assert [one.result for one in done] == [0, 1, result, 9, 16]
    assert (tmp_path / "begun").read_text() == "x" * TRIES
    assert (done[2].error is None) == (result is not None)
    if result is None:
        end = "signal 9 (out of memory?)" if name == "local" else ""
        assert f"the worker died {TRIES} times on this job, the last time with {end}" in str(done[2].error)


def test_engines_are_checked_when_they_are_made() -> None:
    for name in ENGINES:
        with pytest.raises(ValueError, match="workers must be at least 1, got 0"):
            engine_named(name, 0)
    with pytest.raises(ValueError, match="engine must be one of local, ray, got 'slurm'"):
        engine_named("slurm", 2)
