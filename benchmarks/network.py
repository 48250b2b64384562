"""From points to the network's mask: ``python -m benchmarks.network [--out FILE] [--weights FILE] [--only WORD]``."""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Callable, Mapping
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import torch

from benchmarks import clouds
from benchmarks.timing import Timing, interleaved
from viewshed.estimators.learned import UnetEstimator
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.networks.engine import OnnxRunner
from viewshed.networks.mcd import moments
from viewshed.networks.onnx_file import export_onnx
from viewshed.networks.spec import NetworkCard, Runner, UNetShape
from viewshed.networks.unet import TorchRunner, UNet
from viewshed.report import facts, page, table
from viewshed.sweep import Sweep

PAGE = Path(__file__).resolve().parents[1] / "docs" / "results" / "network_speed.md"
SEED, PASSES, TARGET_MS = 11, 20, 5.0
HEAD = ["what", "points", "median, ms (10–90 %)", "Hz", "of one torch pass", "GFLOP/s", "target", ""]
TEXT = """\
The paper's network (width 8, depth 4: {parameters:.2f} M parameters, {gflop:.2f} GFLOP a pass) on 256 × 256 cells.
The rows **to mask** begin with a sweep in memory whose attitude is known and end with the mask: count, network,
mean and deviation over {passes} passes where dropout is on, threshold. The rows **to estimate** are the whole
estimator on a sweep without attitude: levelling, local ground and the states of the cells as well. Everything in one
run, interleaved in an order drawn anew each round; **of one torch pass** is the ratio to one eager pass of the same
network in torch, which holds better than the milliseconds do. GFLOP/s count every pass in full. Threads of the engines
and of torch: {threads}. {weights}

**The floor.** A product of two matrices of 2048 × 2048 in float32 reaches {peak:.0f} GFLOP/s here and now, on all
cores. At that rate one pass takes {floor_one:.1f} ms, and {passes} passes {floor_all:.0f} ms. Of each pass {own:.0%}
depends on its mask; what lies before the first mask, and the half of the last decoder stage that reads stage 1, is
computed once for all passes, exactly."""


def main() -> None:
    """Measure and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.network", description=__doc__)
    parser.add_argument("--out", type=Path, default=PAGE)
    parser.add_argument(
        "--weights", type=Path, help="a network that viewshed train exported; drawn weights if not given"
    )
    parser.add_argument("--only", default="", help="measure only the rows with this word, and write no page")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    chosen = parser.parse_args()
    rng, threads = np.random.default_rng(SEED), chosen.threads
    torch.set_num_threads(threads)
    with tempfile.TemporaryDirectory() as folder:
        torch.manual_seed(SEED)
        module = UNet(UNetShape(8, 4)).eval()
        path = chosen.weights or Path(folder) / "drawn.onnx"
        if chosen.weights is None:
            export_onnx(path, NetworkCard("drawn", UNetShape(8, 4)), module)
        runners = engines(path, threads)
    card = next(iter(runners.values())).card
    eager = TorchRunner(NetworkCard("drawn", UNetShape(8, 4)), module)
    rows = []
    for size in ("35k", "120k"):
        jobs = {name: job for name, job in jobs_of(size, rng, runners, eager).items() if chosen.only in name}
        timings = interleaved({**jobs, "one torch pass": torch_pass(eager)}, rng, 40.0)
        rows += rows_of(size, timings, card.shape.flops(card.grid.cells))
    if chosen.only:
        return
    names = ("numpy", "onnxruntime", "torch", *(["openvino"] if find_spec("openvino") else []))
    told = facts(
        libraries=", ".join(f"{name} {metadata.version(name)}" for name in names),
        load=f"{os.getloadavg()[0]:.1f} in the minute before, on all cores (ours included)",
    )
    chosen.out.write_text(
        page("Speed of the network", told, text(card, threads, chosen.weights), table(HEAD, rows)), "utf-8"
    )
    print(f"written to {chosen.out}")


def engines(path: Path, threads: int) -> dict[str, Runner]:
    """Return the runners by name: every engine that is installed, in every precision that ships."""
    made: dict[str, Runner] = {"onnxruntime": OnnxRunner(path, threads, "onnxruntime")}
    if find_spec("openvino"):
        made["openvino"] = OnnxRunner(path, threads, "openvino")
        made["openvino bf16"] = OnnxRunner(path, threads, "openvino", "bf16")
    return made


def jobs_of(
    size: str, rng: np.random.Generator, runners: Mapping[str, Runner], eager: Runner
) -> dict[str, Callable[[], object]]:
    """Return what is measured on a sweep of ``size`` points, by name."""
    sweep = clouds.synthetic(size, rng)
    level = sweep.replace(attitude=np.array([1.0, 0.0, 0.0, 0.0]), sensor_height_m=clouds.SENSOR_HEIGHT_M)
    jobs: dict[str, Callable[[], object]] = {}
    for name, runner in {**runners, "torch, eager": eager}.items():
        jobs[f"MLE to mask, {name}"] = mask_job(runner, level, 1)
        jobs[f"MCD T = {PASSES} to mask, {name}"] = mask_job(runner, level, PASSES)
    for name, runner in runners.items():
        jobs[f"MLE to estimate, {name}"] = estimate_job(UnetEstimator(runner), sweep)
    card = eager.card
    jobs["count alone"] = lambda: card.input_of(level)
    jobs["`shadow_map` to estimate, 1 thread"] = estimate_job(ShadowMap(card.grid), sweep)
    return jobs


def mask_job(runner: Runner, sweep: Sweep, passes: int) -> Callable[[], object]:
    """Return a job from a sweep to its mask."""
    card = runner.card
    masks = card.shape.no_masks(1) if passes == 1 else card.shape.masks(passes, np.random.default_rng(SEED))

    def job() -> object:
        found = runner.run(card.input_of(sweep)[None], masks)
        prob, std = (found[0], None) if passes == 1 else moments(found)
        return prob >= np.float32(card.threshold), std

    return job


def estimate_job(estimator: UnetEstimator | ShadowMap, sweep: Sweep) -> Callable[[], object]:
    """Return a job from a sweep to its estimate."""
    return lambda: estimator.estimate(sweep)


def torch_pass(eager: Runner) -> Callable[[], object]:
    """Return a job of one eager pass in torch."""
    inputs = np.zeros((1, 1, *eager.card.grid.shape), np.float32)
    return lambda: eager.run(inputs, eager.card.shape.no_masks(1))


def rows_of(size: str, timings: Mapping[str, Timing], flops: int) -> list[list[str]]:
    """Return the rows of the table, and print them."""
    rows = []
    one = timings["one torch pass"].median_ms
    for name, each in timings.items():
        passes = PASSES if name.startswith("MCD") else 1
        network = name.startswith(("MLE to mask", "MCD", "one"))
        rate = f"{1e-6 * passes * flops / each.median_ms:.0f}" if network else "–"
        judged = name.startswith("MLE to mask") and "eager" not in name and size == "35k"
        verdict = "" if not judged else "met" if each.median_ms <= TARGET_MS else "**missed**"
        low_high = f"{each.median_ms:.2f} ({each.low_ms:.2f}–{each.high_ms:.2f})"
        hertz, ratio = f"{1e3 / each.median_ms:.0f}", f"{each.median_ms / one:.2f}"
        rows.append([name, size, low_high, hertz, ratio, rate, "≥ 200 Hz" if judged else "–", verdict or "–"])
        print(" | ".join(rows[-1]), flush=True)
    return rows


def text(card: NetworkCard, threads: int, weights: Path | None) -> str:
    """Return the page's words."""
    peak, shape = peak_flops(), card.shape
    flops = shape.flops(card.grid.cells)
    return TEXT.format(
        parameters=shape.parameters / 1e6, gflop=flops / 1e9, passes=PASSES, threads=threads, peak=peak / 1e9,
        own=own_share(shape, card.grid.cells), floor_one=1e3 * flops / peak,
        floor_all=1e3 * flops * (1 + (PASSES - 1) * own_share(shape, card.grid.cells)) / peak,
        weights="Weights drawn at random." if weights is None else f"Weights: {card.name}.",
    )  # fmt: skip


def own_share(shape: UNetShape, cells: int) -> float:
    """Return the share of a pass's work that depends on its mask."""
    first, second = shape.width, 2 * shape.width
    shared = 9 * (shape.channels + first) * first + 9 * (first + second) * second / 4 + 9 * first * first
    return 1.0 - 2 * shared * cells**2 / shape.flops(cells)


def peak_flops(side: int = 2048) -> float:
    """Return the floating point operations a second of a large product of matrices, the best of several."""
    a = np.random.default_rng(0).random((side, side), np.float32)
    timing = interleaved({"product": lambda: a @ a}, np.random.default_rng(0), 1.0)["product"]
    return 2 * side**3 / (timing.low_ms / 1e3)


if __name__ == "__main__":
    main()
