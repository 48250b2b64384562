"""The figures that were aimed at, each beside what was found, met or missed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from viewshed.metrics import Scores
from viewshed.successor.chosen import POINTS, UNTOUCHED
from viewshed.successor.contest import BARE, BENIGN, TOUCHING
from viewshed.successor.parts import CLEAR, SENSOR
from viewshed.successor.plan import WHOLE
from viewshed.successor.remembered import ATTACKED, HONEST, WARY
from viewshed.successor.results import JAMMING, Results
from viewshed.visible import PEDESTRIAN

OURS, FLOAT, SEVERAL, RIVAL = "viewnet", "viewnet, float32", "viewnet, 20 passes", "vote"
"""Our network in bytes, in float32 and with dropout passes, and the classical estimator that it must beat."""
SHADOW_MAP = "shadow_map"
"""The classical estimator that earlier sweeps help."""


@dataclass(frozen=True, slots=True)
class Target:
    """One figure.

    Attributes:
        what: it is of.
        wanted: in words.
        found: in words.
        met: whether.
    """

    what: str
    wanted: str
    found: str
    met: bool


def targets_of(validation: Results, test: Results, chosen: Results) -> list[Target]:
    """Return the targets with what was found on the reported scenes; none where our network was not tried."""
    if OURS not in test.said:
        return []
    return [
        *_agreement(test),
        *_parts(test),
        *_wedges(validation, test),
        *_remembering(test),
        *_chosen(chosen),
        *_calibration(test),
        *_doubt(test),
    ]


def targets_elsewhere(test: Results) -> list[Target]:
    """Return the targets of another setting; none where our network was not tried."""
    return list(_elsewhere(test)) if OURS in test.said else []


def _elsewhere(test: Results) -> Iterator[Target]:
    families = [case for case in TOUCHING if case != JAMMING]
    benign, mean = test.f1(OURS, [BENIGN]), test.f1(OURS, families)
    pedestrian = test.plan.config_in(test.setting).target == PEDESTRIAN.name
    yield _at_least("F1, benign", benign, 0.94 if pedestrian else 0.96)
    if not pedestrian:
        yield from _clear(test)
    yield _at_least("mean F1 over the attacks, jamming apart", mean, 0.93)
    yield _lead(test, (BENIGN, *TOUCHING), "least lead over the vote, benign and under any attack")


def _agreement(test: Results) -> Iterator[Target]:
    families = [case for case in TOUCHING if case != JAMMING]
    benign, bare = (test.f1(OURS, [case]) for case in (BENIGN, BARE))
    mean, rival = (test.f1(name, families) for name in (OURS, RIVAL))
    jammed = test.f1(OURS, [JAMMING])
    yield _at_least("F1, benign", benign, 0.96)
    yield _at_least("mean F1 over the attacks, jamming apart", mean, 0.93)
    yield Target("the same less that of the vote", "≥ .020", f"{mean - rival:+.3f}", mean - rival >= 0.02)
    yield _lead(test, TOUCHING, "least lead over the vote under any attack")
    yield _at_least("F1, jamming", jammed, 0.88)
    yield Target("F1 without rings, less that with rings", "≥ -.020", f"{bare - benign:+.3f}", bare - benign >= -0.02)
    if FLOAT in test.said:
        for words, cases in (("benign", [BENIGN]), ("mean over the attacks", list(TOUCHING))):
            less = test.f1(OURS, cases) - test.f1(FLOAT, cases)
            yield Target(f"F1 in bytes, less that in float32, {words}", "≥ -.002", f"{less:+.4f}", less >= -0.002)
    seen, unseen = test.f1(OURS, test.trained), test.f1(OURS, test.unseen)
    found = f"{unseen - seen:+.3f}"
    yield Target("mean F1, unseen attacks less those trained on", "≥ -.020", found, unseen - seen >= -0.02)


def _lead(test: Results, cases: Iterable[str], what: str) -> Target:
    leads = {case: test.f1(OURS, [case]) - test.f1(RIVAL, [case]) for case in cases if case in test.said[OURS]}
    worst = min(leads, key=lambda case: leads[case])
    return Target(what, "≥ 0", f"{leads[worst]:+.3f} ({worst})", leads[worst] >= 0)


def _parts(test: Results) -> Iterator[Target]:
    sensors = {part: test.f1_of_part(OURS, part) for part in test.parts if part.startswith(SENSOR)}
    yield from _clear(test)
    if sensors:
        worst = min(sensors, key=lambda part: sensors[part])
        found = f"{sensors[worst]:.3f} ({worst.removeprefix(SENSOR)})"
        yield Target("least F1 of any sensor, benign", "≥ 0.93", found, sensors[worst] >= 0.93)


def _clear(test: Results) -> Iterator[Target]:
    if CLEAR in test.parts:
        yield _at_least(f"F1, benign, cells {CLEAR}", test.f1_of_part(OURS, CLEAR), 0.98)


def _wedges(validation: Results, test: Results) -> Iterator[Target]:
    if WHOLE not in validation.said:
        return
    step, (seen, unseen) = validation.sure, test.opening
    for words, cases, wanted in (("trained on", seen, 0.8), ("unseen", unseen, 0.5)):
        scores = test.wedge(OURS, cases)
        precision, recall = scores.precision(step), scores.recall(step)
        told = f"{precision:.3f} / {recall:.3f} from {step:g}" if scores.counts(step)[0] else "no such probability"
        met = precision >= wanted and recall >= 0.5
        what = f"precision / recall in opened wedges after abstention, {words}"
        yield Target(what, f"≥ {wanted:.2f} / .50", told, met)


def _remembering(test: Results) -> Iterator[Target]:
    for kind, honest in ((HONEST, True), (ATTACKED, False)):
        name = f"{OURS}, {WARY}{kind}"
        for words, cases in zip(("trained on", "unseen"), test.opening, strict=True):
            if name in test.said:
                scores = test.wedge(name, cases)
                precision, recall = scores.precision(), scores.recall()
                what = f"precision / recall in opened wedges, wary of earlier sweeps{'' if honest else ', attacked'}"
                met = precision >= 0.9 and recall >= 0.5
                yield Target(f"{what}, {words}", "≥ 0.90 / .50", f"{precision:.3f} / {recall:.3f}", met)


def _chosen(chosen: Results) -> Iterator[Target]:
    for case, said in chosen.said.get(OURS, {}).items():
        if case != UNTOUCHED:
            precision, wedge = said.view.precision(), said.wedge.precision()
            what = f"precision against {POINTS} points chosen with {case} questions"
            yield Target(what, "≥ 0.90", f"{precision:.3f} (wedge {wedge:.3f})", precision >= 0.9)


def _calibration(test: Results) -> Iterator[Target]:
    for words, cases, most in (("benign", (BENIGN,), 0.02), ("unseen attacks", test.unseen, 0.05)):
        ece = test.ece(OURS, cases)
        yield Target(f"ECE, {words}", f"≤ {most}", f"{ece:.4f}", ece <= most)


def _doubt(test: Results) -> Iterator[Target]:
    if SEVERAL not in test.said:
        return
    for words, cases in (("benign", (BENIGN,)), ("attacked", TOUCHING)):
        one, several = (sum(test.view(name, cases), Scores()) for name in (OURS, SEVERAL))
        for name in ("brier", "aurc", "aurc_std"):
            ours, theirs = getattr(one, name)(), getattr(several, name)()
            what = f"{_NAMES[name]} of one pass beside that of 20, {words}"
            yield Target(what, f"≤ {theirs:.4f}", f"{ours:.4f}", ours <= theirs)


_NAMES = {"brier": "Brier score", "aurc": "AURC", "aurc_std": "AURC by deviation"}


def _at_least(what: str, found: float, wanted: float) -> Target:
    return Target(what, f"≥ {wanted:.2f}", f"{found:.3f}", found >= wanted)
