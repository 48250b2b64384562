"""The pipeline: what becomes of each sweep, what is dropped, what an error costs, and that memory stays flat."""

import gc
import threading
import time
import weakref
from collections.abc import Callable, Iterable
from typing import Any, cast

import numpy as np
import pytest

from viewshed import load_estimator, read_sweep
from viewshed.estimators import Estimator
from viewshed.estimators.temporal import SweepBuffer, TemporalEstimator
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.geometry import Rigid
from viewshed.guarantees.certificate import certify
from viewshed.guarantees.envelope import Threat
from viewshed.io.samples import junction_path
from viewshed.monitor import IntegrityReport
from viewshed.monitor.evidence import SECTORS
from viewshed.monitor.stream_monitor import StreamMonitor, StreamReport
from viewshed.pipeline import Answer, Caution, Pipeline, Vehicle, speed_for_view
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sweep import Sweep

SWEEP = read_sweep(junction_path())
SMALL = SWEEP.select(np.arange(0, len(SWEEP), 4)).replace(ring=None)


def shadow_map() -> Estimator:
    return load_estimator("shadow_map")


def at(seconds: float, sweep: Sweep = SMALL) -> Sweep:
    return sweep.replace(t_ns=round(seconds * 1e9), world_from_sensor=Rigid.identity())


class Stub:
    """An estimator whose ``estimate`` is a function."""

    def __init__(self, estimate: Callable[..., Any]) -> None:
        self.grid, self.estimate = shadow_map().grid, estimate


def estimator_of(estimate: Callable[..., Any]) -> Estimator:
    return cast(Estimator, Stub(estimate))


def waiting_estimator() -> tuple[threading.Event, Estimator]:
    """Return an event, which is set, and an estimator that waits for it."""
    free = threading.Event()
    free.set()

    def estimate(leveled: LeveledSweep, history: object = None) -> FovEstimate:
        free.wait(60)
        return shadow_map().estimate(leveled)

    return free, estimator_of(estimate)


class Alarms:
    """A monitor that finds something in some sweeps."""

    def __init__(self, *numbers: int) -> None:
        self.numbers, self.count = numbers, -1

    def fresh(self) -> "Alarms":
        return self

    def check(self, leveled: LeveledSweep) -> StreamReport:
        self.count += 1
        suspect = np.arange(SECTORS) == 40
        now = IntegrityReport("by hand", float(self.count in self.numbers), 0.5, suspect=suspect)
        return StreamReport(now, now.inconsistent, 0.0, now.suspect, ("noted",) if now.inconsistent else ())


def alarming(*numbers: int) -> StreamMonitor:
    monitor: Any = Alarms(*numbers)
    return cast(StreamMonitor, monitor)


def answers_to(sweeps: Iterable[Sweep], agent: str = "ego", **settings: Any) -> list[Answer]:
    """Return what a pipeline publishes of sweeps that are put one after the other."""
    answers: list[Answer] = []
    with Pipeline(shadow_map(), answers.append, lossless=True, **settings) as pipeline:
        for sweep in sweeps:
            pipeline.put(sweep, agent)
    return answers


def test_answers_are_the_estimates_of_the_sweeps_in_their_order() -> None:
    sweeps, slow = [at(0.1 * n, SWEEP) for n in range(3)], Vehicle(braking_mps2=1.0)
    answers = answers_to(sweeps, "car", vehicle=slow)
    assert [(answer.number, answer.agent, answer.refused) for answer in answers] == [(n, "car", "") for n in range(3)]
    for answer, sweep in zip(answers, sweeps, strict=True):
        alone = shadow_map().estimate(sweep.replace(agent="car"))
        assert np.array_equal(answer.estimate.visible_prob, alone.visible_prob)
        assert np.array_equal(answer.estimate.state, alone.state)
        assert answer.speed_mps == speed_for_view(alone, slow) > 0
        assert answer.reaction.caution == Caution.KEEP


def test_history_helps_as_it_does_a_temporal_estimator() -> None:
    answers = answers_to([at(0.2 * n, SWEEP) for n in range(4)], history=SweepBuffer(every_s=0.1))
    alone = TemporalEstimator(shadow_map(), SweepBuffer(every_s=0.1))
    for n, answer in enumerate(answers):
        expected = alone.estimate(at(0.2 * n, SWEEP))
        assert np.array_equal(answer.estimate.visible_prob, expected.visible_prob)


def test_a_sweep_that_cannot_be_answered_costs_that_sweep_alone() -> None:
    def broken() -> Sweep:
        raise RuntimeError("a packet\nis missing")

    answers: list[Answer] = []
    pipeline = Pipeline(shadow_map(), answers.append, lossless=True)
    for source in (at(0.0), broken, at(0.1), at(0.1), at(0.05), at(60.0)):
        pipeline.put(source)
    statistics = pipeline.close()
    assert [answer.refused for answer in answers] == [
        "", "a packet is missing", "", "a sweep must have another time than the one before, got the same again", "", "",
    ]  # fmt: skip
    assert [answer.estimate is None for answer in answers] == [False, True, False, True, False, False]
    assert answers[4].notes == ("time went back by 0.05 s: the stream begins anew",)
    assert answers[5].notes == ("time jumped by 60 s: the stream begins anew",)
    assert (statistics.answered, statistics.dropped) == (4, 0)
    assert sum(statistics.refused.values()) == 2
    assert "4 answered, 0 dropped, 1 refused (a packet is missing)" in statistics.line()
    assert answers[1].reaction.caution == Caution.ASK
    assert answers[1].speed_mps == 0.0


def test_the_newest_sweep_wins_while_the_estimator_is_busy() -> None:
    answers: list[Answer] = []
    free, busy = waiting_estimator()
    pipeline = Pipeline(busy, answers.append, stale_after_s=np.inf)
    free.clear()
    for n in range(40):
        pipeline.put(at(n))
        time.sleep(0.02)
    free.set()
    statistics = pipeline.close()
    assert answers[-1].number == 39
    assert statistics.answered < 10
    assert len(answers) + sum(statistics.unpublished.values()) == statistics.answered
    assert statistics.answered + statistics.dropped == 40


def test_an_alarm_withdraws_claims_until_sweeps_were_calm() -> None:
    answers = answers_to(map(at, range(13)), monitor=alarming(1))
    cautions = [answer.reaction.caution for answer in answers]
    assert cautions == [Caution.KEEP] + [Caution.WIDEN] * 10 + [Caution.ASK] * 2
    assert [answer.notes for answer in answers[:3]] == [(), ("noted",), ()]
    clean, alarmed = answers[0].estimate, answers[1].estimate
    azimuth = np.arctan2(clean.grid.centers[..., 1], clean.grid.centers[..., 0])
    inside = (azimuth > np.radians(15)) & (azimuth < np.radians(30))  # sector 40, 20° to 25°, and those beside it
    assert (alarmed.state[inside] == CellState.UNKNOWN).all()
    assert np.array_equal(alarmed.state[~inside], clean.state[~inside])


GIVEN = read_sweep(junction_path(), sensor="hdl32e", sensor_height_m=1.84, attitude=[1, 0, 0, 0])


def certified_answer(sweep: Sweep, accused: bool = False, alarm: bool = True, only: bool = False) -> Answer:
    """Return the answer to a sweep of a pipeline that falls back to certified cells, or claims only these."""
    answers: list[Answer] = []
    with Pipeline(
        shadow_map(), answers.append, monitor=alarming(0) if alarm else None, certify=Threat("window", 5),
        certified_only=only, lossless=True,
    ) as pipeline:  # fmt: skip
        pipeline.accuse(["ego"] if accused else [])
        pipeline.put(at(0.0, sweep), "ego")
    return answers[0]


def test_an_alarm_falls_back_to_certified_cells() -> None:
    answer, clean = certified_answer(GIVEN), shadow_map().estimate(GIVEN)
    certificate = certify(level(GIVEN, clean.grid), clean, Threat("window", 5))
    azimuth = np.arctan2(clean.grid.centers[..., 1], clean.grid.centers[..., 0])
    suspect = (azimuth > np.radians(15)) & (azimuth < np.radians(30))
    assert answer.reaction.caution == Caution.WIDEN
    kept = answer.estimate.visible()
    assert (kept & suspect).any()
    assert np.array_equal(kept & suspect, certificate.certified_visible & suspect)
    assert np.array_equal(kept & ~suspect, clean.visible() & ~suspect)
    assert answer.notes == ("noted", certificate.line)


def test_without_an_alarm_only_what_is_certified_is_claimed_where_nothing_else_counts() -> None:
    usual, only = certified_answer(GIVEN, alarm=False), certified_answer(GIVEN, alarm=False, only=True)
    clean = shadow_map().estimate(GIVEN)
    certificate = certify(level(GIVEN, clean.grid), clean, Threat("window", 5))
    assert np.array_equal(usual.estimate.visible(), clean.visible())
    assert np.array_equal(only.estimate.visible(), certificate.certified_visible)
    assert only.reaction.caution == Caution.KEEP
    assert only.notes == (certificate.line,)
    assert only.speed_mps <= usual.speed_mps
    # What cannot be certified is not claimed, and the speed says so.
    for nothing in (
        certified_answer(GIVEN.replace(sensor_height_m=None), alarm=False, only=True),
        certified_answer(GIVEN, accused=True, only=True),
    ):
        assert not nothing.estimate.visible().any()
        assert nothing.speed_mps == 0.0
    with pytest.raises(ValueError, match="certified_only needs a threat"):
        Pipeline(shadow_map(), lambda _: None, certified_only=True)


def test_nothing_is_certified_of_an_accused_agent_or_by_what_a_sweep_says_of_itself() -> None:
    accused = certified_answer(GIVEN, accused=True)
    assert not accused.estimate.visible().any()
    assert accused.notes == ("noted",)
    inferred = certified_answer(GIVEN.replace(sensor_height_m=None))
    assert inferred.estimate is not None
    assert inferred.notes[-1].startswith("nothing certified: mounting height inferred")
    unknown = certified_answer(GIVEN.replace(model=None, infer_sensor=False, ring=None))
    assert unknown.notes[-1].startswith("nothing certified: ")
    assert (unknown.estimate is not None) == (unknown.refused == "")


def test_agents_are_remembered_apart_and_those_beyond_64_are_refused_and_counted() -> None:
    answers: list[Answer] = []
    pipeline = Pipeline(shadow_map(), answers.append, monitor=alarming(0), lossless=True)
    tiny = SMALL.select(np.arange(0, len(SMALL), 50))
    for n in range(70):
        pipeline.put(at(1.0, tiny), f"agent {n}")
    while len(answers) < 64:
        time.sleep(0.01)
    pipeline.put(at(2.0, tiny), "agent 0")
    said = pipeline.close()
    assert [answer.reaction.caution for answer in answers[:2]] == [Caution.WIDEN, Caution.KEEP]
    assert answers[64].reaction.caution == Caution.WIDEN  # remembered
    assert len(pipeline._agents) == 64
    assert said.refused == {"of more than 64 agents; give them a stream of their own": 6}


def test_an_agent_that_is_gone_holds_no_sweeps() -> None:
    with Pipeline(shadow_map(), lambda answer: None, history=SweepBuffer(), lossless=True) as pipeline:
        for seconds, agent in ((0.0, "gone"), (9.0, "here"), (15.0, "here")):
            pipeline.put(at(seconds), agent)
    kept = {agent.name: agent.history._kept for agent in pipeline._known() if agent.history is not None}
    assert [len(each) for each in kept["here"].values()] == [2]
    assert kept["gone"] == {}


def test_reasons_are_counted_apart_up_to_a_bound() -> None:
    pipeline = Pipeline(shadow_map(), lambda answer: None, lossless=True)
    for n in range(60):
        pipeline.put(lambda n=n: read_sweep(f"no file {n}"))  # type: ignore[misc]
    refused = pipeline.close().refused
    assert len(refused) == 51
    assert refused["for other reasons"] == 10


def test_objects_are_followed_for_each_agent_and_an_error_costs_only_them() -> None:
    pytest.importorskip("scipy", reason="scipy is not installed: nothing is tracked")
    from viewshed.detections import Detections
    from viewshed.objects.object_stream import ObjectStream

    calls = 0

    def fails_once(leveled: LeveledSweep, detections: Detections) -> Detections:
        nonlocal calls
        calls += 1
        if calls == 4:  # the first is the warm-up
            raise RuntimeError("detector broke\nin two lines")
        return detections

    answers: list[Answer] = []
    objects = ObjectStream(tamper=fails_once)
    with Pipeline(shadow_map(), answers.append, objects=objects, lossless=True) as pipeline:
        for n in range(4):
            pipeline.put(at(0.1 * n, SWEEP), "car")
        pipeline.put(at(0.4, SWEEP), "truck")
        pipeline.close()
    assert [answer.objects is None for answer in answers] == [False, False, True, False, False]
    assert answers[2].notes == ("no objects: detector broke in two lines",)
    assert answers[2].estimate is not None
    line = pipeline.statistics().line()
    assert "objects p50" in line
    assert line.endswith("1 failed")
    # The sweeps are of one instant: what is detected first is there in all of them, under its own number.
    ids = [set(a.objects.explained.tracks.ids[a.objects.shown].tolist()) for a in answers if a.objects is not None]
    assert ids[0] < ids[2]
    car, truck = answers[3].objects, answers[4].objects
    assert car.shown.sum() > truck.shown.sum()


def test_an_agent_that_a_center_accuses_is_believed_only_where_it_is_confirmed() -> None:
    answers: list[Answer] = []
    answered = threading.Semaphore(0)

    def publish(answer: Answer) -> None:
        answers.append(answer)
        answered.release()

    with Pipeline(shadow_map(), publish, lossless=True) as pipeline:
        for n in range(4):
            pipeline.accuse({"liar"} if n in (1, 2) else ())
            for agent in ("car", "liar"):
                pipeline.put(at(0.1 * n), agent)
                assert answered.acquire(timeout=30)
    cautions = {agent: [a.reaction.caution for a in answers if a.agent == agent] for agent in ("car", "liar")}
    assert set(cautions["car"]) == {Caution.KEEP}
    assert cautions["liar"] == [Caution.KEEP, Caution.CONFIRMED, Caution.CONFIRMED, Caution.CONFIRMED]
    accused = next(a for a in answers if a.agent == "liar" and a.reaction.caution == Caution.CONFIRMED)
    assert accused.estimate.area_m2() == 0.0


def test_a_suspicious_track_is_a_reason_to_ask() -> None:
    pytest.importorskip("scipy", reason="scipy is not installed: nothing is tracked")
    from viewshed.objects.object_stream import ObjectStream
    from viewshed_lab.threats.adversary import Adversary

    adversary = Adversary("fabricate_static", start_s=0.3, count=6, seed=1)
    objects = ObjectStream(tamper=adversary.detections)
    answers = answers_to([at(0.1 * n, SWEEP) for n in range(12)], objects=objects)
    suspicious = [
        a.objects is not None and bool((a.objects.shown & a.objects.explained.accused).any()) for a in answers
    ]
    assert any(suspicious)
    assert [a.reaction.caution == Caution.ASK for a, flag in zip(answers, suspicious, strict=True) if flag] == [
        True
    ] * sum(suspicious)
    assert answers[0].reaction.caution == Caution.KEEP


def test_a_closed_pipeline_is_freed_at_once() -> None:
    gc.disable()
    try:
        pipeline = Pipeline(shadow_map(), lambda _: None, monitor=StreamMonitor())
        pipeline.put(at(1.0))
        pipeline.close()
        freed = weakref.ref(pipeline)
        del pipeline
        assert freed() is None
    finally:
        gc.enable()
