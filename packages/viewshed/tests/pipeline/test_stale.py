"""Views that nothing follows: how old they are, when they are withdrawn, and who is told so."""

import threading
import time
from collections.abc import Callable

import numpy as np
import pytest
from tests.pipeline.test_failures import TINY
from tests.pipeline.test_stream import alarming, at, estimator_of, shadow_map

from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.pipeline import Answer, Caution, Pipeline, speed_for_view
from viewshed.preprocess.leveling import LeveledSweep

PERIOD_S = 0.05


def wait_for(condition: Callable[[], bool], most_s: float = 10.0) -> None:
    until_s = time.monotonic() + most_s
    while not condition() and time.monotonic() < until_s:
        time.sleep(0.005)
    assert condition()


def claims_nothing(answer: Answer | None) -> bool:
    return (
        answer.reaction.caution == Caution.STALE
        and answer.speed_mps == 0.0
        and bool((answer.estimate.state == CellState.UNKNOWN).all())
        and not answer.estimate.visible().any()
    )


def cautions(answers: list[Answer]) -> list[Caution]:
    return [answer.reaction.caution for answer in answers]


def test_where_sweeps_stop_a_stale_answer_is_published_once_and_fresh_ones_claim_again() -> None:
    answers: list[Answer] = []
    told: list[float] = []

    def publish(answer: Answer) -> None:
        answers.append(answer)
        told.append(time.perf_counter())

    with Pipeline(shadow_map(), publish, stale_after_s=0.3) as pipeline:
        for n in range(6):
            pipeline.put(at(PERIOD_S * n))
            time.sleep(PERIOD_S)
        wait_for(lambda: cautions(answers)[-1] == Caution.STALE)
        stale = answers[-1]
        assert set(cautions(answers[:-1])) == {Caution.KEEP}
        assert claims_nothing(stale)
        assert claims_nothing(pipeline.newest())
        assert 0.3 < told[-1] - stale.put_s < 0.3 + PERIOD_S + 0.2  # a busy machine is slow
        assert stale.number == 5
        assert stale.notes[0].endswith(" s old: nothing is claimed")
        count = len(answers)
        time.sleep(0.5)
        assert len(answers) == count
        assert stale.age_s > 0.8
        pipeline.put(at(5.0))
        wait_for(lambda: len(answers) > count)
        fresh = answers[count]
        assert fresh.reaction.caution == Caution.ASK
        assert fresh.speed_mps == speed_for_view(fresh.estimate) > 0.0


def test_each_agent_is_watched_by_itself() -> None:
    answers: list[Answer] = []
    with Pipeline(shadow_map(), answers.append, stale_after_s=0.4) as pipeline:
        pipeline.put(at(0.0, TINY), "gone")
        for n in range(14):
            pipeline.put(at(PERIOD_S * n, TINY), "here")
            time.sleep(PERIOD_S)
        wait_for(lambda: any(a.agent == "gone" and a.reaction.caution == Caution.STALE for a in answers))
        pipeline.put(at(9.0, TINY), "here")
        time.sleep(0.1)
        here, gone = pipeline.newest("here"), pipeline.newest("gone")
    assert claims_nothing(gone)
    assert here.reaction.caution < Caution.STALE
    assert pipeline.newest("nobody") is None


def test_a_slow_sensor_is_stale_after_two_of_its_periods() -> None:
    answers: list[Answer] = []
    with Pipeline(shadow_map(), answers.append, stale_after_s=0.05) as pipeline:
        for n in range(5):
            pipeline.put(at(0.3 * n, TINY))
            time.sleep(0.3)
        assert cautions(answers)[-3:] == [Caution.ASK] * 3  # by then two periods are known
        wait_for(lambda: cautions(answers)[-1] == Caution.STALE)
        assert answers[-1].age_s > 0.6


def test_an_answer_that_took_too_long_claims_nothing() -> None:
    answers: list[Answer] = []
    slow = threading.Event()

    def estimate(leveled: LeveledSweep, history: object = None) -> FovEstimate:
        if slow.is_set():
            time.sleep(0.5)
        return shadow_map().estimate(leveled)

    with Pipeline(estimator_of(estimate), answers.append, stale_after_s=0.4) as pipeline:
        slow.set()
        pipeline.put(at(0.0))
    assert len(answers) == 1
    assert claims_nothing(answers[0])
    assert answers[0].latency_s > 0.4


def test_sweeps_that_are_all_refused_do_not_keep_a_view_alive() -> None:
    answers: list[Answer] = []
    with Pipeline(shadow_map(), answers.append, stale_after_s=0.3) as pipeline:
        pipeline.put(at(0.0, TINY))
        for _ in range(12):
            time.sleep(PERIOD_S)
            pipeline.put(at(0.0, TINY))  # the time repeats
    assert cautions(answers)[:3] == [Caution.KEEP, Caution.ASK, Caution.ASK]
    assert cautions(answers)[-1] == Caution.STALE
    assert answers[-1].refused.startswith("a sweep must have another time")


def test_an_alarm_outlasts_a_gap() -> None:
    answers: list[Answer] = []
    with Pipeline(shadow_map(), answers.append, monitor=alarming(0), stale_after_s=0.2) as pipeline:
        pipeline.put(at(0.0))
        wait_for(lambda: Caution.STALE in cautions(answers))
        pipeline.put(at(0.4))
        wait_for(lambda: len(answers) == 3)
    assert cautions(answers) == [Caution.WIDEN, Caution.STALE, Caution.WIDEN]


def test_a_stream_that_ended_by_an_error_still_becomes_stale() -> None:
    answers: list[Answer] = []

    def out_of_order() -> None:
        raise SystemExit(1)

    pipeline = Pipeline(shadow_map(), answers.append, stale_after_s=0.2)
    pipeline.put(at(0.0, TINY))
    wait_for(lambda: bool(answers))
    pipeline.put(out_of_order)
    wait_for(lambda: cautions(answers)[-1] == Caution.STALE)
    with pytest.raises(RuntimeError, match="its decoding ended with SystemExit: 1"):
        pipeline.close()


@pytest.mark.parametrize("settings", [{"lossless": True, "stale_after_s": 0.1}, {"stale_after_s": np.inf}])
def test_files_are_never_stale(settings: dict[str, float]) -> None:
    answers: list[Answer] = []

    def publish(answer: Answer) -> None:
        time.sleep(0.2)
        answers.append(answer)

    with Pipeline(shadow_map(), publish, **settings) as pipeline:  # type: ignore[arg-type]
        pipeline.put(at(0.0, TINY))
        time.sleep(0.1)
        pipeline.put(at(0.1, TINY))
        time.sleep(0.4)
        newest = pipeline.newest()
    assert newest.reaction.caution == Caution.KEEP
    assert [answer.number for answer in answers] == [0, 1]


@pytest.mark.parametrize("stale_after_s", [0.0, -1.0, np.nan])
def test_an_age_that_nothing_reaches_is_refused(stale_after_s: float) -> None:
    with pytest.raises(ValueError, match=r"stale_after_s must be positive, got .*; give inf for never"):
        Pipeline(shadow_map(), lambda answer: None, stale_after_s=stale_after_s)
