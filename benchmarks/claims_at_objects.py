"""What a view says of an object: ``python -m benchmarks.claims_at_objects [--scenes N] [--page FILE]``.

A car hides its own center, so a receiver asks the cells one cell nearer to the sensor than the near face of a box,
never inside it. How well that tells which objects give five returns, beside other places to ask, and beside the beams
of the sweep themselves (``expected_returns``), which a receiver does not have. Writes
docs/results/claims_at_objects.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from viewshed._page import facts, page, table
from viewshed.datasets.recorder.drive import SEEN_RETURNS, drive_sweeps
from viewshed.estimators import load_estimator
from viewshed.fov.estimate import FovEstimate
from viewshed.fusion.claims import SMALL_M
from viewshed.fusion.view_checks import ELEVATED_M
from viewshed.objects import moved_boxes
from viewshed.preprocess.leveling import level
from viewshed.studies.agents.plan import AgentsPlan
from viewshed.studies.agents.scenes import GRID
from viewshed.tracking.views import BeamView, GridView, points_before

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "results" / "claims_at_objects.md"
SEED = 20_261_125
PLAN = replace(AgentsPlan.load("small"), seconds=8.0, hz=0.5, seed=SEED)
WITHIN_M, NEAREST_M = 50.0, 1.0
DRAWS = 500

CENTER, FACE, BEFORE, BEAMS = "the center", "the near face", "one cell before it", "the beams"
GROUPS = (
    "cars and larger, sensors on cars", "people and small, sensors on cars",
    "cars and larger, masts", "people and small, masts",
)  # fmt: skip
TARGET = 0.01

Floats = NDArray[np.float64]


def main() -> None:
    """Measure, print and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.claims_at_objects", description=__doc__)
    parser.add_argument("--scenes", type=int, default=16, help="worlds, each from a seed of its own")
    parser.add_argument("--page", type=Path, default=PAGE, help="where the Markdown goes")
    chosen = parser.parse_args()
    parts = []
    for number in range(chosen.scenes):
        parts.append(rows_of(number))
        print(f"scene {number}: {len(parts[-1])} objects", flush=True)
    text = page_of(np.concatenate(parts), chosen.scenes)
    chosen.page.write_text(text, encoding="utf-8")
    print(text)


def rows_of(number: int) -> Floats:
    """Return a row for each object near each sensor of a scene: scene, group, returns, then what each question says."""
    estimator, rows = load_estimator("shadow_map", grid=GRID), []
    for sweep, truth in drive_sweeps(PLAN.scene("test", number)):
        leveled = level(sweep, GRID)
        estimate = estimator.estimate(leveled)
        pose, basis = estimate.world_from_level, estimate.basis
        assert pose is not None
        assert basis is not None
        boxes = np.array([
            [*each.world_from_box.translation, *each.size_m, each.world_from_box.yaw] for each in truth.objects
        ])  # fmt: skip
        away = np.hypot(*(boxes[:, :2] - pose.translation[:2]).T)
        other = np.array([each.number != truth.carrier for each in truth.objects])
        near = (away < WITHIN_M) & (away > NEAREST_M) & other
        boxes, local = boxes[near], moved_boxes(boxes[near], pose.inverse())
        small = boxes[:, 3:5].max(axis=1, initial=0.0) < SMALL_M
        group = small + 2 * (basis.sensor_height_m > ELEVATED_M)
        said = {
            CENTER: estimate.at(local[:, :2]),
            FACE: at_points(estimate, points_before(local, 0.0)),
            BEFORE: GridView(estimate, 0.0).visible(boxes),
            BEAMS: BeamView(leveled, 0.0).visible(boxes),
        }
        columns = [np.full(len(boxes), number), group, truth.returns[near], *said.values()]
        rows.append(np.nan_to_num(np.column_stack(columns).astype(np.float64)))
    return np.concatenate(rows)


def at_points(estimate: FovEstimate, points: Floats) -> Floats:
    """Return the mean probability (K,) of the cells at points (K, P, 2)."""
    return np.asarray(np.nan_to_num(estimate.at(points)).mean(axis=1), np.float64)


def auroc(scores: Floats, seen: NDArray[np.bool_]) -> float:
    """Return the share of pairs of a seen and an unseen object in which the seen one scores higher, ties half."""
    bad = np.sort(scores[~seen])
    below = np.searchsorted(bad, scores[seen], "left") + np.searchsorted(bad, scores[seen], "right")
    return float(below.mean() / (2.0 * len(bad))) if len(bad) and seen.any() else float("nan")


def with_interval(rows: Floats, measure: Callable[[Floats], float]) -> str:
    """Return a measure of all rows with its 95 % interval by a bootstrap over scenes."""
    scenes = np.unique(rows[:, 0])
    together, rng = [rows[rows[:, 0] == scene] for scene in scenes], np.random.default_rng(SEED)
    drawn = [
        measure(np.concatenate([together[k] for k in rng.integers(len(scenes), size=len(scenes))]))
        for _ in range(DRAWS)
    ]
    low, high = np.nanquantile(drawn, (0.025, 0.975))
    return f"{measure(rows):.4f} [{low:.4f}, {high:.4f}]"


def page_of(rows: Floats, scenes: int) -> str:
    """Return the page."""
    names = (CENTER, FACE, BEFORE, BEAMS)
    cells = []
    for number, name in ((-1, "all"), *enumerate(GROUPS)):
        some = rows if number < 0 else rows[rows[:, 1] == number]
        areas = [auroc(some[:, 3 + k], some[:, 2] >= SEEN_RETURNS) for k in range(len(names))]

        def lost(part: Floats) -> float:
            seen = part[:, 2] >= SEEN_RETURNS
            return auroc(part[:, 6], seen) - auroc(part[:, 5], seen)

        cells.append([
            name, f"{len(some):,}", f"{(some[:, 2] >= SEEN_RETURNS).mean():.2f}", *(f"{area:.4f}" for area in areas),
            with_interval(some, lost), "met" if abs(lost(some)) <= TARGET else "**missed**",
        ])  # fmt: skip
    return page(
        "What a view says of an object",
        facts(seed=str(SEED), scenes=str(scenes)),
        f"""Objects within {WITHIN_M:g} m of four cars and a mast in {scenes} simulated scenes: does one give
{SEEN_RETURNS} returns? A receiver of a view may ask the cell of its center, the cells at its near face, or those one
cell nearer to the sensor on five lines of sight, as fusion does; whoever has the sweep can ask its beams.""",
        "## Where a view is asked",
        table(["objects", "number", "seen", *names, "beams less cells", "≤ .01"], cells),
        """AUROC of the probability for being seen; in brackets the 95 % interval of the difference over scenes. The
default estimate on its grid of .5 m; the beams of the same sweep, without the object's own returns. The view is one
for cars: of people, who give fewer returns, it says less.""",
    )  # fmt: skip


if __name__ == "__main__":
    main()
