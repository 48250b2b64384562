"""A scene run in a case: what a center that trusts, one that does not, and the published trust make of the reports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.datasets.recorder.drive import SEEN_RETURNS
from viewshed.fusion.claims import ClaimTable
from viewshed.fusion.many import FAR_M, AgentReport, CommandCenter
from viewshed.fusion.view_checks import ClaimedView, check_view
from viewshed.object_metrics import gospa
from viewshed.studies.agents.lies import FABRICATED_SIZE_M, LIES, Liars
from viewshed.studies.agents.plan import ONSET_S
from viewshed.studies.agents.published import PublishedTrust
from viewshed.studies.agents.scenes import Scene
from viewshed.studies.cases import generator
from viewshed.tracking.views import GridView

CHECKED_TIMES = 3
"""Times of a scene, evenly after the onset, at which views are checked."""

FOUND_M = 2.0
"""A detection this near to an object is of it."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Run:
    """What one case of a scene came to; plain values, which a line of results holds.

    Attributes:
        case: ``HONEST`` or a lie.
        liars: numbers of the agents that lied.
        victim: of a lie about another one, or -1.
        evidence: [T][A] natural logarithm of the e-value against each agent.
        doubt: [T] of all.
        trust: [T][A].
        published_trust: [T][A], of the published formulas.
        suspects: [T][A] 0 or 1.
        checks: [A][C] of the claimed views, the mean over some times; None where a check abstained.
        gospa: by center, [T] meters.
        touched: [T] objects, or share of the area, that the liars changed.
        overlap: other honest agents that see the places which were lied about, on average; NaN for lies about views.
    """

    case: str
    liars: list[int]
    victim: int
    evidence: list[list[float]]
    doubt: list[float]
    trust: list[list[float]]
    published_trust: list[list[float]]
    suspects: list[list[int]]
    checks: list[list[float | None]]
    gospa: dict[str, list[float]]
    touched: list[float]
    overlap: float


def run_case(scene: Scene, case: str, seed: tuple[int, str, int], claims: ClaimTable) -> Run:
    """Return what a case of a scene comes to."""
    agents = scene.agents
    rng = generator(*seed, case)
    order = [int(number) for number in rng.permutation(len(agents))]
    lie = LIES.get(case)
    count = min(lie.liars, (len(agents) - 1) // 2) if lie is not None else 0
    liars = None if lie is None else Liars(lie, tuple(order[:count]), order[count] if lie.flips else -1, rng)
    said = list(_said(scene, liars))

    centers = {
        "ours": CommandCenter(agents, claims=claims),
        "no trust": CommandCenter(agents, claims=claims, trusting=True),
    }
    distances: dict[str, list[float]] = {name: [] for name in (*centers, "published")}
    evidence, doubt, trust, suspects, published_trust = [], [], [], [], []
    published = PublishedTrust()
    for time, reports in enumerate(said):
        truth = seen_objects(scene, time)
        for name, center in centers.items():
            picture = center.add(float(scene.times_s[time]), reports)
            shown = picture.tracks.confirmed if center.trusting else picture.believed
            distances[name].append(gospa(picture.tracks.boxes[shown, :2], truth[:, :2]).distance_m)
            if center.trusting:
                agents_trust, believed = published.add(picture, reports)
                published_trust.append(agents_trust)
                distances["published"].append(gospa(picture.tracks.boxes[believed, :2], truth[:, :2]).distance_m)
            else:
                evidence.append(picture.verdicts.evidence)
                doubt.append(picture.verdicts.doubt)
                trust.append(picture.verdicts.trust)
                suspects.append(picture.verdicts.suspects)
    return Run(
        case, list(liars.numbers) if liars else [], liars.victim if liars else -1, _rounded(evidence), _rounded(doubt),
        _rounded(trust), _rounded(published_trust), np.array(suspects, int).tolist(), checked(scene, said),
        {name: _rounded(values) for name, values in distances.items()}, liars.touched if liars else [],
        overlap_of(scene, liars) if liars else float("nan"),
    )  # fmt: skip


def overlap_of(scene: Scene, liars: Liars) -> float:
    """Return how many other agents see the places that were lied about last, on average; NaN where there are none."""
    if liars.places is None or not len(liars.places):
        return float("nan")
    boxes = np.zeros((len(liars.places), 7))
    boxes[:, :2], boxes[:, 3:6] = liars.places[:, :2], FABRICATED_SIZE_M
    see = [
        GridView(report.estimate, 0.0).visible(boxes) * (report.range_m(boxes) < FAR_M)
        for number, report in enumerate(scene.reports(len(scene.times_s) - 1)) if number not in liars.numbers
    ]  # fmt: skip
    return float(np.sum(see, axis=0).mean())


def _said(scene: Scene, liars: Liars | None) -> list[list[AgentReport]]:
    """Return what all agents say, time after time."""
    out = []
    for time, t_s in enumerate(scene.times_s):
        reports = scene.reports(time)
        if liars is not None:
            reports = liars.forge(reports) if t_s >= ONSET_S else liars.look(reports)
        out.append(reports)
    return out


def checked(scene: Scene, said: Sequence[Sequence[AgentReport]]) -> list[list[float | None]]:
    """Return what every check says of each agent's claims [A][C], the mean over some times after the onset."""
    first = int(np.searchsorted(scene.times_s, ONSET_S)) + 1
    times = np.unique(np.linspace(first, len(said) - 1, CHECKED_TIMES).round().astype(int))
    out: list[list[float | None]] = []
    for number, _ in enumerate(scene.agents):
        rows = []
        for time in times:
            now = said[time]
            others = tuple(report.estimate for place, report in enumerate(now) if place != number)
            before = said[time - 1][number].estimate
            rows.append(check_view(ClaimedView(now[number].estimate, now[number].detections, others, before)))
        known: NDArray[np.bool_] = np.isfinite(np.array(rows))
        mean = np.where(known, rows, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        some: list[bool] = np.asarray(known.any(axis=0)).tolist()
        out.append([float(f"{value:.5g}") if is_known else None for value, is_known in zip(mean, some, strict=True)])
    return out


def seen_objects(scene: Scene, time: int) -> Floats:
    """Return the boxes (K, 7) of the objects that some agent sees at a time, near enough to report them."""
    returns = scene.returns[time].copy()
    places = scene.poses[time, :, :2, 3]
    away = np.linalg.norm(scene.objects[time, None, :, :2] - places[:, None], axis=2)
    own = scene.carriers >= 0
    returns[np.flatnonzero(own), scene.carriers[own]] = 0
    seen = ((returns >= SEEN_RETURNS) & (away < FAR_M)).any(axis=0)
    boxes: Floats = scene.objects[time, seen]
    return boxes


def claims_of(scene: Scene) -> dict[str, NDArray[Any]]:
    """Return what agents claim of all objects near them, and which they see and report: columns of N rows."""
    columns: dict[str, list[NDArray[Any]]] = {
        name: [] for name in ("prob", "boxes", "range_m", "elevated", "found", "returns")
    }
    for time in range(0, len(scene.times_s), 4):
        for number, report in enumerate(scene.reports(time)):
            boxes = scene.objects[time]
            range_m = report.range_m(boxes)
            near = (range_m < FAR_M) & (range_m > 1.0) & (np.arange(len(boxes)) != scene.carriers[number])
            xy = report.in_world.boxes[:, :2]
            away = np.linalg.norm(boxes[near, None, :2] - xy[None], axis=2)
            columns["prob"].append(GridView(report.estimate, 0.0).visible(boxes[near]))
            columns["boxes"].append(boxes[near])
            columns["range_m"].append(range_m[near])
            columns["elevated"].append(np.full(int(near.sum()), report.elevated))
            columns["found"].append(away.min(axis=1, initial=np.inf) < FOUND_M)
            columns["returns"].append(scene.returns[time, number, near])
    return {name: np.concatenate(parts) for name, parts in columns.items()}


def _rounded(values: Any) -> Any:
    return np.round(np.array(values, np.float64), 4).tolist()
