"""From points to the network's mask: ``python -m benchmarks.network [--out FILE] [--weights FILE] [--only ENGINE]``."""

from __future__ import annotations

import argparse
import os
import tempfile
from collections import defaultdict
from collections.abc import Callable, Mapping
from importlib import metadata
from pathlib import Path

import numpy as np

from benchmarks import clouds
from benchmarks.drawn_network import PUBLISHED, draw_weights
from benchmarks.processes import alone
from benchmarks.timing import Timing, summary, times_of
from viewshed.arrays import F32
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.estimators.unet import UnetEstimator
from viewshed.metrics import Scores
from viewshed.networks.architecture import UNetShape
from viewshed.networks.card import INT8, NetworkCard, Runner
from viewshed.networks.mc_dropout import mean_and_deviation
from viewshed.networks.runtime import OnnxRunner, load_runner
from viewshed.sweep import Sweep
from viewshed_lab._page import facts, page, table
from viewshed_lab._results import write_page
from viewshed_lab.studies.cases import ROOM_M
from viewshed_lab.studies.evaluate import Reference
from viewshed_lab.studies.samples import sample_of

PAGE = Path(__file__).resolve().parents[3] / "docs" / "results" / "network_speed.md"
SEED, PASSES = 11, 20
FEWER, MANY, SWEEPS = (5, 10), 100, 40
"""Smaller numbers of passes to try, number of passes of the reference, and number of simulated sweeps."""

BALANCED, INDEPENDENT = "balanced", "independent"
"""Sampling of the masks of several passes: by :meth:`UNetShape.masks`, or independently as in the paper."""

ROUNDS, BUDGET_S = 3, 6.0
SIZES = ("35k", "120k")
ENGINE, TORCH, NONE = "onnxruntime", "torch, eager", "no network"
ONE_PASS = "one torch pass"
TARGETS_HZ = {
    ("MLE to mask", "35k"): 200,
    **{(f"MCD T = {passes} to mask: {ENGINE} {INT8}", "35k"): 22 for passes in (10, PASSES)},
}
"""Target rates by row (with or without its engine) and size."""
HEAD = ["what", "points", "median, ms (10–90 %)", "Hz", "of one torch pass", "GFLOP/s", "target", ""]
TEXT = """\
The paper's network (width 8, depth 4: {parameters:.2f} M parameters, {gflop:.2f} GFLOP a pass) on 256 × 256 cells.
The rows **to mask** begin with a sweep in memory whose attitude is known and end with the mask: count, network,
mean and deviation over T passes where dropout is on, threshold. The rows **to estimate** are the whole
estimator on a sweep without attitude: leveling, local ground and the states of the cells as well. Each engine runs in
processes of its own, {rounds} of them in an order drawn anew each round, because the idle threads of one engine slow
the next; within a process the rows take turns. **Of one torch pass** is the ratio to one eager pass of the paper's
network in torch, in its own processes of the same run. int8: a network in bytes. GFLOP/s count every pass in full.
Threads of the engines and of torch: {threads}. {weights}

**The floor.** A product of two matrices of 2048 × 2048 with {threads} threads reaches {single:.0f} GFLOP/s in float32
and {half:.0f} in bfloat16 here and now. At that rate one pass takes {floor_one:.1f} or {floor_one_half:.1f} ms, and
{passes} passes {floor_all:.0f} or {floor_all_half:.0f} ms. Of each pass {own:.0%} depends on its mask; what lies before
the first mask, and the half of the last decoder stage that reads stage 1, is computed once for all passes, exactly."""
FEWER_TEXT = """\
On {sweeps} simulated sweeps of `{preset}` against {truth}, over the cells whose truth is known, without bounds by the
beams. Balanced masks, those of `mc_dropout`, drop each channel in the same share of the passes; independent ones are
each drawn by itself, as the paper has it. F1 is that of the mean over the passes; one pass has dropout off.
Off: root mean square of what the mean is off that over {many} passes in float32. Correlation: of the deviation with
theirs. **Ten balanced passes stand for twenty independent ones** if they are off by no more, and their F1 is within
.002 of that of {many} passes in float32: they do{verdict}."""


def main() -> None:
    """Measure and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.network", description=__doc__)
    parser.add_argument("--out", type=Path, default=PAGE)
    parser.add_argument(
        "--weights", type=Path, help="a network that viewshed train exported; drawn weights if not given"
    )
    parser.add_argument(
        "--beside", default="", help="networks to stand beside it, by commas: files, or names of shipped weights"
    )
    parser.add_argument("--only", default="", help="measure only the engines with this word, and write no page")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    arguments = parser.parse_args()
    names = [name for name in (ENGINE, TORCH, NONE) if arguments.only in name]
    with tempfile.TemporaryDirectory() as folder:
        path = arguments.weights or Path(folder) / "drawn.onnx"
        if arguments.weights is None:
            alone(draw_weights, path)
        tasks = [(name, "") for name in names]
        tasks += [(ENGINE, other) for other in arguments.beside.split(",") if other and ENGINE in names]
        timings = measured(tasks, path, arguments.threads)
        card = OnnxRunner(path, 1).card
    rows = rows_of(timings, card.shape.flops(card.grid.cells))
    if arguments.only:
        return
    fewer: list[str] = []
    if arguments.weights is not None and card.shape.dropout:  # drawn weights have no F1 to lose
        runners = {"float32": OnnxRunner(path, arguments.threads)}
        runners |= {other: load_runner(other, arguments.threads) for other in arguments.beside.split(",") if other}
        fewer = fewer_passes(runners)
    libraries = ("numpy", "onnxruntime", "torch")
    about = facts(
        libraries=", ".join(f"{name} {metadata.version(name)}" for name in libraries),
        load=f"{os.getloadavg()[0]:.1f} in the minute before, on all cores (ours included)",
    )
    words = text(card, arguments.threads, alone(peak_flops, arguments.threads), arguments.weights)
    write_page(arguments.out, page("Speed of the network", about, words, table(HEAD, rows), *fewer))
    print(f"written to {arguments.out}")


def measured(tasks: list[tuple[str, str]], path: Path, threads: int) -> dict[tuple[str, str], Timing]:
    """Return the timing of each row and size of cloud; a task is an engine and, if any, another network."""
    rng = np.random.default_rng(SEED)
    times_ms: dict[tuple[str, str], list[float]] = defaultdict(list)
    for turn in range(ROUNDS):
        for pick in rng.permutation(len(tasks)):
            for key, times in alone(measure, tasks[pick], path, threads, turn).items():
                times_ms[key] += times
    order = {name: k for k, name in enumerate((f"{ENGINE} {INT8}", ENGINE, TORCH, NONE))}
    keys = sorted(times_ms, key=lambda key: (SIZES.index(key[1]), order.get(key[0].partition(": ")[2], len(order))))
    return {key: summary(times_ms[key]) for key in keys}


def measure(task: tuple[str, str], path: Path, threads: int, turn: int) -> dict[tuple[str, str], list[float]]:
    """Return the milliseconds of the rows of one task; run it in its own process, as idle threads slow others."""
    name, other = task
    runner: Runner | None = None
    if other:
        runner = load_runner(other, threads)
    elif name != NONE:
        runner = runner_of(name, path, threads)
    by_row: dict[tuple[str, str], list[float]] = {}
    for size in SIZES:
        sweep = clouds.synthetic(size, np.random.default_rng(SEED))
        card = OnnxRunner(path, 1).card if runner is None else runner.card
        times = times_of(jobs_of(name, runner, sweep, card), np.random.default_rng([SEED, turn]), BUDGET_S)
        label = f"{name} {INT8}" if card.precision == INT8 else name
        by_row |= {(f"{row}: {label}", size): times_ms for row, times_ms in times.items()}
    return by_row


def runner_of(name: str, path: Path, threads: int) -> Runner:
    """Return the runner of the network, by the name of its row."""
    if name == TORCH:
        import torch

        from viewshed_lab.training.unet_torch import TorchRunner, UNet

        torch.set_num_threads(threads)
        torch.manual_seed(SEED)
        card = NetworkCard("drawn", PUBLISHED)
        return TorchRunner(card, UNet(card.shape).eval())
    return OnnxRunner(path, threads)


def jobs_of(name: str, runner: Runner | None, sweep: Sweep, card: NetworkCard) -> dict[str, Callable[[], object]]:
    """Return the measured jobs of an engine on a sweep, by name."""
    level = sweep.replace(attitude=np.array([1.0, 0.0, 0.0, 0.0]), sensor_height_m=clouds.SENSOR_HEIGHT_M)
    if runner is None:
        shadows = ShadowMap(card.grid)
        return {
            "count alone": lambda: card.input_of(level),
            "`shadow_map` to estimate": lambda: shadows.estimate(sweep),
        }
    tried = (PASSES,) if name == TORCH else (*FEWER, PASSES)
    jobs = {"MLE to mask": mask_job(runner, level, 1)}
    jobs |= {f"MCD T = {passes} to mask": mask_job(runner, level, passes) for passes in tried}
    if name == TORCH:
        inputs = np.zeros((1, 1, *card.grid.shape), np.float32)
        return {**jobs, ONE_PASS: lambda: runner.run(inputs)}
    estimator = UnetEstimator(runner)
    return {**jobs, "MLE to estimate": lambda: estimator.estimate(sweep)}


def mask_job(runner: Runner, sweep: Sweep, passes: int) -> Callable[[], object]:
    """Return a job from a sweep to its mask."""
    card = runner.card
    masks = None if passes == 1 else card.shape.masks(passes, np.random.default_rng(SEED))

    def job() -> object:
        probs = runner.run(card.input_of(sweep)[None], masks)
        prob, std = (probs[0], None) if passes == 1 else mean_and_deviation(probs)
        return prob >= np.float32(card.threshold), std

    return job


def fewer_passes(runners: Mapping[str, Runner], sweeps: int = SWEEPS) -> list[str]:
    """Return the section on the cost of fewer passes; the first network, in float32, is the reference."""
    first, float32_runner = next(iter(runners.items()))
    card = float32_runner.card
    preset, exact = "ugv" if card.grid.half_extent_m < ROOM_M else "nuscenes", card.truth == "probe"
    variants = [(BALANCED, passes) for passes in (1, *FEWER, PASSES)] + [(INDEPENDENT, PASSES)]
    reference = first, BALANCED, MANY
    keys = [reference, *((name, *variant) for name in runners for variant in variants)]
    scores = {key: Scores() for key in keys}
    means: dict[tuple[str, str, int], list[F32]] = {key: [] for key in keys}
    deviations: dict[tuple[str, str, int], list[F32]] = {key: [] for key in keys}
    for number in range(sweeps):
        sample = sample_of(preset, number, sweeps, SEED)
        truth = Reference.exact(sample) if exact else Reference.label(sample, card.grid)
        if truth.grid != card.grid:
            raise ValueError(f"weights must be for the grid of the preset {preset}, {truth.grid}, got {card.grid}")
        inputs = {name: runner.card.input_of(sample.sweep)[None] for name, runner in runners.items()}
        for key in keys:
            name, way, passes = key
            masks = None if passes == 1 else masks_of(card, way, passes, number)
            mean, std = mean_and_deviation(runners[name].run(inputs[name], masks))
            scores[key].add(mean[truth.known], truth.visible[truth.known])
            means[key].append(mean[truth.known])
            deviations[key].append(std[truth.known])
    mean_of, std_of = ({key: np.concatenate(parts) for key, parts in maps.items()} for maps in (means, deviations))
    f1 = {key: score.f1(card.threshold) for key, score in scores.items()}
    off = {key: float(np.sqrt(np.mean(np.square(mean_of[key] - mean_of[reference])))) for key in keys}
    rows = []
    for key in keys:
        name, way, passes = key
        apart = "–" if key == reference else f"{off[key]:.4f}"
        alike = "–" if passes in (1, MANY) else f"{np.corrcoef(std_of[key], std_of[reference])[0, 1]:.3f}"
        rows.append([name, "–" if passes == 1 else way, str(passes), f"{f1[key]:.4f}", apart, alike])
    same = all(
        off[name, BALANCED, 10] <= off[name, INDEPENDENT, PASSES]
        and abs(f1[name, BALANCED, 10] - f1[reference]) <= 0.002
        for name in runners
    )
    words = FEWER_TEXT.format(
        sweeps=sweeps, preset=preset, truth="exact truth" if exact else "the paper's label", many=MANY,
        verdict="" if same else " **not**",
    )  # fmt: skip
    header = ["network", "masks", "passes", "F1", "off", "correlation"]
    return ["## Fewer passes", words, table(header, rows)]


def masks_of(card: NetworkCard, way: str, passes: int, number: int) -> F32:
    """Return the masks (passes, M) of a sweep by its number, ``BALANCED`` or ``INDEPENDENT``."""
    rng = np.random.default_rng([SEED, number, passes])
    if way == BALANCED:
        return card.shape.masks(passes, rng)
    return np.concatenate([card.shape.masks(1, rng) for _ in range(passes)])


def rows_of(timings: Mapping[tuple[str, str], Timing], flops: int) -> list[list[str]]:
    """Return the rows of the table, and print them."""
    rows = []
    for (name, size), each in timings.items():
        one = timings.get((f"{ONE_PASS}: {TORCH}", size))
        passes = int(name.split()[3]) if name.startswith("MCD") else 1
        network = name.startswith(("MLE to mask", "MCD", ONE_PASS))
        rate = f"{1e-6 * passes * flops / each.median_ms:.0f}" if network else "–"
        target = (
            None if TORCH in name else TARGETS_HZ.get((name, size), TARGETS_HZ.get((name.partition(": ")[0], size)))
        )
        verdict = "–" if target is None else "met" if 1e3 / each.median_ms >= target else "**missed**"
        low_high = f"{each.median_ms:.2f} ({each.low_ms:.2f}–{each.high_ms:.2f})"
        ratio = "–" if one is None else f"{each.median_ms / one.median_ms:.2f}"
        hz, aim = f"{1e3 / each.median_ms:.0f}", "–" if target is None else f"≥ {target} Hz"
        rows.append([name.removesuffix(f": {NONE}"), size, low_high, hz, ratio, rate, aim, verdict])
        print(" | ".join(rows[-1]), flush=True)
    return rows


def text(card: NetworkCard, threads: int, peaks: tuple[float, float], weights: Path | None) -> str:
    """Return the text of the page."""
    shape, flops = card.shape, card.shape.flops(card.grid.cells)
    own = own_share(shape, card.grid.cells)
    one, half = (1e3 * flops / peak for peak in peaks)
    every = 1 + (PASSES - 1) * own
    return TEXT.format(
        parameters=shape.parameters / 1e6, gflop=flops / 1e9, passes=PASSES, rounds=ROUNDS, threads=threads,
        single=peaks[0] / 1e9, half=peaks[1] / 1e9, own=own, floor_one=one, floor_one_half=half,
        floor_all=one * every, floor_all_half=half * every,
        weights="Weights drawn at random." if weights is None else f"Weights: {card.name}.",
    )  # fmt: skip


def own_share(shape: UNetShape, cells: int) -> float:
    """Return the share of a pass's work that depends on its mask."""
    first, second = shape.width, 2 * shape.width
    shared = 9 * (1 + first) * first + 9 * (first + second) * second / 4 + 9 * first * first
    return 1.0 - 2 * shared * cells**2 / shape.flops(cells)


def peak_flops(threads: int) -> tuple[float, float]:
    """Return the floating point operations per second of a large matrix product, in float32 and in bfloat16."""
    import torch

    torch.set_num_threads(threads)
    side = 2048
    single = torch.rand(side, side)
    half = single.bfloat16()
    times = times_of({"single": lambda: single @ single, "half": lambda: half @ half}, np.random.default_rng(0), 3.0)
    fast_ms = [summary(times[name]).low_ms for name in ("single", "half")]
    return 2e3 * side**3 / fast_ms[0], 2e3 * side**3 / fast_ms[1]


if __name__ == "__main__":
    main()
