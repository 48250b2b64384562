"""Strips of pictures of tracks and of trust: ``python -m benchmarks.strips [truck] [ghost] [flip] [--out FOLDER]``.

``truck``: a simulated car goes behind a parked truck, with the published tracker and with ours. ``ghost``: a detection
is fabricated in a simulated street, and named. ``flip``: one agent tries to have an honest one expelled (after
TrustFlip, arXiv 2605.22122), with the trust of each agent by ours and by the published formulas (mate). Writes
strip_truck.png, strip_ghost.png, strip_flip.png and trust_timeline.png, to docs/assets if no folder is named.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from tests.tracking.test_behind_a_truck import CAR, DT_S, GRID, PARKED, drive, published_view

from viewshed import load_estimator
from viewshed.datasets.presets import preset_named
from viewshed.datasets.recorder.drive import drive_plan, drive_sweeps
from viewshed.estimators import ESTIMATORS
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.fusion.cells import SeenCells
from viewshed.fusion.claims import claim_table
from viewshed.fusion.explained import ExplainedTracks
from viewshed.fusion.honest import honest_model
from viewshed.fusion.legend import LEGEND
from viewshed.fusion.many import joint_fov
from viewshed.fusion.object_stream import ObjectStream
from viewshed.fusion.sensor_view import SensorView
from viewshed.fusion.single import SingleFusion
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.object_metrics import match_objects
from viewshed.objects import moved_boxes
from viewshed.perception.detector import Detector
from viewshed.perception.matching import corners_of
from viewshed.plot import COLORS
from viewshed.preprocess.leveling import level
from viewshed.studies.agents.plan import ONSET_S, AgentsPlan
from viewshed.studies.agents.runs import Run, SceneCases
from viewshed.studies.agents.scenes import Scene
from viewshed.threats.adversary import Adversary
from viewshed.tracking.published import PublishedRules
from viewshed.tracking.tracker import Tracker
from viewshed.tracking.views import BeamView, PolygonView

mpl.use("Agg")
import matplotlib.pyplot as plt

ASSETS = Path(__file__).resolve().parents[1] / "docs" / "assets"

Floats = NDArray[np.float64]

TRUCK_SWEEPS = (5, 12, 19, 24, 38)
"""Before, going behind it, behind it, just out, and later."""

COAST_S = 1.0
"""Of the published tracker: a track ends when nothing was matched for so long."""

GHOST_WORLD, GHOST_SEED, GHOST_FROM_S, GHOST_SWEEPS = 5, 37, 1.0, (9, 10, 13, 17, 24)
"""Seeds of the street and of the attacker (of 60 the one whose ghost stands free ahead), its start, sweeps drawn."""

GATE_M = 2.0
"""A track so near to the ghost is of it."""

FLIP = "flip_together"
"""Two agents contradict one honest agent only."""


def main() -> None:
    """Draw the strips that are named, or all."""
    strips: dict[str, Callable[[Path, Path], None]] = {"truck": draw_truck, "ghost": draw_ghost, "flip": draw_flip}
    parser = argparse.ArgumentParser(prog="python -m benchmarks.strips", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"some of {', '.join(strips)}; all if none")
    parser.add_argument("--out", type=Path, default=ASSETS, help="folder of the pictures")
    parser.add_argument("--work", type=Path, default=Path("strips"), help="folder in which scenes of agents are kept")
    chosen = parser.parse_args()
    for name in chosen.names or strips:
        if name not in strips:
            parser.error(f"NAME must be one of {', '.join(strips)}, got {name!r}")
        chosen.out.mkdir(parents=True, exist_ok=True)
        strips[name](chosen.out, chosen.work)


# Pictures of one place


def draw_states(axes: Any, estimate: FovEstimate) -> None:
    """Draw the states from above, forward up and left left."""
    grid = estimate.grid
    palette = np.array([COLORS[state] for state in CellState])
    reach = grid.half_extent_m
    axes.imshow(palette[estimate.state[::-1, ::-1]], extent=(reach, -reach, -reach, reach), interpolation="nearest")
    axes.set_xticks([])
    axes.set_yticks([])


def draw_box(axes: Any, box: Floats, color: Any, **style: Any) -> None:
    """Draw the outline of a box (7,) from above."""
    corners = corners_of(box[None])[0]
    ring = np.concatenate([corners, corners[:1]])
    axes.plot(ring[:, 1], ring[:, 0], color=color, **style)


def draw_label(axes: Any, box: Floats, text: str, color: Any, away_m: float = 3.0) -> None:
    """Write beside a box what is said of it."""
    axes.text(
        box[1] - away_m, box[0], text, color=color, fontsize=8, va="center", ha="left", weight="bold",
        bbox={"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1.0}, clip_on=True,
    )  # fmt: skip


# A car behind a truck


def draw_truck(out: Path, work: Path) -> None:
    """Draw the car that goes behind a truck, by the published tracker and by ours."""
    rows = {
        "published tracker": _followed(PublishedRules(cost="center", coast_s=COAST_S), asks_beams=False),
        "ours: asks the field of view": _followed(None, asks_beams=True),
    }
    figure, grid_axes = plt.subplots(2, len(TRUCK_SWEEPS), figsize=(13.0, 8.2), layout="constrained")
    for line, (title, shown) in zip(grid_axes, rows.items(), strict=True):
        ids_of_car = list(dict.fromkeys(number for sweep in shown for number, is_car, _, _ in sweep if is_car))
        for axes, k in zip(line, TRUCK_SWEEPS, strict=True):
            moment = drive()[k]
            draw_states(axes, ESTIMATORS["shadow_map"](GRID).estimate(moment.leveled.sweep))
            world_from_level = moment.leveled.world_from_level
            assert world_from_level is not None
            level_from_world = world_from_level.inverse()
            for box in moved_boxes(moment.truths, level_from_world):
                draw_box(axes, box, "black", linestyle=":", linewidth=1.0)
            for number, is_car, box, word in shown[k]:
                color = f"C{3 * ids_of_car.index(number)}" if number in ids_of_car else "0.25"
                draw_box(axes, box, color, linewidth=2.2)
                if is_car or number in ids_of_car:
                    draw_label(axes, box, f"track {number}{f': {word}' if word else ''}", color, away_m=2.0)
            axes.set_xlim(25.0, -15.0)
            axes.set_ylim(-10.0, 52.0)
            axes.set_aspect("equal")
            axes.set_title(f"{DT_S * k:.1f} s", fontsize=9)
        line[0].set_ylabel(title, fontsize=10)
    figure.savefig(out / "strip_truck.png", dpi=80)
    plt.close(figure)


def _followed(rules: PublishedRules | None, *, asks_beams: bool) -> list[list[tuple[int, bool, Floats, str]]]:
    """Return the confirmed tracks of each sweep: number, whether it is the car, box in ``level``, why it is there."""
    tracker, fusion, out = Tracker(rules), SingleFusion(), []
    for k, moment in enumerate(drive()):
        t_s, world_from_level = DT_S * k, moment.leveled.world_from_level
        assert world_from_level is not None
        view = BeamView(moment.leveled, t_s) if asks_beams else published_view(moment, t_s)
        tracks = tracker.step(t_s, moment.detections, view)
        shown = np.flatnonzero(tracks.confirmed)
        words = [""] * len(tracks)
        if asks_beams:
            estimate = ESTIMATORS["shadow_map"](GRID).estimate(moment.leveled.sweep)
            place, yaw = world_from_level.translation[:2], world_from_level.yaw
            seen = SensorView("top", view, place, SeenCells.of(estimate), yaw=yaw)
            explained = fusion.explain(tracks, moment.detections, [seen])
            words = [LEGEND[at].word for at in explained.explanations[: len(tracks)]]
        of = match_objects(
            tracks.states[shown], tracks.ids[shown], moment.truths, np.array([CAR, PARKED]), within_m=4.0
        )
        boxes = moved_boxes(tracks.boxes[shown], world_from_level.inverse())
        is_car = [truth >= 0 and of.truth_ids[truth] == CAR for truth in of.truth_of_track]
        out.append([
            (int(tracks.ids[n]), bool(car), box, words[n]) for n, car, box in zip(shown, is_car, boxes, strict=True)
        ])  # fmt: skip
    return out


# A ghost


def draw_ghost(out: Path, work: Path) -> None:
    """Draw a fabricated detection in a simulated street, by the published tracker and by ours, which names it."""
    plan = drive_plan(preset_named("drives"), seconds=3.0, hz=10.0, agents=1, world="street", seed=GHOST_WORLD)
    adversary = Adversary("fabricate_static", start_s=GHOST_FROM_S, count=1, seed=GHOST_SEED)
    estimator = load_estimator("shadow_map", grid=BevGrid(256, 64.0))
    objects, detector, ghost = ObjectStream(tamper=adversary.detections), Detector(), None
    published = Tracker(PublishedRules(cost="center", coast_s=COAST_S))
    figure, grid_axes = plt.subplots(2, len(GHOST_SWEEPS), figsize=(13.0, 6.2), layout="constrained")
    columns = dict(zip(GHOST_SWEEPS, grid_axes.T, strict=True))
    for k, (sweep, _) in enumerate(drive_sweeps(plan)):
        leveled = level(sweep, estimator.grid)
        estimate, t_s = estimator.estimate(leveled), 1e-9 * (sweep.t_ns or 0)
        seen = objects.follow(leveled, estimate)
        pose = seen.tracks_from_level
        if len(seen.detections) > len(detector.detect(leveled)):
            ghost = moved_boxes(seen.detections.boxes[-1:], pose)[0]
        polygon = PolygonView.of(ESTIMATORS["concave_hull"](estimator.grid).estimate(sweep), t_s)
        plain = published.step(t_s, seen.detections.moved(pose), polygon)
        if k not in columns:
            continue
        held = np.flatnonzero(~seen.explained.held | seen.explained.accused)
        rows: tuple[list[Drawn], list[Drawn]] = (
            [(int(plain.ids[n]), plain.boxes[n], "0.25", "as any other") for n in np.flatnonzero(plain.confirmed)],
            [_named(seen.explained, int(n)) for n in held],
        )
        for axes, shown in zip(columns[k], rows, strict=True):
            draw_states(axes, estimate)
            for box in seen.detections.boxes:
                draw_box(axes, box, "0.35", linewidth=0.8)
            if ghost is not None:
                [at_level] = moved_boxes(ghost[None], pose.inverse())
                axes.plot(at_level[1], at_level[0], marker="x", color="black", markersize=8, markeredgewidth=2)
            for number, world_box, color, word in shown:
                [box] = moved_boxes(world_box[None], pose.inverse())
                is_ghost = ghost is not None and np.hypot(*(world_box[:2] - ghost[:2])) < GATE_M
                if color is not None or is_ghost:
                    draw_box(axes, box, color or "0.25", linewidth=2.0, linestyle="-" if color else ":")
                if is_ghost:
                    draw_label(axes, box, f"track {number}:\n{word}", color or "0.25")
            axes.set_xlim(22.0, -22.0)
            axes.set_ylim(-14.0, 30.0)
            axes.set_aspect("equal")
        columns[k][0].set_title(f"{t_s:.2f} s", fontsize=9)
    for axes, title in zip(grid_axes[:, 0], ("published tracker", "ours"), strict=True):
        axes.set_ylabel(title, fontsize=10)
    figure.savefig(out / "strip_ghost.png", dpi=80)
    plt.close(figure)


Drawn = tuple[int, Floats, str | tuple[float, float, float] | None, str]
"""Of a track: number, box in the world, color or None where it is drawn only if it is the ghost's, and a word."""


def _named(explained: ExplainedTracks, n: int) -> Drawn:
    """Return number, box, color and word of a track; no color where it is not confirmed."""
    item, tracks = LEGEND[explained.explanations[n]], explained.tracks
    if not tracks.confirmed[n]:
        return int(tracks.ids[n]), tracks.boxes[n], None, f"not confirmed,\nexists with {tracks.existence[n]:.0%}"
    return int(tracks.ids[n]), tracks.boxes[n], item.color, item.word


# An honest agent that others want to have expelled


def draw_flip(out: Path, work: Path) -> None:
    """Draw the trust of each agent while one is to be expelled, ours beside the published, as frames and over time."""
    plan = AgentsPlan.load("small")
    scene, run = _flipped(plan, work)
    chosen = np.unique(np.linspace(0, len(scene.times_s) - 1, 3).round().astype(int))
    figure, grid_axes = plt.subplots(2, len(chosen), figsize=(11.0, 7.6), layout="constrained")
    for line, (title, trust) in zip(grid_axes, _trusts(run).items(), strict=True):
        for axes, time in zip(line, chosen, strict=True):
            _draw_agents(axes, scene, run, time, trust[time])
            axes.set_title(f"{scene.times_s[time]:.2f} s", fontsize=9)
        line[0].set_ylabel(title, fontsize=10)
    figure.savefig(out / "strip_flip.png", dpi=80)
    plt.close(figure)

    figure, line = plt.subplots(1, 2, figsize=(10.0, 3.4), sharey=True, layout="constrained")
    for axes, (title, trust) in zip(line, _trusts(run).items(), strict=True):
        for agent in range(len(scene.agents)):
            style = dict(zip(("color", "linewidth", "linestyle"), _line_of(run, agent), strict=True))
            axes.plot(scene.times_s, trust[:, agent], label=_name_of(run, agent), **style)
        axes.axvline(ONSET_S, color="0.5", linestyle=":", linewidth=1.0)
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("seconds; the dotted line is when the lies begin")
        axes.set_ylim(0.0, 1.02)
    line[0].set_ylabel("trust")
    line[1].legend(fontsize=8, loc="lower left")
    figure.savefig(out / "trust_timeline.png", dpi=80)
    plt.close(figure)
    last = {title: trust[-1].round(3).tolist() for title, trust in _trusts(run).items()}
    print(f"liars {run.liars}, target {run.victim}, trust at the end {last}")


def _flipped(plan: AgentsPlan, work: Path) -> tuple[Scene, Run]:
    """Return the first test scene of the study, and what becomes of it; the scene is kept in a folder."""
    work.mkdir(parents=True, exist_ok=True)
    path = work / "test-0000.npz"
    if not path.exists():
        Scene.simulate(plan.scene("test", 0), Detector()).save(path)
    scene = Scene.load(path)
    return scene, SceneCases(scene, (plan.seed, "test", 0), claim_table(), honest_model()).run(FLIP)


def _trusts(run: Run) -> dict[str, Floats]:
    return {"mate (published)": np.array(run.published_trust), "ours": np.array(run.trust)}


def _name_of(run: Run, agent: int) -> str:
    return f"liar {agent}" if agent in run.liars else f"target {agent}" if agent == run.victim else f"agent {agent}"


def _line_of(run: Run, agent: int) -> tuple[str, float, str]:
    """Return color, width and style of an agent's line."""
    if agent in run.liars:
        return "crimson", 2.4, "--"
    return ("royalblue", 2.8, "-") if agent == run.victim else ("0.45", 1.2, "-")


def _draw_agents(axes: Any, scene: Scene, run: Run, time: int, trust: Floats) -> None:
    """Draw what all see together, and each agent in the color of the trust in it."""
    places = scene.poses[time, :, :2, 3]
    middle = places.mean(axis=0)
    half_m = float(np.abs(places - middle).max()) + 18.0
    grid = BevGrid(160, half_m)
    reports = scene.reports(time)
    joint = joint_fov([each.estimate for each in reports], grid, Rigid(np.eye(3), np.array([*middle, 0.0])))
    draw_states(axes, joint.estimate())
    for box in scene.objects[time]:
        shifted = box.copy()
        shifted[:2] -= middle
        if np.abs(shifted[:2]).max() < half_m:
            draw_box(axes, shifted, "0.2", linewidth=0.8)
    labels: list[tuple[float, float]] = []
    for agent in np.argsort(-places[:, 0]):
        x_m, y_m = places[agent] - middle
        color = mpl.colormaps["RdYlGn"](float(trust[agent]))
        rim = _line_of(run, agent)[0]
        axes.plot(y_m, x_m, marker="o", markersize=13, color=color, markeredgecolor=rim, markeredgewidth=2.2)
        # From the foremost to the rearmost: a label that would cover one above it goes below that.
        at_m = x_m
        while any(abs(at_m - above_m) < 0.13 * half_m and abs(y_m - beside_m) < half_m for above_m, beside_m in labels):
            at_m -= 0.02 * half_m
        labels.append((at_m, y_m))
        axes.text(
            y_m - 0.09 * half_m, at_m, f"{_name_of(run, agent)}: {trust[agent]:.2f}", fontsize=10, va="center",
            ha="left", bbox={"facecolor": "white", "alpha": 0.85, "edgecolor": "none", "pad": 0.8},
        )  # fmt: skip
    axes.set_xlim(half_m, -half_m)
    axes.set_ylim(-half_m, half_m)


if __name__ == "__main__":
    main()
