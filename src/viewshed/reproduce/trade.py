"""The trade study: what width, depth and resolution cost and bring."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import Any

from viewshed.networks.spec import Runner
from viewshed.reproduce.contestants import WEIGHTS, network
from viewshed.reproduce.data import test_sweeps
from viewshed.reproduce.plan import StudyPlan
from viewshed.reproduce.protocols import Setting, setting_of
from viewshed.reproduce.scoring import score_contestants
from viewshed.sweep import Sweep
from viewshed.training.config import TrainConfig

THREADS = (2, 1)
Shape = tuple[int, int, int]
"""Width, depth, cells."""


def trade_shapes(plan: StudyPlan) -> Iterator[Shape]:
    """Yield width, depth and cells of every network of the trade study."""
    for cells in plan.trade_cells:
        for depth in plan.trade_depths:
            yield from ((width, depth, cells) for width in plan.trade_widths)


def trade_line(plan: StudyPlan, folder: Path, config: TrainConfig) -> dict[str, Any]:
    """Return what a trained network scores on the held-out sweeps, how long it takes, and its size.

    Args:
        plan: of the study.
        folder: of the study.
        config: of its training.
    """
    from viewshed.networks.engine import OnnxRunner

    path, setting = folder / "trade" / config.name / WEIGHTS, trade_setting(plan, config)
    sweeps = list(test_sweeps(plan, folder, setting, plan.pair_frames))
    runners = {threads: OnnxRunner(path, threads=threads, engine="onnxruntime") for threads in THREADS}
    found = score_contestants(sweeps, {"network": network(runners[2], setting, 1, 0)}, setting.threshold)
    latency = {
        str(threads): latency_ms(runner, setting, sweeps[0].benign, plan.trade_repeats)
        for threads, runner in runners.items()
    }
    size = {"parameters": config.shape.parameters, "flops": config.shape.flops(config.cells)}
    return found | size | {"latency_ms": latency}


def trade_setting(plan: StudyPlan, config: TrainConfig) -> Setting:
    """Return the paper's setting of the trade study's domain, on the network's own grid."""
    base = setting_of(plan, "paper", plan.trade_domain)
    return Setting(
        base.protocol, base.domain, config.grid, base.truth, base.threshold, base.max_range_m, base.heights_m
    )


def latency_ms(runner: Runner, setting: Setting, sweep: Sweep, repeats: int) -> float:
    """Return the median time of one pass through the network in milliseconds, its input made already."""
    card = setting.card(runner.card)
    inputs, masks = card.input_of(sweep)[None], card.shape.no_masks(1)
    times = []
    for _ in range(repeats + 1):
        start = time.perf_counter()
        runner.run(inputs, masks)
        times.append(1e3 * (time.perf_counter() - start))
    return median(times[1:])
