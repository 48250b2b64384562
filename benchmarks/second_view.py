"""A second view against over-claim: ``python -m benchmarks.second_view [--scenes N] [--page FILE] [--work FOLDER]``.

The LiDAR of one of five agents is spoofed so that a wedge of its view opens, sweep after sweep. Its claims in the wedge
are kept only where another agent that is trusted enough claims the same (``viewshed.fusion.many.confirmed``): with
honest agents, and with one that claims all of the wedge. Writes docs/results/second_view.md. The scenes are those of
``benchmarks.agent_cases``; ``--work`` keeps them and their counts.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.agent_cases import MAST, ONSET_S, PLAN, SEED, scene_of
from benchmarks.agent_scenes import Mask, as_view, share
from viewshed._page import facts, page, table
from viewshed.datasets.simulated import ScenePlan, scan_frame
from viewshed.estimators import load_estimator
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.fusion.many import AgentReport, CommandCenter, claimed_at, confirmed
from viewshed.grid import polar_of_cells
from viewshed.perception.detector import Detector
from viewshed.preprocess.leveling import level
from viewshed.sim.truth.exact import exact_truth
from viewshed.sim.world import World
from viewshed.studies.agents.scenes import GRID, Scene, scene_world
from viewshed.studies.cases import generator
from viewshed.threats.attacks import ATTACKS
from viewshed.threats.attacks.base import Wedge

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "results" / "second_view.md"

ATTACK_NAMES = ("far_wall", "removal_and_far_wall_aimed")
"""Which scenes take in turn: aimed at a near obstacle, and where the wedge opens most."""

WITHIN_M = 50.0
"""As far as the attacks open a view."""

LEAST_TRUST = 0.5
LOOKED_AT_S = (5.25, 7.25, 9.25, 11.25)

ALONE = "alone"
ROWS: dict[str, str] = {
    ALONE: "",
    "one honest view, each of four": "≥ .95",
    "one honest view, the nearest car": "≥ .95",
    "one honest view, the mast": "",
    "four honest views, one agrees": "≥ .95",
    "four honest views, two agree": "",
    "a liar of five, believed, one agrees": "",
    "a liar of five, by its trust, one agrees": "≥ .90",
    "a liar of five, believed, two agree": "≥ .90",
    "a liar of five, by its trust, two agree": "",
}
"""What confirms the claims, and the target of their precision."""

Counts = dict[str, list[float]]


def main() -> None:
    """Run the scenes, print and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.second_view", description=__doc__)
    parser.add_argument("--scenes", type=int, default=16, help="worlds, each from a seed of its own")
    parser.add_argument("--work", type=Path, help="where scenes are kept; a new folder if not given")
    parser.add_argument("--page", type=Path, default=PAGE, help="where the Markdown goes")
    chosen = parser.parse_args()
    scenes = []
    with tempfile.TemporaryDirectory() as scratch:
        work: Path = chosen.work or Path(scratch)
        work.mkdir(parents=True, exist_ok=True)
        for number in range(chosen.scenes):
            path = work / f"second-view-{number:03d}.json"
            if not path.exists():
                path.write_text(json.dumps(run(number, scene_of(number, work))), encoding="utf-8")
            scenes.append(json.loads(path.read_text(encoding="utf-8")))
            print(f"scene {number}: liar trusted {scenes[-1]['trust']}", flush=True)
    text = page_of(scenes)
    chosen.page.write_text(text, encoding="utf-8")
    print(text)


def run(number: int, scene: Scene) -> Counts:
    """Return what a scene came to: by row the cells claimed, of these right, right for the victim; and true cells."""
    rng = generator(SEED, "second view", number)
    victim, liar = (int(agent) for agent in rng.permutation(MAST)[:2])
    plan = PLAN.scene("test", number)
    world = scene_world(PLAN, "test", number)
    attack: Any = ATTACKS[ATTACK_NAMES[number % len(ATTACK_NAMES)]]()
    wedge: Wedge | None = None
    center, counts = CommandCenter(scene.agents), defaultdict[str, list[float]](lambda: [0.0, 0.0, 0.0])
    for time, t_s in enumerate(scene.times_s.tolist()):
        said = scene.reports(time)
        if t_s >= ONSET_S:
            sweep = scan_frame(plan, time * len(said) + victim, world=world)[1].sweep()
            wedge = wedge or attack.aim(sweep, rng)
            attack = replace(attack, azimuth=wedge.azimuth)
            leveled = level(attack.apply(sweep, rng).sweep, GRID)
            estimate = replace(_estimator().estimate(leveled), agent=said[victim].agent)
            said[victim] = replace(said[victim], estimate=estimate, detections=_detector().detect(leveled))
        honest = [report.estimate for report in said]
        if wedge is not None:
            said[liar] = replace(said[liar], estimate=opened(honest[liar], honest[victim], wedge))
        trust = center.add(t_s, said).verdicts.trust
        if wedge is not None and any(abs(t_s - at) < 1e-6 for at in LOOKED_AT_S):
            truths = truths_of(plan, world, time, len(said))
            count(counts, said, honest, truths, victim, wedge, trust)
    counts["trust"] = [round(float(trust[liar]), 3), float(trust[liar] < LEAST_TRUST), 1.0]
    return dict(counts)


def opened(view: FovEstimate, victim: FovEstimate, wedge: Wedge) -> FovEstimate:
    """Return a view that claims every cell of the victim's wedge free."""
    assert view.world_from_level is not None
    assert victim.world_from_level is not None
    pose = victim.world_from_level.inverse() @ view.world_from_level
    at = view.grid.centers @ pose.rotation[:2, :2].T + pose.translation[:2]
    cells = wedge.holds(np.arctan2(at[..., 1], at[..., 0])) & (np.hypot(at[..., 0], at[..., 1]) < WITHIN_M)
    return replace(
        view, visible_prob=np.where(cells, np.float32(0.98), view.visible_prob),
        state=np.where(cells, np.uint8(CellState.FREE), view.state),
    )  # fmt: skip


def truths_of(plan: ScenePlan, world: World, time: int, agents: int) -> list[FovEstimate]:
    """Return what each agent could see at a time, as views."""
    out = []
    for number in range(agents):
        scan, agent = scan_frame(plan, time * agents + number, world=world)[0], world.agents[number]
        truth, known = exact_truth(scan, world, GRID, agent=agent)
        out.append(as_view(truth, known, scan.world_from_sensor, agent.name))
    return out


def count(
    counts: dict[str, list[float]], said: Sequence[AgentReport], honest: Sequence[FovEstimate],
    truths: Sequence[FovEstimate], victim: int, wedge: Wedge, trust: NDArray[np.float64],
) -> None:  # fmt: skip
    """Add one time of a scene: cells claimed in the wedge, visible to anybody, visible to the victim."""
    view, pose = honest[victim], honest[victim].world_from_level
    assert pose is not None
    range_m, azimuth = polar_of_cells(GRID)
    states = np.array([claimed_at(truth, GRID, pose)[1] for truth in truths])
    cells: Mask = wedge.holds(azimuth) & (range_m < WITHIN_M) & (states[victim] != CellState.UNKNOWN)
    own, anybody = states[victim] == CellState.FREE, (states == CellState.FREE).any(axis=0)
    others = [number for number in range(len(said)) if number != victim]
    cars = [number for number in others if number != MAST]
    away = [np.hypot(*(said[n].world_from_level.translation - pose.translation)[:2]) for n in cars]
    nearest = cars[int(np.argmin(away))]
    all_trusted, lying = np.ones(len(others)), [said[number].estimate for number in others]
    plain = [honest[number] for number in others]
    by_trust = trust[others]

    def add(row: str, kept: FovEstimate) -> None:
        claimed = cells & kept.visible()
        for place, right in enumerate((claimed, claimed & anybody, claimed & own)):
            counts[row][place] += float(right.sum())

    def add_confirmed(row: str, views: list[FovEstimate], weights: NDArray[np.float64], votes: int = 1) -> None:
        add(row, confirmed(view, cells, views, weights, LEAST_TRUST, votes))

    add(ALONE, view)
    for number in others:
        add_confirmed("one honest view, each of four", [honest[number]], np.ones(1))
    add_confirmed("one honest view, the nearest car", [honest[nearest]], np.ones(1))
    add_confirmed("one honest view, the mast", [honest[MAST]], np.ones(1))
    for words, views in (("four honest views", plain), ("a liar of five, believed", lying)):
        add_confirmed(f"{words}, one agrees", views, all_trusted)
        add_confirmed(f"{words}, two agree", views, all_trusted, 2)
    add_confirmed("a liar of five, by its trust, one agrees", lying, by_trust)
    add_confirmed("a liar of five, by its trust, two agree", lying, by_trust, 2)
    counts["true"][0] += float((cells & own).sum())
    counts["true"][1] += float(cells.sum())


def _estimator() -> Any:
    return load_estimator("shadow_map", grid=GRID)


def _detector() -> Detector:
    return Detector()


def page_of(scenes: Sequence[Counts]) -> str:
    """Return the page."""

    def column(row: str, place: int) -> list[float]:
        return [scene[row][place] for scene in scenes]

    true = column("true", 0)
    rows = []
    for row, target in ROWS.items():
        times = 4.0 if row.endswith("each of four") else 1.0
        reached = sum(column(row, 1)) / max(sum(column(row, 0)), 1.0)
        recall = share(column(row, 2), [times * one for one in true])
        met = ""
        if target:
            enough = sum(column(row, 2)) >= 0.5 * times * sum(true)
            met = "met" if enough and reached >= float(target[2:]) else "**missed**"
        rows.append(
            [row, share(column(row, 1), column(row, 0)), share(column(row, 2), column(row, 0)), recall, target, met]
        )
    found = sum(column("trust", 1))
    return page(
        "A second view against over-claim",
        facts(seed=str(SEED), scenes=str(len(scenes))),
        f"""The LiDAR of one of four cars is spoofed from {ONSET_S:g} s on, in every sweep, so that obstacles vanish in
a wedge of 30° and a wall stands behind them (`{ATTACK_NAMES[0]}` and `{ATTACK_NAMES[1]}` in turn, all beams of the
wedge). Its claims there are kept where other agents claim the same cells. The liar claims the whole wedge, and reports
objects as they are. {len(scenes)} scenes with {len(LOOKED_AT_S)} times each, exact truth, default estimate.""",
        "## What confirms the claims",
        table(["confirmed by", "precision", "precision, own", "recall", "target at recall ≥ .5", ""], rows),
        f"""*Precision*: of the cells claimed in the wedge within {WITHIN_M:g} m, those that some agent's sensor could
see; *own*: that the victim's could. *Recall*: of what the victim could see there, what is still claimed.
*By its trust*: an agent confirms if the center trusts it by {LEAST_TRUST:g}; at the end that held for
{len(scenes) - found:.0f} of the {len(scenes)} liars, because trust is of reports about objects, and views are checked
apart from it. In brackets 95 % intervals over scenes.""",
        """What several see is lost where only one looks: recall falls with the number that must agree. Two that lie
together confirm each other wherever two suffice.""",
    )


if __name__ == "__main__":
    main()
