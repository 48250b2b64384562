"""What a monitor found, one row for each case, and the page of its study."""

from __future__ import annotations

from collections.abc import Mapping
from math import isnan
from typing import Any

import numpy as np
import pandas as pd

from viewshed.monitor.roc import auroc, auroc_interval, tpr_at_fpr
from viewshed_lab._page import facts
from viewshed_lab.studies.cases import generator
from viewshed_lab.studies.deviation.jobs import METHOD
from viewshed_lab.studies.deviation.plan import DeviationPlan
from viewshed_lab.studies.formatting import by_name, commits, format_interval, format_rate, pivot
from viewshed_lab.studies.pages import Table, fill_template
from viewshed_lab.studies.records import Results
from viewshed_lab.studies.store import ResultStore
from viewshed_lab.threats.attacks import FAMILY

REGIONS = ("touched", "wedge", "changed")
"""Where suspect cells should lie: cells with a return that was added or removed; cells whose azimuth the attacker
reaches; cells that the estimate calls visible on only one of the clean and the spoilt sweep."""

FALSE_ALARM_RATE = 0.01

_NUMBERS = ("score", "alarm", "mean_std", "suspects", "watched", "returns",
            *(f"{region} {what}" for region in REGIONS for what in ("cells", "suspects")))  # fmt: skip


def rows_of(results: Results[Any], domain: str, method: str, seed: int = 0) -> pd.DataFrame:
    """Return one row for each case of a method in a domain, over all sweeps that the case could be made of.

    Columns: kind and name of the case; sweeps that it was done to (``frames``) and could not be done to (``refused``);
    sweeps on which the attack touched no return (``idle``); the share that alarms (``alarms``); and but for benign
    sweeps AUROC against the same sweeps untouched with its 95 % interval (``low``, ``high``), the share above a limit
    that at most 1 % of these untouched sweeps pass (``caught``; with fewer than 100: that none passes), and the AUROC
    of the plain mean deviation (``auroc_mean``). For each of ``REGIONS`` that the case has: how many watched cells it
    has, the share of the suspect cells that lie in it (``precision``), of its cells that are suspect (``recall``), and
    the precision of guessing (``chance``).

    Args:
        results: rows of ``jobs.watch``; their order changes nothing.
        domain: of the rows.
        method: of the rows.
        seed: of the intervals.
    """
    rows = results.rows[(results.rows["domain"] == domain) & (results.rows["method"] == method)]
    rows = rows.reindex(columns=["kind", "name", "sweep", "refused", *_NUMBERS]).set_index("sweep").sort_index()
    # Cases that could be made of no sweep come last.
    rows = rows.sort_values("refused", kind="stable")
    made = rows[rows["refused"] == ""]
    cases = rows.groupby(["kind", "name"], sort=False)
    return pd.DataFrame([
        {"kind": kind, "name": name, "frames": (case["refused"] == "").sum(), "refused": (case["refused"] != "").sum(),
         **_figures(case[case["refused"] == ""], made[made["kind"] == "benign"], name, seed)}
        for (kind, name), case in cases
    ])  # fmt: skip


def _figures(made: pd.DataFrame, clean: pd.DataFrame, name: str, seed: int) -> dict[str, float]:
    """Return the figures of a case from its sweeps and the untouched ones; see :func:`rows_of`."""
    found: dict[str, float] = {"idle": (made["returns"] == 0).sum(), "alarms": made["alarm"].mean()}
    if name and len(made):
        benign = clean.loc[made.index]
        was, now = benign["score"].to_numpy(), made["score"].to_numpy()
        low, high = auroc_interval(was, now, generator(seed, name), paired=True)
        found |= {"auroc": auroc(was, now), "low": low, "high": high, "caught": tpr_at_fpr(was, now, FALSE_ALARM_RATE),
                  "auroc_mean": auroc(benign["mean_std"].to_numpy(), made["mean_std"].to_numpy())}  # fmt: skip
    for region in REGIONS:
        here = made.dropna(subset=f"{region} cells")
        cells, both = here[f"{region} cells"].sum(), here[f"{region} suspects"].sum()
        suspects, watched = here["suspects"].sum(), here["watched"].sum()
        shares = {"precision": (both, suspects), "recall": (both, cells), "chance": (cells, watched)}
        found[f"{region} cells"] = cells
        found |= {f"{region} {word}": part / whole if whole else np.nan for word, (part, whole) in shares.items()}
    return found


def monitor_table(rows: Mapping[str, pd.DataFrame], kind: str) -> Table:
    """Return AUROC, its interval, detections at 1 % and alarms for every attack or corruption.

    Args:
        rows: by the name that stands behind a comma in the header; one without a name has no comma.
        kind: ``attack`` or ``corruption``.
    """
    words = ["AUROC [95 %]", "caught at 1 %", "alarms", "AUROC of the mean"]
    header = [kind, *(f"{word}, {name}" if name else word for name in rows for word in words)]
    cells: dict[str, list[str]] = {}
    for several in rows.values():
        for row in several[several["kind"].isin(["benign", kind])].itertuples():
            family = f" ({FAMILY[row.name]})" if row.name in FAMILY else ""
            area = "–" if isnan(row.auroc) else format_interval(row.auroc, (row.low, row.high))
            rates = map(format_rate, (row.caught, row.alarms, row.auroc_mean))
            cells.setdefault(f"{row.name}{family}" if row.name else "*benign*", []).extend([area, *rates])
    return Table(header, [[name, *line] for name, line in cells.items()])


def located_table(rows: pd.DataFrame) -> Table:
    """Return how well suspect cells fit what was touched, the wedge and what changed: precision (chance) / recall."""

    def words(row: Mapping[str, float], region: str) -> str:
        rates = [format_rate(row[f"{region} {word}"]) for word in ("precision", "chance", "recall")]
        return "{} ({}) / {}".format(*rates) if row[f"{region} cells"] else "–"

    located = rows[(rows[[f"{region} cells" for region in REGIONS]] > 0).any(axis=1)].to_dict("records")
    return pivot("", {row["name"]: row for row in located}, by_name(REGIONS), words)


def files_of(store: ResultStore[DeviationPlan]) -> dict[str, bytes]:
    """Return the page as a file by its name."""
    plan, results = store.plan, store.results("watch")
    store.require(results)
    rows = rows_of(results, plan.domain, METHOD, plan.seed)
    page = fill_template("deviation/page.md", severity=plan.severity, rows=rows, monitor_table=monitor_table,
                         located_table=located_table)  # fmt: skip
    about = facts(
        plan=f"{plan.name}: {plan.about}", seed=str(plan.seed), domain=f"{plan.domain}, {plan.target}",
        sweeps=f"{plan.frames} to fit, {plan.frames} to calibrate, {rows['frames'][0]} of {plan.frames} to report",
        passes=str(plan.passes), false_alarm_rate=f"{plan.false_alarm_rate:g}", commits=commits(results),
    )  # fmt: skip
    return page.files("deviation.md", about)
