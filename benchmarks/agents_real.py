"""Real sweeps as agents: ``python -m benchmarks.agents_real [--index FILE] [--recordings FOLDER] [--page FILE]``.

Two cars of a simulator's recording, sweeps of one drive taken as two agents, and one car with three LiDARs. There is no
truth: it is counted where views contradict each other, which objects both report, and whether an honest agent is
accused. Writes docs/results/agents_real.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np

from viewshed._page import facts, page, table
from viewshed.estimators import load_estimator
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.fusion.many import AgentReport, CommandCenter, joint_fov, match_agents
from viewshed.fusion.rounds import judged
from viewshed.fusion.view_checks import ClaimedView, misplaced
from viewshed.geometry import Rigid
from viewshed.io import read_index, read_indexed, read_sweep
from viewshed.perception.detector import Detector
from viewshed.preprocess.leveling import leveled_on
from viewshed.sweep import Sweep

ROOT = Path(__file__).resolve().parents[1]
SHARED = ROOT.parent / "shared"
PAGE = ROOT / "docs" / "results" / "agents_real.md"
RIG = Path("PJLab-ADG__SensorsCalibration/lidar2lidar/auto_calib/data")

BY_SEQUENCE = {
    "CARLA, two cars": ("co_perception_31_30", 2),
    "KITTI, one drive as two agents": ("kitti-raw-2011_09_26-drive_0001", 1),
    "nuScenes, one drive as two agents": ("nuscenes-n008-2018-08-01", 1),
}
"""What the names of sequences hold, and how many sweeps on the next round begins."""

APART_M = 60.0
"""Sweeps of one round are taken at most so far apart."""

BESIDE = 2
"""Cells about one in which another agent's surface counts as the same."""

Round = list[AgentReport]


@dataclass(slots=True)
class Found:
    """What the rounds of a group came to, sums over pairs of agents and rounds.

    Attributes:
        rounds: how many.
        both: cells that both see.
        contradicted: surfaces of one, in view of the other, where the other claims all about free; and surfaces.
        objects: reported by both, and by either where both claim to see.
        area: m² of each agent's own view, and of the joint one.
        turned: how many more surfaces would agree at another pose, a share for each pair.
        accused, disputed: rounds with an agent accused, or disputed.
    """

    rounds: int = 0
    both: float = 0.0
    contradicted: tuple[float, float] = (0.0, 0.0)
    objects: tuple[float, float] = (0.0, 0.0)
    area: tuple[float, float] = (0.0, 0.0)
    turned: tuple[float, ...] = ()
    accused: int = 0
    disputed: int = 0


def main() -> None:
    """Measure, print and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.agents_real", description=__doc__)
    parser.add_argument("--index", type=Path, default=SHARED / "data" / "index.json", help="index of real sweeps")
    parser.add_argument("--recordings", type=Path, default=SHARED / "recordings", help="folder of real recordings")
    parser.add_argument("--page", type=Path, default=PAGE, help="where the Markdown goes")
    chosen = parser.parse_args()
    groups = {name: list(of_sequence(chosen.index, *key)) for name, key in BY_SEQUENCE.items()}
    groups["one car, three LiDARs, three places"] = list(of_rig(chosen.recordings / RIG))
    text = page_of({name: found_in(rounds) for name, rounds in groups.items() if rounds})
    chosen.page.write_text(text, encoding="utf-8")
    print(text)


def of_sequence(index: Path, name: str, step: int) -> Iterator[Round]:
    """Yield the rounds of a sequence: two sweeps with poses each, one after the other in the index."""
    sweeps = [read_indexed(entry) for entry in read_index(index) if name in (entry.seq or "")]
    posed = [(sweep, sweep.world_from_sensor) for sweep in sweeps if sweep.world_from_sensor is not None]
    for k in range(0, len(posed) - 1, step):
        (first, here), (second, there) = posed[k : k + 2]
        if np.linalg.norm(here.translation - there.translation) < APART_M:
            yield [report_of(sweep, agent) for sweep, agent in ((first, "first"), (second, "second"))]


def of_rig(folder: Path) -> Iterator[Round]:
    """Yield what three LiDARs of one car see, at each of some places; poses are the rough ones beside them."""
    for place in sorted(folder.glob("*/initial_extrinsic.txt")):
        clouds = [next(place.parent.glob(f"{name}*.pcd")) for name in ("top", "left", "right")]
        lines = [line.split(":")[1].split() for line in place.read_text("utf-8").splitlines() if line.startswith("(")]
        # Tilts are not in the file; leveling finds them from the ground.
        poses = [Rigid.from_yaw(float(np.radians(float(line[2]))), [float(x) for x in line[3:]]) for line in lines]
        yield [
            report_of(read_sweep(cloud), name, pose)
            for cloud, name, pose in zip(clouds, ("top", "left", "right"), poses, strict=True)
        ]


def report_of(sweep: Sweep, agent: str, pose: Rigid | None = None) -> AgentReport:
    """Return what an agent reports of a sweep; a pose stands for the one that the sweep lacks."""
    estimator = load_estimator("shadow_map")
    leveled = leveled_on(sweep, estimator.grid)
    estimate = replace(estimator.estimate(leveled), agent=agent)
    if pose is not None:
        estimate = replace(estimate, world_from_level=pose)
    return AgentReport.of(estimate, Detector().detect(leveled))


def found_in(rounds: Sequence[Round]) -> Found:
    """Return what a center and the pairs of agents make of some rounds."""
    found, center = Found(), CommandCenter(tuple(report.agent for report in rounds[0]))
    for number, reports in enumerate(rounds):
        accused, disputed = judged(center.add(0.5 * number, reports))
        found.rounds += 1
        found.accused += bool(accused.any())
        found.disputed += bool(disputed.any())
        joint = joint_fov(
            [report.estimate for report in reports], reports[0].estimate.grid, reports[0].world_from_level
        )
        own = np.mean([report.estimate.area_m2() for report in reports])
        found.area = found.area[0] + float(own), found.area[1] + joint.estimate().area_m2()
        for one, other in combinations(reports, 2):
            for mine, theirs in ((one, other), (other, one)):
                wrong, surfaces, both = contradictions(mine.estimate, theirs.estimate)
                found.contradicted = found.contradicted[0] + wrong, found.contradicted[1] + surfaces
                found.both += both / 2
            common, either = objects_of(one, other)
            found.objects = found.objects[0] + common, found.objects[1] + either
            share = misplaced(ClaimedView(one.estimate, one.detections, (other.estimate,)))
            found.turned += (share,) if np.isfinite(share) else ()
    return found


def contradictions(one: FovEstimate, other: FovEstimate) -> tuple[float, float, float]:
    """Return surfaces of one, in view of the other, that the other claims free all about; surfaces; cells both see."""
    assert one.world_from_level is not None
    assert other.world_from_level is not None
    pose = other.world_from_level.inverse() @ one.world_from_level
    at = one.grid.centers @ pose.rotation[:2, :2].T + pose.translation[:2]
    cells, inside = other.grid.index(at)
    seen = (other.state == CellState.FREE) | (other.state == CellState.SURFACE)
    # A surface within two cells is the same one: two sensors see different sides of it.
    near = np.zeros_like(seen)
    for x in range(-BESIDE, BESIDE + 1):
        for y in range(-BESIDE, BESIDE + 1):
            near |= np.roll(other.state != CellState.FREE, (x, y), (0, 1))
    there = inside & seen[cells[..., 0], cells[..., 1]]
    free_about = there & ~near[cells[..., 0], cells[..., 1]]
    mine = one.state == CellState.SURFACE
    both = there & ((one.state == CellState.FREE) | mine)
    return float((mine & free_about).sum()), float((mine & there).sum()), float(both.sum())


def objects_of(one: AgentReport, other: AgentReport) -> tuple[float, float]:
    """Return how many objects both report, and how many either does where both claim to see."""
    members = match_agents([one.in_world, other.in_world])
    common = (members >= 0).all(axis=1).sum()
    either = float(common)
    for mine, theirs, column in ((one, other, 0), (other, one, 1)):
        alone = members[(members[:, column] >= 0) & (members[:, 1 - column] < 0), column]
        boxes = mine.in_world.boxes[alone]
        pose = theirs.world_from_level.inverse()
        at = boxes[:, :2] @ pose.rotation[:2, :2].T + pose.translation[:2]
        either += float((theirs.estimate.at(at) >= theirs.estimate.threshold).sum()) if len(boxes) else 0.0
    return float(common), either


def page_of(found: dict[str, Found]) -> str:
    """Return the page."""
    rows = []
    for name, one in found.items():
        wrong, surfaces = one.contradicted
        common, either = one.objects
        rows.append([
            name, str(one.rounds), f"{one.both:,.0f}", f"{wrong / max(surfaces, 1):.3f}",
            f"{np.mean(one.turned):.2f}" if one.turned else "–", f"{common:.0f} of {either:.0f}",
            f"{one.area[1] / max(one.area[0], 1):.2f}", f"{one.accused} / {one.disputed}",
        ])  # fmt: skip
    total = sum(one.rounds for one in found.values())
    accused = sum(one.accused for one in found.values())
    return page(
        "Real sweeps as agents",
        facts(sweeps="those of the folders named on the command line; they are not part of this project"),
        """Without truth: how far views of honest agents agree, and whether one is accused. Sweeps of one drive stand
for two agents that are where the car was at two times: whatever moved between them contradicts.""",
        "## Agreement",
        table(
            ["agents", "rounds", "cells both see", "contradicted", "misplaced", "objects both report", "joint area",
             "accused / disputed"],
            rows,
        ),
        f"""*Contradicted*: of the surface cells of one agent in view of the other, those where the other claims all
cells within {BESIDE} free. *Misplaced*: how many more surfaces would lie on the other's within 2 m and 3° of the stated
pose, as a share. *Objects*: reported by both, of those that either reports where both claim to see the center.
*Joint area*: over the mean of the agents' own. *Accused*: rounds, by the limits in the box. In all {accused} of {total}
rounds have an agent accused.""",
        "## What it cannot say",
        """Few rounds; the detector knows vehicles and people of a simulator. The side LiDARs of the car lie on their
side and see little ground; their poses are known to half a meter, their tilt is found from the ground. With two agents
nobody can say who is wrong.""",
    )  # fmt: skip


if __name__ == "__main__":
    main()
