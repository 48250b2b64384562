"""The monitor of the deviation tried on sweeps that are attacked and corrupted, and how well it tells them apart."""

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
    """Yield score, alarm and mean deviation of one sweep in each case, or why the case cannot be made.

    The monitor is calibrated for this estimator, which gives deviations, and saw nothing of the benign ``sample``.
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
    """Return one row for each case of a method in a domain, over all sweeps that the case could be made of.

    Columns: kind and name of the case; the share that alarms (``alarms``); and but for benign sweeps AUROC against the
    same sweeps untouched with its 95 % interval (``low``, ``high``), the share above a limit that at most 1 % of these
    untouched sweeps pass (``caught``; with fewer than 100: that none passes), and the AUROC of the plain mean deviation
    (``auroc_mean``). ``seed`` is that of the intervals.
    """
    rows = results.rows[(results.rows["domain"] == domain) & (results.rows["method"] == method)]
    # Cases that could be made of no sweep come last.
    rows = rows.set_index("sweep").sort_index().sort_values("refused", kind="stable")
    benign = rows[rows["kind"] == "benign"]
    found = []
    for (kind, name), case in rows.groupby(["kind", "name"], sort=False):
        made = case[case["refused"] == ""]
        figures = {"kind": kind, "name": name, "alarms": made["alarm"].mean()}
        if name and len(made):
            was, now = benign.loc[made.index], made
            low, high = auroc_interval(was["score"], now["score"], generator(seed, name), paired=True)
            figures |= {"auroc": auroc(was["score"], now["score"]), "low": low, "high": high,
                        "caught": tpr_at_fpr(was["score"], now["score"], FALSE_ALARM_RATE),
                        "auroc_mean": auroc(was["mean_std"], now["mean_std"])}  # fmt: skip
        found.append(figures)
    return pd.DataFrame(found, columns=["kind", "name", "alarms", "auroc", "low", "high", "caught", "auroc_mean"])
