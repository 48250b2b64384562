"""Evaluates the deviation monitor on attacked and corrupted sweeps: scores, alarms and AUROC."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import pandas as pd

from viewshed.fov.estimate import FovEstimator
from viewshed.monitor.deviation import DeviationMonitor
from viewshed.monitor.roc import auroc, auroc_interval, tpr_at_fpr
from viewshed_lab.studies.cases import apply, generator
from viewshed_lab.studies.records import Case, Results, Row, Series, row_of
from viewshed_lab.studies.samples import StudySample

FALSE_ALARM_RATE = 0.01


def watch(
    monitor: DeviationMonitor,
    estimator: FovEstimator,
    sample: StudySample,
    cases: Iterable[Case],
    number: int,
    *,
    domain: str,
    method: str,
    seed: int,
) -> Iterator[Row]:
    """Yield score, alarm and mean deviation of one sweep in each case, or a row that says why it is impossible.

    The monitor must be calibrated for this estimator, which gives deviations, without the benign ``sample``.
    """
    for case in cases:
        of = Series(domain, method, case), sample.sample.scene, number
        try:
            tampered = apply(case, sample, generator(seed, number, case.kind, case.name))
        except ValueError as error:
            yield row_of(*of, refused=" ".join(str(error).split()))
            continue
        estimate = estimator.estimate(tampered.sweep)
        report = monitor.check(estimate)
        mean_std = float(np.nanmean(np.asarray(estimate.std)[monitor.watched]))
        yield row_of(*of, score=report.score, alarm=int(report.alarm), mean_std=mean_std)


def rows_of(results: Results[Any], domain: str, method: str, seed: int = 0) -> pd.DataFrame:
    """Return a table with one row per case of a method in a domain, over all sweeps on which the case is possible.

    Columns: kind and name of the case; the share of alarms (``alarms``). For all but benign sweeps also AUROC against
    the same sweeps untouched, with its 95 % interval (``low``, ``high``); the true positive rate at a limit that at
    most 1 % of these untouched sweeps exceed (``caught``; with fewer than 100: that none exceeds); and the AUROC of the
    plain mean deviation (``auroc_mean``). ``seed`` is that of the intervals.
    """
    rows = results.rows[(results.rows["domain"] == domain) & (results.rows["method"] == method)]
    # Cases that are impossible on all sweeps come last.
    rows = rows.set_index("sweep").sort_index().sort_values("refused", kind="stable")
    benign = rows[rows["kind"] == "benign"]
    table = []
    for (kind, name), case in rows.groupby(["kind", "name"], sort=False):
        changed = case[case["refused"] == ""]
        figures = {"kind": kind, "name": name, "alarms": changed["alarm"].mean()}
        if name and len(changed):
            clean = benign.loc[changed.index]
            low, high = auroc_interval(clean["score"], changed["score"], generator(seed, name), paired=True)
            figures |= {"auroc": auroc(clean["score"], changed["score"]), "low": low, "high": high,
                        "caught": tpr_at_fpr(clean["score"], changed["score"], FALSE_ALARM_RATE),
                        "auroc_mean": auroc(clean["mean_std"], changed["mean_std"])}  # fmt: skip
        table.append(figures)
    return pd.DataFrame(table, columns=["kind", "name", "alarms", "auroc", "low", "high", "caught", "auroc_mean"])
