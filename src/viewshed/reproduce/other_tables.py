"""The tables beside the 72 pairs: trainings, trade study, monitor."""

from __future__ import annotations

from math import isnan
from typing import Any

from viewshed.attacks import FAMILY
from viewshed.integrity.study_rows import Row, rows_of
from viewshed.reproduce.protocols import MIXTURES
from viewshed.reproduce.results import Results, accuracy
from viewshed.reproduce.scoring import Measured
from viewshed.vulnerability.page import Table
from viewshed.vulnerability.results import f1, precision
from viewshed.vulnerability.tables import three


def training_table(results: Results, protocol: str) -> Table:
    """Return how each training of a protocol went."""
    rows = [[name, *_trained(line)] for (of, name), line in results.models.items() if of == protocol]
    header = ["model", "epochs", "best", "validation loss", "validation F1", "frames/s", "in the network", "seconds"]
    return Table(header, rows)


def _trained(line: dict[str, Any]) -> list[str]:
    epoch = line["history"][line["best"] - 1]
    scores = [f"{epoch['validation_loss']:.4f}", three(epoch["f1"])]
    speed = [f"{line['frames_per_s']:.0f}", f"{100 * line['network_share']:.0f} %", f"{line['seconds']:.0f}"]
    return [str(len(line["history"])), str(line["best"]), *scores, *speed]


def trade_rows(results: Results) -> list[dict[str, Any]]:
    """Return the networks of the trade study by cells, depth and width, with what each scores as ``measured``."""
    lines = [
        line | {"shape": _shape(line), "measured": Measured.from_json(line["scores"]["network"]["benign"])}
        for line in results.others.get("trade", {}).values()
    ]
    return sorted(lines, key=lambda line: line["shape"][::-1])


def _shape(line: dict[str, Any]) -> tuple[int, ...]:
    """Return width, depth and cells."""
    return tuple(map(int, line["job"][1:]))


def trade_table(results: Results) -> Table:
    """Return what each network of the trade study scores, how long a pass takes, and its size."""
    rows = []
    for line in trade_rows(results):
        pooled, latency = line["measured"].counts.sum(axis=0), line["latency_ms"]
        rates = [three(float(measure(pooled))) for measure in (precision, accuracy, f1)]
        sizes = [f"{line['parameters'] / 1e6:.3f}", f"{line['flops'] / 1e9:.3f}"]
        rows.append([*map(str, line["shape"]), *rates, f"{latency['2']:.2f}", f"{latency['1']:.2f}", *sizes])
    header = ["width", "depth", "cells", "precision", "accuracy", "F1", "ms, 2 threads", "ms, 1 thread"]
    return Table([*header, "parameters, M", "GFLOP"], rows)


def monitor_rows(results: Results) -> dict[str, list[Row]]:
    """Return what the monitor does in each case, by what its network was trained on."""
    seed, found = results.store.plan.test_seed, results.others.get("monitor", {})
    return {mixture: rows_of(found[mixture]["lines"], seed) for mixture in MIXTURES if mixture in found}


def monitor_table(results: Results, kind: str) -> Table:
    """Return AUROC, its interval, detections at 1 % and alarms for every attack or corruption.

    Args:
        results: of the study.
        kind: ``attack`` or ``corruption``.
    """
    found = monitor_rows(results)
    words = ["AUROC [95 %]", "caught at 1 %", "alarms", "AUROC of the mean"]
    header = [kind, *(f"{word}, {mixture}-trained" for mixture in found for word in words)]
    rows: dict[str, list[str]] = {}
    for each in found.values():
        for row in each:
            if row.kind in ("benign", kind):
                rows.setdefault(_called(row), []).extend(_told(row))
    return Table(header, [[name, *cells] for name, cells in rows.items()])


def _called(row: Row) -> str:
    return (
        "*benign*" if row.kind == "benign" else f"{row.name} ({FAMILY[row.name]})" if row.name in FAMILY else row.name
    )


def _told(row: Row) -> list[str]:
    area = "–" if isnan(row.auroc) else f"{three(row.auroc)} [{three(row.auroc_low)}, {three(row.auroc_high)}]"
    return [area, three(row.caught), three(row.alarms), three(row.auroc_mean)]
