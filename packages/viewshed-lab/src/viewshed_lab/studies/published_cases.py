"""The four cases of the publication at small scale, with exact truth; run by ``viewshed study cases``, on one page.

A robot indoors; a sensor on a mast beside a car; perception with a field of view; trust of many agents. Each has a
table that compares the published method with ours, and with the figures of the publication if it reports some.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from importlib import resources
from time import perf_counter
from typing import Literal

import numpy as np

from viewshed.agents.joint_fov import joint_fov
from viewshed.agents.many import CommandCenter
from viewshed.arrays import F64, Mask
from viewshed.estimators import load_estimator
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.fov.truth import Truth
from viewshed.fov.union import claimed_at
from viewshed.geometry import Rigid
from viewshed.grid import GRIDS
from viewshed.metrics import ConfusionCounts
from viewshed.monitor.roc import auroc
from viewshed.objects.detector import Detector
from viewshed.objects.metrics import gospa
from viewshed.objects.tracker import ExistenceRules, Rules, Tracker
from viewshed.objects.views import BeamView, PolygonView, SeesAll, View
from viewshed.preprocess.held_ground import pose_of
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed_lab._page import facts, page, table
from viewshed_lab.data.drive import drive_plan, drive_sweeps
from viewshed_lab.data.presets import preset_named
from viewshed_lab.data.simulated import observe_frame, world_of
from viewshed_lab.sim.observe import Setting, measure_sweep
from viewshed_lab.sim.truth.exact import exact_truth
from viewshed_lab.sim.world import AgentPlan
from viewshed_lab.sim.worlds import WORLDS
from viewshed_lab.studies.agents.plan import ONSET_S, AgentsPlan
from viewshed_lab.studies.agents.published import PublishedTrust
from viewshed_lab.studies.agents.runs import seen_objects
from viewshed_lab.studies.agents.scenes import MAST_M, PITCH_DEG, Scene, scene_world, with_tall_masts
from viewshed_lab.studies.cases import generator
from viewshed_lab.studies.tracks.published import PublishedRules
from viewshed_lab.threats.object_attacks import OBJECT_ATTACKS

SEED = 20_261_127

HULL = "paper_concave_hull"
"""The published polygon."""

Rows = tuple[tuple[str, ...], list[list[str]]]
"""Header and rows of a table."""

WITHIN_M = 40.0
"""Radius of the area around the car that counts."""

ATTACKS: dict[str, tuple[str, int, str]] = {
    "false objects that stand, on one car": ("fabricate_static", 2, "car"),
    "false objects that move, on two cars": ("fabricate_markov", 2, "cars"),
    "moved objects, on the mast": ("translate_static", 3, "mast"),
    "moved objects, on a car": ("translate_static", 3, "car"),
}
"""The published attacks on detections: name, number of objects, and attacked agents."""


def robot_indoors(scenes: int) -> Rows:
    """Return the table of precision, recall and F1 of the field of view of a robot with a VLP-16."""
    rows = []
    for method in (HULL, "shadow_map"):
        counts = ConfusionCounts(0, 0, 0, 0)
        for number in range(scenes):
            plan = drive_plan(preset_named("ugv"), seconds=4.0, hz=0.5, agents=1, seed=SEED + number)
            for frame in range(plan.frames):
                observed = observe_frame(plan, frame)
                grid, truth = observed.truth.grid, observed.truth.visible("car")
                claimed = load_estimator(method, grid=grid).estimate(observed.image.sweep()).visible()
                counts = counts + ConfusionCounts.of(claimed, truth, observed.known, grid.cell_area_m2)
        rows.append([method, *(f"{value:.2f}" for value in (counts.precision, counts.recall, counts.f1))])
    published = tomllib.loads(
        resources.files("viewshed_lab.studies.paper").joinpath("published.toml").read_text(encoding="utf-8")
    )["mle-benign-benign"]["ugv-ugv"]
    rows.append(["the publication's network, by its own truth", *(f"{published[k]:.2f}" for k in (0, 1, 3))])
    return ("field of view", "precision", "recall", "F1"), rows


def mast_beside_a_car(scenes: int) -> Rows:
    """Return the table of the area within ``WITHIN_M`` of a car that car and mast see, exact and estimated."""
    setting, estimator = Setting(GRIDS["road"]), load_estimator("shadow_map", grid=GRIDS["road"])
    area: dict[str, list[float]] = {name: [0.0, 0.0, 0.0] for name in ("the car alone", "the mast alone", "both")}
    near = np.hypot(*np.moveaxis(setting.grid.centers, -1, 0)) <= WITHIN_M
    for number in range(scenes):
        plan = AgentPlan(1, 1, "hdl64e", "roadside", 1.8, 12.0)
        world = with_tall_masts(WORLDS["junction"](np.random.default_rng([SEED, number]), plan))
        views, truths = [], []
        for place, agent in enumerate(world.agents):
            paths, noise = np.random.SeedSequence([SEED, number, place]).spawn(2)
            scan, stored = measure_sweep(world, agent, 6.0, setting, paths, noise)
            truth, known = exact_truth(scan, world, setting.grid, agent=agent)
            truths.append(_as_view(truth, known, scan.world_from_sensor, agent.name))
            views.append(estimator.estimate(level(stored.sweep(), setting.grid)))
        pose = truths[0].world_from_level
        assert pose is not None
        visible = [near & (claimed_at(view, setting.grid, pose)[1] == CellState.FREE) for view in truths]
        claimed = [near & (claimed_at(view, setting.grid, pose)[0] >= view.threshold) for view in views]
        visible.append(visible[0] | visible[1])
        claimed.append(near & (joint_fov(views, setting.grid, pose).seen_by > 0))
        for sums, seen, claim in zip(area.values(), visible, claimed, strict=True):
            parts = np.array([seen.sum(), claim.sum(), (seen & claim).sum()]) * setting.grid.cell_area_m2
            sums[:] = (np.array(sums) + parts).tolist()
    car = area["the car alone"][0]
    rows = [
        [name, f"{seen / scenes:.0f}", f"{seen / car:.2f}", f"{claim / scenes:.0f}", f"{both / max(claim, 1e-9):.2f}"]
        for name, (seen, claim, both) in area.items()
    ]
    return ("view", "visible, m²", "times that of the car", "estimated, m²", "precision"), rows


def _as_view(truth: Truth, known: Mask, world_from_sensor: Rigid, agent: str) -> FovEstimate:
    """Return exact truth as a view with a pose: visible cells are FREE, others HIDDEN, cells without truth UNKNOWN."""
    seen = truth.visible("car")
    state = np.where(known, np.where(seen, CellState.FREE, CellState.HIDDEN), CellState.UNKNOWN).astype(np.uint8)
    pose = Rigid.from_yaw(world_from_sensor.yaw, world_from_sensor.translation)
    return FovEstimate(
        truth.grid, (seen & known).astype(np.float32), state, method="exact truth", world_from_level=pose, agent=agent
    )


def perception(scenes: int) -> Rows:
    """Return the table of GOSPA of tracks from the same detections, with a field of view and without."""

    def polygon(leveled: LeveledSweep, t_s: float) -> View:
        hull = load_estimator(HULL, grid=GRIDS["road"]).estimate(leveled)
        return PolygonView.of(hull, t_s)

    kinds: Mapping[str, tuple[Callable[[], Rules], Callable[[LeveledSweep, float], View]]] = {
        "ours, beams and the detector's table": (ExistenceRules, BeamView),
        "ours, no field of view": (ExistenceRules, lambda _, t_s: SeesAll(t_s)),
        "published rule and polygon": (PublishedRules, polygon),
    }
    detector, distance_m = Detector(), {name: list[float]() for name in kinds}
    for number in range(scenes):
        world = ("junction", "street", "residential")[number % 3]
        plan = drive_plan(preset_named("carla"), seconds=5.0, hz=5.0, agents=1, world=world, seed=SEED + number)
        one = replace(plan, preset=replace(plan.preset, roadside=0, frames=(25,)))
        trackers = {name: Tracker(rules()) for name, (rules, _) in kinds.items()}
        for frame, (sweep, truth) in enumerate(drive_sweeps(one, world_of(one))):
            leveled, t_s = level(sweep, GRIDS["road"]), frame / 5.0
            detections = detector.detect(leveled).moved(pose_of(leveled))
            seen = np.array([box.world_from_box.translation[:2] for box in truth.seen]).reshape(-1, 2)
            near = np.hypot(*(seen - truth.world_from_carrier.translation[:2]).T) < 50.0
            for name, (_, view) in kinds.items():
                tracks = trackers[name].step(t_s, detections, view(leveled, t_s))
                if frame >= 5:
                    distance_m[name].append(gospa(tracks.boxes[tracks.confirmed, :2], seen[near]).distance_m)
    return ("tracker", "GOSPA, m"), [[name, f"{np.mean(values):.2f}"] for name, values in distance_m.items()]


def trust_of_agents(scenes: int) -> Rows:
    """Return the table of how well trust separates attacked from honest agents, by published attack on detections."""
    plan = replace(
        AgentsPlan.load("small"), worlds=("junction", "street", "parking"), test_worlds=("junction",), tall_masts=1,
        heights_m=(1.84,), seed=SEED,
    )  # fmt: skip
    lowest: dict[str, list[tuple[F64, F64, list[int]]]] = {name: [] for name in ATTACKS}
    distance_m: dict[str, list[F64]] = {name: [] for name in ATTACKS}
    for number in range(scenes):
        one, mast = plan.scene("calibration", number), plan.moving
        scene = Scene.simulate(one, Detector(), drive_sweeps(one, scene_world(plan, "calibration", number)))
        for name, (attack, count, on) in ATTACKS.items():
            rng = generator(SEED, name, number)
            cars = [int(car) for car in rng.permutation(mast)]
            attacked = [mast] if on == "mast" else cars[: 2 if on == "cars" else 1]
            parameters = OBJECT_ATTACKS[attack](counts="exact", mean_count=float(count), start_s=ONSET_S)
            running = {agent: parameters.begin(rng) for agent in attacked}
            ours, no_trust = CommandCenter(scene.agents), CommandCenter(scene.agents, trusting=True)
            published = PublishedTrust()
            trust, distances = list[F64](), list[list[float]]()
            for time, t_s in enumerate(scene.times_s.tolist()):
                reports = scene.reports(time)
                for agent, run in running.items():
                    pose, honest = reports[agent].world_from_level, reports[agent].detections
                    forged = run.apply(honest.moved(pose), t_s, pose.translation).detections
                    reports[agent] = replace(reports[agent], detections=forged.moved(pose.inverse()))
                picture, naive = ours.add(t_s, reports), no_trust.add(t_s, reports)
                published_trust, believed = published.add(naive, reports)
                trust.append(np.stack([picture.verdicts.trust, published_trust]))
                truth = seen_objects(scene, time)[:, :2]
                boxes, now = naive.tracks.boxes, naive.reported
                ours_now = picture.tracks.boxes[picture.believed & picture.reported]
                tracks = (ours_now, boxes[believed & now], boxes[naive.tracks.confirmed & now])
                distances.append([gospa(own[:, :2], truth).distance_m for own in tracks])
            onset = round(ONSET_S * plan.hz)
            lowest_trust = np.min(trust[onset:], axis=0)
            lowest[name].append((lowest_trust[0], lowest_trust[1], attacked))
            distance_m[name].append(np.mean(distances[onset:], axis=0))
    rows = []
    for name in ATTACKS:
        areas = [_area(lowest[name], 0), _area(lowest[name], 1)]
        means = np.mean(distance_m[name], axis=0)
        rows.append([name, *(f"{area:.2f}" for area in areas), *(f"{value:.2f}" for value in means)])
    header = ("attack", "AUROC of the lowest trust, ours", "published", "GOSPA m, ours", "published", "no trust")
    return header, rows


def _area(scenes: Sequence[tuple[F64, F64, list[int]]], which: Literal[0, 1]) -> float:
    """Return the AUROC of the lowest trust, ours (0) or the published (1), for attacked against honest agents."""
    bad = np.concatenate([scene[which][scene[2]] for scene in scenes])
    good = np.concatenate([np.delete(scene[which], scene[2]) for scene in scenes])
    return auroc(-good, -bad)


CASES: dict[str, tuple[Callable[[int], Rows], str]] = {
    "A robot indoors": (
        robot_indoors,
        "A robot with a VLP-16 in rooms, corridors and halls, against exact truth. The publication's row is against its"
        " own truth.",
    ),
    "A sensor on a mast beside a car": (
        mast_beside_a_car,
        f"A car with an HDL-64E at a junction, and a mast of {MAST_M:g} m whose sensor is pitched {PITCH_DEG:g}° down."
        f" Areas are those within {WITHIN_M:g} m of the car where another car would be visible. The publication reports"
        " no figures.",
    ),
    "Perception with a field of view": (
        perception,
        "The same detections, tracked with a field of view, without one, and as published. GOSPA (cutoff 4 m) is"
        " against the objects within 50 m that give five returns. The publication reports no figures.",
    ),
    "Trust of many agents": (
        trust_of_agents,
        "Four cars and a mast; detections are forged as published. The published trust gets the same tracks; its"
        " polygon is the mask of the same estimate. *No trust* believes all agents. GOSPA counts the tracks that some"
        " agent reports at the time. The publication reports no comparable figures.",
    ),
}
"""By title: function and description of a case."""


def cases_page(scenes: int, progress: Callable[[str], None] = lambda _: None) -> str:
    """Return the page of all cases, each with ``scenes`` scenes."""
    parts, seconds = [], []
    for title, (run, about) in CASES.items():
        progress(title)
        begun_s = perf_counter()
        parts += [f"## {title}", about, table(*run(scenes))]
        seconds.append(f"{title} {perf_counter() - begun_s:.0f}")
    provenance = facts(seed=str(SEED), scenes=f"{scenes} a case", seconds="; ".join(seconds))
    return page("The published cases", provenance, *parts)
