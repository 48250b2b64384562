"""The jobs of the study of guarantees; each result is one line of JSON, and finished jobs are skipped."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from viewshed._files import write_atomic
from viewshed.estimators import DEFAULT_ESTIMATOR
from viewshed.guarantees.conformal import (
    BANDS_M,
    GROUND_STDS_M,
    MIN_SCENES,
    PLACE_EDGES,
    THRESHOLDS,
    Calibration,
    SceneCounts,
)
from viewshed_lab.data.wild import wild_scenes
from viewshed_lab.studies.guarantees import attacks
from viewshed_lab.studies.guarantees.driving import CASES, Drive, certified_speeds, drives_left, filled_share
from viewshed_lab.studies.guarantees.scenes import (
    GRID,
    adapted_of,
    attacked_of,
    broken_of,
    certificates_of,
    costs_of,
    counts_of,
    guaranteed_of,
    own_scene,
    wild_scene,
)
from viewshed_lab.studies.store import bind

TARGETS = ("car", "pedestrian")

SENSOR = "HDL-32E"

ALPHA, DELTA = 0.05, 0.1

Line = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Sizes:
    """Size of a study: scenes of each part, attacks of each kind per scene, drives of each case and monitor."""

    certificates: int
    broken: int
    adapted: int
    queries: int
    calibration: int
    report: int
    attacked: int
    development: int
    attacks: int
    toys: int
    each: int
    drives: int


SIZES = {
    "tiny": Sizes(2, 2, 1, 10, 100, 4, 1, 0, 1, 1, 10, 0),
    "small": Sizes(65, 20, 8, 60, 300, 400, 40, 60, 20, 80, 80, 20),
    "full": Sizes(65, 65, 40, 200, 600, 1000, 200, 60, 50, 160, 80, 200),
}


def run_study(folder: Path, sizes: Sizes, on_line: Callable[[str], None]) -> None:
    """Run the unfinished jobs.

    Raises:
        ValueError: the folder holds results of other sizes or of another version.
    """
    check_sizes(folder, sizes)
    for number in _left(folder, "certificates", sizes.certificates, on_line):
        _add(folder, "certificates", number, certificates_of(own_scene("certificates", number)))
    for number in _left(folder, "broken", sizes.broken, on_line):
        _add(folder, "broken", number, broken_of(own_scene("certificates", number)))
    for number in _left(folder, "adapted", sizes.adapted, on_line):
        _add(folder, "adapted", number, adapted_of(own_scene("attacks", number), number, sizes.queries))
    for number in _left(folder, "calibration", sizes.calibration, on_line):
        scene = own_scene("calibration", number)
        _add(folder, "calibration", number, {t: _packed(counts_of(scene, t, number)[1]) for t in TARGETS})
    for number in _left(folder, "development", sizes.development, on_line):
        scene, sensor = wild_scene(wild_scenes("development", "road")[number])
        estimate, counts = counts_of(scene, "car", number)
        default = guaranteed_of(scene, "car", estimate, estimate.visible())
        _add(folder, "development", number, {"car": _packed(counts), "default": default, "sensor": sensor})
    calibrations = {target: calibration_of(folder, target) for target in TARGETS}
    for number in _left(folder, "report", sizes.report, on_line):
        scene, by_target = own_scene("report", number), {}
        for target, calibration in calibrations.items():
            estimate, _ = counts_of(scene, target, number)
            by_target[target] = guaranteed_of(
                scene, target, estimate, calibration.guaranteed(estimate, scene.leveled.ground, ALPHA, DELTA)
            )
        _add(folder, "report", number, by_target)
    for number in _left(folder, "costs", 1, on_line):
        _add(folder, "costs", number, costs_of(calibrations["car"]))
    for number in _left(folder, "attacked", sizes.attacked, on_line):
        line = attacked_of(own_scene("report", number), number, calibrations["car"], sizes.queries)
        _add(folder, "attacked", number, line)
    for number in _left(folder, "attacks", sizes.attacks + sizes.toys, on_line):
        _add(folder, "attacks", number, attack_scene(number, sizes))
    for number in _left(folder, "speeds", sizes.drives, on_line):
        _add(folder, "speeds", number, {**certified_speeds(number), "filled": filled_share(number)})
    driven = lines_of(folder, "driving")
    for number in range(sizes.drives):
        for case in CASES:
            for monitor, drive in drives_left(number, case, drives_of(driven, number, case)):
                _add(folder, "driving", number, {"case": case, "monitor": monitor, **asdict(drive)})
        on_line(f"driving: {number + 1} of {sizes.drives} each")


def check_sizes(folder: Path, sizes: Sizes) -> None:
    """Write the sizes into the folder of a study; raise a ValueError if its results are of others or older."""
    bind(folder, asdict(sizes), "*.jsonl")


def judge(folder: Path, part: str, of: Callable[[dict[str, tuple[Calibration, float]]], list[Line]]) -> None:
    """Rewrite the lines of a part: the masks calibrated in a folder, evaluated on data that is not simulated."""
    own = calibration_of(folder, "car")
    masks = {"guaranteed, calibration of the own scenes": (own, 0.9)}
    others = [_unpacked(line["car"]) for line in lines_of(folder, "development")]
    if len(others) >= MIN_SCENES:
        masks["guaranteed, retested on development, confidence .5"] = (own.retested(others, "development"), 0.5)
    (folder / f"{part}.jsonl").unlink(missing_ok=True)
    for number, line in enumerate(of(masks)):
        _add(folder, part, number, line)


def lines_of(folder: Path, part: str) -> list[Line]:
    """Return the finished lines of a part, in order of their numbers."""
    file = folder / f"{part}.jsonl"
    if not file.exists():
        return []
    lines = list[Line]()
    for line in file.read_text(encoding="utf-8").splitlines():
        with suppress(json.JSONDecodeError):  # a truncated line (full disk) is computed again
            lines.append(json.loads(line))
    return sorted(lines, key=lambda line: int(line["number"]))


def drives_of(lines: list[Line], number: int, case: str) -> dict[str, Drive]:
    """Return the finished drives through a junction in a case, by monitor."""
    names = [one.name for one in fields(Drive)]
    return {
        line["monitor"]: Drive(**{name: line[name] for name in names})
        for line in lines
        if (line["number"], line["case"]) == (number, case)
    }


def calibration_of(folder: Path, target: str) -> Calibration:
    """Return the calibration of the own scenes in a folder, in random order."""
    scenes = [_unpacked(line[target]) for line in lines_of(folder, "calibration")]
    order = np.random.Generator(np.random.PCG64(36)).permutation(len(scenes))
    return Calibration.fit([scenes[k] for k in order], SENSOR, target, DEFAULT_ESTIMATOR)


def ship(folder: Path, file: Path) -> None:
    """Write the calibrations of a folder to the file that the package reads."""
    tables = [calibration_of(folder, target).to_json() for target in TARGETS]
    write_atomic(file, (json.dumps(tables, separators=(",", ":")) + "\n").encode())


def retested_shares(folder: Path) -> list[Line]:
    """Return false share and recall of development scenes, in folds of ten by a calibration retested on the others."""
    lines = lines_of(folder, "development")
    if not lines:
        return []
    scenes, own = [_unpacked(line["car"]) for line in lines], calibration_of(folder, "car")
    order, results = np.random.Generator(np.random.PCG64(36)).permutation(len(lines)), []
    for fold in np.array_split(order, max(len(lines) // 10, 2)):
        others = [scenes[k] for k in order if k not in fold]
        retested = own.retested(others, "development") if len(others) >= 50 else own
        steps = {
            "own": own.step(ALPHA, DELTA),
            "retested": retested.step(ALPHA, DELTA),
            "expected": retested.step(ALPHA, DELTA, 0.5),
        }
        results += [
            {
                **lines[k]["default"],
                "sensor": lines[k]["sensor"],
                **{name: _share_of(scenes[k], own, step) for name, step in steps.items()},
            }
            for k in fold
        ]
    return results


def _share_of(scene: SceneCounts, path: Calibration, step: int) -> tuple[float, float]:
    """Return the false share of a step's claim, and the kept share of the default's right claims."""
    if step < 0:
        return 0.0, 0.0
    at = path.stds[step], np.arange(path.levels.shape[1]), path.levels[step]
    right, false = (float(counts[at].sum()) for counts in (scene.right, scene.false))
    return false / max(right + false, 1.0), right / max(float(scene.right[-1, :, 0].sum()), 1.0)


def attack_scene(number: int, sizes: Sizes) -> Line:
    """Return the tallies of the attacks on an own scene or a toy, by threat and kind."""
    rng, tallies = np.random.Generator(np.random.PCG64(number)), {}
    is_toy = number >= sizes.attacks
    victim = attacks.toy_victim(rng) if is_toy else attacks.own_victim(
        own_scene("attacks", number).leveled.sweep, GRID if number % 4 == 0 else attacks.NEAR_GRID
    )  # fmt: skip
    for words in attacks.TRIED_TOY if is_toy else attacks.TRIED:
        for how in attacks.HOW:
            tally = attacks.Tally()
            attacks.try_attacks(victim, words, how, sizes.each, rng, tally)
            tallies[f"{words} | {how}"] = asdict(tally)
    if is_toy:
        tally = attacks.Tally()
        attacks.try_all(victim, 1 + number % 3, 3 * sizes.each, tally)
        tallies["dropped:1-3 | exhaustive"] = asdict(tally)
    return {"toy": is_toy, "tallies": tallies}


def _left(folder: Path, part: str, count: int, on_line: Callable[[str], None]) -> Iterator[int]:
    done = {line["number"] for line in lines_of(folder, part)}
    for number in range(count):
        if number not in done:
            yield number
        if (number + 1) % 50 == 0 or number + 1 == count:
            on_line(f"{part}: {number + 1} of {count}")


def _add(folder: Path, part: str, number: int, line: Line) -> None:
    with (folder / f"{part}.jsonl").open("ab+") as file:
        file.seek(max(file.tell() - 1, 0))
        begin = "" if file.read() in (b"", b"\n") else "\n"
        file.write(f"{begin}{json.dumps({'number': number, **line})}\n".encode())


def _packed(counts: SceneCounts) -> dict[str, Any]:
    return {name: getattr(counts, name).ravel().tolist() for name in ("right", "false", "drawn")}


def _unpacked(packed: dict[str, Any]) -> SceneCounts:
    shape, places = (len(GROUND_STDS_M), len(BANDS_M) - 1, len(THRESHOLDS)), (len(BANDS_M) - 1, len(PLACE_EDGES))
    right, false = (np.array(packed[name], np.int64).reshape(shape) for name in ("right", "false"))
    return SceneCounts(right, false, np.array(packed["drawn"], np.int8).reshape(places))
