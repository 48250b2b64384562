"""The scenes of the study of guarantees, and the measurements on each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from viewshed.arrays import F32, Mask
from viewshed.estimators import DEFAULT_ESTIMATOR, Estimator, load_estimator
from viewshed.fov.estimate import FovEstimate, FovEstimator
from viewshed.fov.height_map import HeightMap
from viewshed.fov.visibility import TARGETS, Target
from viewshed.geometry import Rigid, rotation_from_quaternion
from viewshed.grid import GRIDS, polar_of_cells
from viewshed.guarantees.certificate import ADDED, Certificate, certify, without
from viewshed.guarantees.conformal import Calibration, SceneCounts
from viewshed.guarantees.envelope import GRADE, Envelope, Given, Threat
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.recordings.read import open_source
from viewshed.recordings.read.source import ObjectBox
from viewshed.sensors import lidar_model
from viewshed.sweep import Sweep
from viewshed_lab.data.presets import Preset, preset_named
from viewshed_lab.data.simulated import ScenePlan, observe_frame, world_of
from viewshed_lab.data.wild import WildScene
from viewshed_lab.sim import cast, junction
from viewshed_lab.studies.crossview.page import posed_scenes
from viewshed_lab.studies.crossview.rates import evaluate_crossview
from viewshed_lab.studies.judges import OFF_M, surveyed
from viewshed_lab.studies.suite import Changed
from viewshed_lab.threats.attacks import ATTACKS, Attack
from viewshed_lab.threats.attacks.adaptive import BlackBox, OverClaim

FRAME = 11

SEEDS = {"calibration": 3601, "report": 3602, "certificates": 3603, "attacks": 3604}
"""Seeds of the own scenes; no two parts of the study share a scene."""

GRID = GRIDS["road"]

THREATS = ("added", "replaced:5", "window:5", "window:20", "replaced:150", "wedge:10", "dropped:20")

WITHSTOOD = ("window:5", "window:20", "replaced:150")
"""Threats whose certified part is attacked adaptively."""

ON_MASK = {
    "far wall": ATTACKS["far_wall_clean"](), "removal": ATTACKS["removal_aimed"](),
    "removal and far wall": ATTACKS["removal_and_far_wall_clean"](), "relay": ATTACKS["relay"](),
    "ghost wall": ATTACKS["ghost_wall_clean"](), "150 on beams of a wedge": ATTACKS["wedge_cluster"](150),
    "150 on beams anywhere": ATTACKS["uniform_on_beams"](150),
}  # fmt: skip
"""Attacks on a mask of guaranteed error; none of them queries the mask."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A sweep with its exact truth."""

    name: str  # of the scene
    leveled: LeveledSweep  # the sweep
    visible: dict[str, Mask]  # by target name, (cells, cells) exact truth
    known: Mask  # (cells, cells) cells with known truth
    ground: HeightMap  # exact ground heights


def own_scene(part: str, number: int) -> Scene:
    """Return a scene of the preset nuscenes with a seed of this study."""
    preset: Preset = replace(preset_named("nuscenes"), seed=SEEDS[part])
    plan = ScenePlan(preset, 0, number)
    seen, world = observe_frame(plan, FRAME), world_of(plan)
    centers, pose, terrain = GRID.centers, seen.scan.world_from_sensor, world.ground_of(world.agents[0])
    heights = terrain.about(pose, centers[:, 0, 0].copy(), centers[0, :, 1].copy())[0]
    below = terrain.about(pose, np.zeros(1), np.zeros(1))[0][0, 0]
    truth = {name: seen.truth.visible(name) for name in TARGETS}
    return Scene(plan.name, level(seen.image.sweep(), GRID), truth, seen.known, _lattice(heights - below))


def wild_scene(scene: WildScene) -> tuple[Scene, str]:
    """Return the first sweep of a wild scene, with rings, and the name of its sensor."""
    sample = scene.observe(0).sample("rings")
    truth = {name: sample.truth.visible(name) for name in TARGETS}
    return Scene(sample.scene, level(sample.sweep, GRID), truth, sample.known, sample.exact_ground), sample.sensor


def _lattice(heights: F32) -> HeightMap:
    blocks = heights.reshape(64, 4, 64, 4)[:, 1:3, :, 1:3].mean(axis=(1, 3))
    return HeightMap(blocks.astype(np.float32), GRID.half_extent_m, np.ones((64, 64), np.bool_))


def default_estimator(target: Target) -> Estimator:
    """Return the default estimator of a target."""
    return load_estimator(DEFAULT_ESTIMATOR, grid=GRID, target=target)


def areas(claim: Mask, visible: Mask, known: Mask) -> tuple[float, float, float]:
    """Return areas in m² with known truth: claimed and visible, claimed and not visible, visible."""
    return tuple(
        float((cells & known).sum()) * GRID.cell_area_m2 for cells in (claim & visible, claim & ~visible, visible)
    )  # type: ignore[return-value]


def certificates_of(scene: Scene) -> dict[str, Any]:
    """Return areas of the envelope and of the final claim, by given ground and threat."""
    target, visible, leveled = TARGETS["car"], scene.visible["car"], scene.leveled
    estimate = default_estimator(target).estimate(leveled)
    result: dict[str, Any] = {"name": scene.name, "default": areas(estimate.visible(), visible, scene.known)}
    grounds = {
        "height and attitude": Given.of(leveled, grade=0.0),
        f"height and attitude, slope {GRADE:g}": Given.of(leveled),
        "exact ground": Given.of(leveled, scene.ground, 0.0),
    }
    for name, given in grounds.items():
        envelope = Envelope.of(leveled, given, GRID, target)
        for words in THREATS:
            threat = Threat.parse(words)
            certificate = certify(leveled, estimate, threat, given)
            # Cells certified by the envelope alone, regardless of the estimator's claim.
            gain_m2, _ = envelope.changeable(threat, ~envelope.reference(threat), opens=True)
            _, spent = envelope.changeable(threat, envelope.claim, opens=False)
            result[f"{name} | {words}"] = {
                "envelope": areas(envelope.claim, visible, scene.known),
                "reference": areas(envelope.reference(threat), visible, scene.known),
                "certified envelope": areas(envelope.claim & ~spent, visible, scene.known),
                "final": areas(certificate.claim, visible, scene.known),
                "certified": areas(certificate.certified_visible, visible, scene.known),
                "gain_m2": gain_m2, "over_claim_m2": certificate.over_claim_m2,
            }  # fmt: skip
    return result


def costs_of(calibration: Calibration) -> dict[str, Any]:
    """Return milliseconds (fastest, median) of each certificate and of a guaranteed mask at a junction, by sensor."""
    costs: dict[str, Any] = {}
    for sensor in ("HDL-32E", "HDL-64E"):
        leveled = level(cast(lidar_model(sensor), junction(), 1.8, rng=np.random.default_rng(36)), GRID)
        estimate = default_estimator(TARGETS["car"]).estimate(leveled)
        jobs: dict[str, Callable[[], object]] = {
            words: partial(certify, leveled, estimate, Threat.parse(words)) for words in THREATS
        }
        turned = (
            replace(Given.of(leveled), rotation=Rigid.from_quaternion((1.0, 0.001 * step, 0.0, 0.0)).rotation)
            for step in count()
        )
        jobs["added, another attitude each sweep"] = partial(_certify_next, leveled, estimate, turned)
        jobs["guaranteed mask"] = partial(calibration.guaranteed, estimate, leveled.ground)
        for name, job in jobs.items():
            times_ms = []
            for _ in range(40):
                start_s = perf_counter()
                job()
                times_ms.append(1000 * (perf_counter() - start_s))
            costs.setdefault(name, {})[sensor] = [min(times_ms), float(np.median(times_ms)), len(leveled.sweep)]
    return costs


def _certify_next(leveled: LeveledSweep, estimate: FovEstimate, given: Iterator[Given]) -> Certificate:
    return certify(leveled, estimate, ADDED, next(given))


def counts_of(scene: Scene, target: str, number: int) -> tuple[FovEstimate, SceneCounts]:
    """Return the default estimate of a scene and its counts for calibration."""
    estimate = default_estimator(TARGETS[target]).estimate(scene.leveled)
    rng = np.random.Generator(np.random.PCG64(number))
    return estimate, SceneCounts.of(estimate, scene.leveled.ground, scene.visible[target], scene.known, rng)


def guaranteed_of(scene: Scene, target: str, estimate: FovEstimate, claim: Mask) -> dict[str, Any]:
    """Return the false share of a guaranteed mask, its recall, and the kept share of the default's right claims."""
    right, false, total = areas(claim, scene.visible[target], scene.known)
    default = areas(estimate.visible(), scene.visible[target], scene.known)
    return {
        "name": scene.name, "false_share": false / max(right + false, 1e-9), "recall": right / max(total, 1e-9),
        "of_default": right / max(default[0], 1e-9), "default_false_share": default[1] / max(sum(default[:2]), 1e-9),
    }  # fmt: skip


def certified(estimator: Estimator, threat: Threat, *, only_certified: bool = False) -> Changed:
    """Return an estimator limited to the envelope, or to its certified cells, as a victim of adaptive attacks.

    Data that the sweep lacks and that are inferred are trusted.
    """

    def kept(leveled: LeveledSweep, estimate: FovEstimate) -> Mask:
        certificate = certify(leveled, estimate, threat, trust_inferred=True)
        return certificate.certified_visible if only_certified else certificate.claim

    return _keeping(estimator, kept)


def guaranteed(estimator: Estimator, calibration: Calibration, confidence: float) -> Changed:
    """Return an estimator limited to the guaranteed mask of a calibration, at a confidence."""
    return _keeping(
        estimator, lambda leveled, estimate: calibration.guaranteed(estimate, leveled.ground, confidence=confidence)
    )


def _keeping(estimator: Estimator, kept: Callable[[LeveledSweep, FovEstimate], Mask]) -> Changed:
    """Return an estimator whose claims are limited to a mask (cells, cells)."""

    def answer(_: FovEstimator, sweep: Sweep) -> FovEstimate:
        leveled = level(sweep, estimator.grid)
        estimate = estimator.estimate(leveled)
        return without(estimate, estimate.visible() & ~kept(leveled, estimate))

    return Changed(estimator, answer)


def crossview_of(index: Path, masks: dict[str, tuple[Calibration, float]]) -> list[dict[str, Any]]:
    """Return over-claim and under-claim of the default and of guaranteed masks on real posed sequences, by sensor.

    ``masks`` are calibrations by name, with the requested confidence.
    """
    default = default_estimator(TARGETS["car"])
    estimators: dict[str, FovEstimator] = {"default": default, "default ∩ envelope": certified(default, ADDED)}
    estimators |= {name: guaranteed(default, *mask) for name, mask in masks.items()}
    lines = []
    for sensor, scenes in posed_scenes(index).items():
        for row in evaluate_crossview(scenes, estimators, rng=np.random.default_rng(36)):
            rates = {name: asdict(getattr(row, name)) for name in ("over", "under")}
            lines.append({"sensor": sensor, "mask": row.method, **rates})
    return lines


def survey_of(log: Path, masks: dict[str, tuple[Calibration, float]]) -> list[dict[str, Any]]:
    """Return counts of claimed cells for each sweep of a surveyed Argoverse 2 log, by mask.

    Counts: cells on surveyed ground; those of them whose ground is off; those of them behind an annotated box.
    ``masks`` are calibrations by name, with the requested confidence.
    """
    lines = []
    for _, boxes, leveled, error_m in surveyed(log, open_source(log, "argoverse2"), GRID):
        estimate, ground_m = default_estimator(TARGETS["car"]).estimate(leveled), leveled.ground.at(GRID.centers)
        claims = {"default": estimate.visible()} | {
            name: one.guaranteed(estimate, leveled.ground, confidence=confidence)
            for name, (one, confidence) in masks.items()
        }
        known, off = np.isfinite(error_m), np.abs(error_m) > OFF_M
        behind = behind_boxes(leveled, boxes, ground_m, TARGETS["car"])
        lines.append({
            name: [int((mask & of).sum()) for of in (known, off, known & behind)] for name, mask in claims.items()
        })  # fmt: skip
    return lines


def behind_boxes(leveled: LeveledSweep, boxes: Sequence[ObjectBox], ground_m: F32, target: Target) -> Mask:
    """Return the mask (cells, cells) of cells in which a target is entirely behind one annotated box.

    The lines from the sensor to the center and both ends of the target's top all pass through the box, extended down
    to the ground, and leave it before they end. Through windows and over a hood a sensor may see more.

    Args:
        leveled: the sweep, with a pose.
        boxes: annotated boxes in the world.
        ground_m: (cells, cells) ground height below the target.
        target: target with width and height.
    """
    azimuth = polar_of_cells(GRID)[1]
    aside = np.stack([-np.sin(azimuth), np.cos(azimuth)], axis=-1) * (target.width_m / 2)
    top_m = ground_m[..., None].astype(np.float64) + target.height_m
    tops = np.stack([np.concatenate([GRID.centers + side * aside, top_m], axis=-1) for side in (-1, 0, 1)])
    level_from_world = leveled.level_from_sensor @ (leveled.sweep.world_from_sensor or Rigid.identity()).inverse()
    behind: Mask = np.zeros(GRID.shape, np.bool_)
    for box in boxes:
        box_from_level = (level_from_world @ box.world_from_box).inverse()
        sensor, half = box_from_level @ leveled.level_from_sensor.translation, np.array(box.size_m) / 2
        line, low = box_from_level @ tops - sensor, np.array([-half[0], -half[1], -np.inf])
        with np.errstate(divide="ignore", invalid="ignore"):
            first, second = (low - sensor) / line, (half - sensor) / line
        enters, leaves = np.minimum(first, second).max(axis=-1), np.maximum(first, second).min(axis=-1)
        behind |= ((enters > 0.0) & (enters < leaves) & (leaves < 1.0)).all(axis=0)
    return behind


def attacked_of(scene: Scene, number: int, calibration: Calibration, queries: int) -> dict[str, Any]:
    """Return right, false and visible m² of the default's claim and of its guaranteed mask, by attack on a sweep.

    The last attack queries the mask.
    """
    sweep, default = scene.leveled.sweep, default_estimator(TARGETS["car"])
    objective = OverClaim(guaranteed(default, calibration, 0.9))
    attacks: dict[str, Attack | None] = {"none": None, **ON_MASK}
    attacks["150 on beams, by asking the mask"] = BlackBox(objective, 150, queries, placement="largest_hidden_area")
    result = {}
    for name, attack in attacks.items():
        rng = np.random.Generator(np.random.PCG64(number))
        leveled = level(sweep if attack is None else attack.apply(sweep, rng).sweep, GRID)
        estimate = default.estimate(leveled)
        claims = {"default": estimate.visible(), "guaranteed": calibration.guaranteed(estimate, leveled.ground)}
        result[name] = {of: areas(claim, scene.visible["car"], scene.known) for of, claim in claims.items()}
    return result


def adapted_of(scene: Scene, number: int, queries: int) -> dict[str, Any]:
    """Return the area in m² that an adaptive attack with 150 returns on beams opens, by victim."""
    sweep, visible = scene.leveled.sweep, scene.visible["car"]
    result: dict[str, Any] = {}
    estimator = default_estimator(TARGETS["car"])
    threat = Threat("replaced", 150)
    victims: dict[str, FovEstimator] = {
        "default": estimator,
        "final": certified(estimator, threat),
        **{words: certified(estimator, Threat.parse(words), only_certified=True) for words in WITHSTOOD},
    }
    for name, victim in victims.items():
        search = BlackBox(OverClaim(victim), 150, queries, placement="largest_hidden_area")
        tampered = search.apply(sweep, np.random.Generator(np.random.PCG64(number)))
        before, after = victim.estimate(sweep).visible(), victim.estimate(tampered.sweep).visible()
        opened, known = after & ~before, scene.known
        result[name] = [float(cells.sum()) * GRID.cell_area_m2 for cells in (opened & known, opened & known & ~visible)]
        if name == "final":
            leveled = level(tampered.sweep, GRID)
            result["bound"] = certify(leveled, estimator.estimate(leveled), threat, trust_inferred=True).over_claim_m2
            clean = Envelope.of(scene.leveled, Given.of(scene.leveled), GRID, TARGETS["car"]).reference(threat)
            result["beyond the clean envelope"] = float((after & ~clean).sum()) * GRID.cell_area_m2
    return result


def broken_of(scene: Scene) -> dict[str, Any]:
    """Return areas in m² certified against added points, by broken assumption: right, false, visible."""
    leveled, target = scene.leveled, TARGETS["car"]
    given, estimate = Given.of(leveled), default_estimator(target).estimate(leveled)
    model, half = given.model, np.deg2rad(0.5)
    tilted = rotation_from_quaternion([np.cos(half), 0.0, np.sin(half), 0.0]) @ given.rotation
    shifted = replace(model, elevation=model.elevation + np.deg2rad(0.5))
    cases = {
        "none is broken": given,
        "mounting height .3 m too large": replace(given, height_m=given.height_m + 0.3),
        "mounting height .3 m too small": replace(given, height_m=given.height_m - 0.3),
        "attitude off by 1° (pitch)": replace(given, rotation=tilted),
        "beam table off by .5° (elevation)": replace(given, model=shifted),
        "beam table of another sensor (VLP-32C)": replace(given, model=lidar_model("vlp32c")),
        "beam table with twice the columns": replace(
            given, model=replace(model, azimuth_columns=2 * model.azimuth_columns)
        ),
        "ground known exactly": replace(given, ground=scene.ground, grade=0.0),
    }
    result = {}
    for name, broken in cases.items():
        certificate = certify(leveled, estimate, ADDED, broken)
        envelope = Envelope.of(leveled, broken, GRID, target).claim
        result[name] = [*areas(certificate.certified_visible, scene.visible["car"], scene.known),
                        *areas(envelope, scene.visible["car"], scene.known)[:2]]  # fmt: skip
    return result
