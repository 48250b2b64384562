"""What raises, hangs or returns nonsense costs its sweep, or ends the stream with the reason; nothing hangs."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, cast

import numpy as np
import pytest
from tests.pipeline.test_stream import SMALL, alarming, at, estimator_of, shadow_map, waiting_estimator

from viewshed import Sweep
from viewshed.pipeline import Answer, Caution, Pipeline, Statistics, reactions
from viewshed.preprocess.streams import why_anew

TINY = SMALL.select(np.arange(0, len(SMALL), 50))
THIRD = 2
"""Number of the sweep at which something fails."""

CLOSED_S = 2.0


class Failing:
    """Calls a function, and raises at its third call, or hands out something else there.

    Args:
        inner: the function.
        outcome: what is raised, or returned where it is no error.
        calls_before: how often it is called before the first sweep.
    """

    def __init__(self, inner: Callable[..., Any], outcome: object, calls_before: int = 0) -> None:
        self.inner, self.outcome, self.count = inner, outcome, -1 - calls_before

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        self.count += 1
        if self.count != THIRD:
            return self.inner(*arguments, **named)
        if isinstance(self.outcome, BaseException):
            raise self.outcome
        return self.outcome


def closed(pipeline: Pipeline) -> Statistics | BaseException:
    """Close in a thread of its own, and return what that returned or raised within the time that it may take."""
    found: list[Statistics | BaseException] = []

    def close() -> None:
        try:
            found.append(pipeline.close())
        except BaseException as error:
            found.append(error)

    thread = threading.Thread(target=close, daemon=True)
    thread.start()
    thread.join(CLOSED_S + 1.0)
    assert found, "close() must return"
    return found[0]


@contextmanager
def failing(place: str, outcome: object, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Pipeline, list[Answer]]]:
    """Yield a pipeline that fails at its third sweep, and what it publishes."""
    answers: list[Answer] = []
    estimator, publish, monitor = shadow_map(), cast(Any, answers.append), cast(Any, alarming())
    if place == "estimator":
        estimator = estimator_of(Failing(estimator.estimate, outcome, calls_before=1))
    elif place == "publish":
        publish = Failing(publish, outcome)
    elif place == "monitor":
        monitor.check = Failing(monitor.check, outcome)
    elif place == "react":
        monkeypatch.setattr("viewshed.pipeline.stream.react", Failing(reactions.react, outcome))
    elif place == "clock":
        monkeypatch.setattr("viewshed.pipeline.agent.why_anew", Failing(why_anew, outcome))
    yield Pipeline(estimator, publish, monitor=monitor, lossless=True), answers


def sources(place: str, outcome: object, count: int) -> list[Callable[[], Sweep]]:
    source = Failing(lambda number: at(0.1 * number, TINY), outcome)
    return [lambda n=n: (source if place == "source" else source.inner)(n) for n in range(count)]  # type: ignore[misc]


def put_all(pipeline: Pipeline, every: list[Callable[[], Sweep]]) -> None:
    for source in every:
        pipeline.put(source)


PLACES = ["source", "estimator", "monitor", "publish", "react", "clock"]


@pytest.mark.parametrize("place", PLACES)
def test_an_error_costs_its_sweep_and_no_other(place: str, monkeypatch: pytest.MonkeyPatch) -> None:
    error = RuntimeError("the cable\nis loose")
    with failing(place, error, monkeypatch) as (pipeline, answers):
        put_all(pipeline, sources(place, error, 10))
        ended = closed(pipeline)
    statistics = pipeline.statistics()
    seen = {answer.number for answer in answers if answer.estimate is not None}
    assert seen == set(range(10)) - {THIRD}
    if place == "publish":
        assert ended is error
        assert statistics.unpublished == {"the cable is loose": 1}
        assert "10 answered, 0 dropped, 1 not published (the cable is loose)" in statistics.line()
    else:
        refused = next(answer for answer in answers if answer.number == THIRD)
        assert refused.refused == "the cable is loose"
        assert refused.speed_mps == 0.0
        assert refused.reaction.caution >= Caution.ASK
        assert {answer.reaction.caution for answer in answers if answer.number < THIRD} == {Caution.KEEP}
        assert min(answer.reaction.caution for answer in answers if answer.number > THIRD) == Caution.ASK
        assert statistics.refused == {"the cable is loose": 1}


@pytest.mark.parametrize("place", PLACES)
def test_what_is_no_exception_ends_the_stream_with_the_reason(place: str, monkeypatch: pytest.MonkeyPatch) -> None:
    error = SystemExit("out of order")
    with failing(place, error, monkeypatch) as (pipeline, _):
        with pytest.raises(RuntimeError, match="ended with SystemExit: out of order; make a new one") as caught:
            put_all(pipeline, sources(place, error, 10_000))
        assert caught.value.__cause__ is error
        assert str(caught.value).startswith("the pipeline must run to take a sweep, its ")
        for _ in range(2):
            assert closed(pipeline) is caught.value


@pytest.mark.parametrize(
    ("place", "reason"),
    [
        ("source", "'int' object has no attribute"),
        ("estimator", "an estimator must return a FovEstimate, got int"),
        ("monitor", "'int' object has no attribute"),
        ("react", "'int' object has no attribute"),
    ],
)
def test_who_returns_something_else_costs_that_sweep(place: str, reason: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with failing(place, 5, monkeypatch) as (pipeline, answers):
        put_all(pipeline, sources(place, 5, 6))
        assert isinstance(closed(pipeline), Statistics)
    assert [answer.refused.startswith(reason) for answer in answers] == [n == THIRD for n in range(6)]


def test_a_publish_that_hangs_costs_the_answers_but_the_newest_and_closing_says_so() -> None:
    free, published = threading.Event(), []

    def publish(answer: Answer) -> None:
        published.append(answer.number)
        free.wait(60)

    pipeline = Pipeline(shadow_map(), publish, stale_after_s=np.inf)
    for n in range(20):
        pipeline.put(at(n, TINY))
        time.sleep(0.02)
    began_s = time.monotonic()
    ended = closed(pipeline)
    assert time.monotonic() - began_s < CLOSED_S + 0.5
    assert isinstance(ended, TimeoutError)
    assert str(ended) == "publish must return within 2 s once the pipeline closes, it did not; end what it waits for"
    statistics = pipeline.statistics()
    assert published == [0]
    assert statistics.answered + statistics.dropped == 20
    assert sum(statistics.unpublished.values()) == statistics.answered
    free.set()


def test_an_estimator_that_hangs_is_left_behind_when_the_pipeline_closes() -> None:
    free, estimator = waiting_estimator()
    pipeline = Pipeline(estimator, lambda answer: None)
    free.clear()
    pipeline._answering[1].timeout_s = 0.3
    pipeline.put(at(0.0, TINY))
    time.sleep(0.1)
    ended = closed(pipeline)
    assert isinstance(ended, TimeoutError)
    assert str(ended).startswith("estimating must return within 0.3 s once the pipeline closes")
    free.set()


def test_a_publish_that_is_slow_is_given_the_newest_answer() -> None:
    free, published = threading.Event(), []

    def publish(answer: Answer) -> None:
        free.wait(10)
        published.append(answer.number)

    pipeline = Pipeline(shadow_map(), publish, stale_after_s=np.inf)
    for n in range(20):
        pipeline.put(at(n, TINY))
        time.sleep(0.02)
    while pipeline.statistics().answered + pipeline.statistics().dropped < 20:
        time.sleep(0.01)
    free.set()
    statistics = pipeline.close()
    assert published == [0, 19]
    assert statistics.unpublished == {"newer ones replaced them": statistics.answered - 2}


def test_a_slow_step_of_files_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("viewshed.pipeline.stream._PUBLISH_TIMEOUT_S", 0.1)
    answers: list[Answer] = []

    def slow(answer: Answer) -> None:
        time.sleep(0.3)
        answers.append(answer)

    pipeline = Pipeline(shadow_map(), slow, lossless=True)
    for n in range(3):
        pipeline.put(at(n, TINY))
    assert isinstance(pipeline.close(), Statistics)
    assert len(answers) == 3


def test_a_driver_may_use_its_buffer_again_once_put_returns() -> None:
    """Each sweep waits while the buffer is filled with the next one."""
    answers: list[Answer] = []
    free, estimator = waiting_estimator()
    pipeline = Pipeline(estimator, answers.append, waiting=9, lossless=True)
    free.clear()
    points, intensity = TINY.points.copy(), np.zeros(len(TINY), np.float32)
    for n in range(4):
        points[:] = TINY.points * np.float32(1.0 + 0.1 * n)
        intensity[:] = n
        pipeline.put(TINY.replace(points=points, intensity=intensity, t_ns=n + 1))
    points[:], intensity[:] = np.nan, np.nan
    free.set()
    pipeline.close()
    assert len(answers) == 4
    for n, answer in enumerate(answers):
        sweep = answer.leveled.sweep
        np.testing.assert_array_equal(sweep.points, TINY.points * np.float32(1.0 + 0.1 * n))
        assert set(sweep.intensity.tolist()) == {float(n)}
        assert answer.estimate is not None
