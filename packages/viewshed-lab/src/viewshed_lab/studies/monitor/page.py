"""The page of the study of alarms: false alarm rates, detection of attacks, value of each evidence, public traces."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from viewshed.arrays import F32, F64
from viewshed.monitor.calibration import Calibration, changes_of
from viewshed.monitor.evidence import EVIDENCE
from viewshed.monitor.roc import auroc
from viewshed.monitor.score import Past, numbers_of, of_place, sector_scores
from viewshed.monitor.tails import peaks_of
from viewshed_lab._page import facts, page
from viewshed_lab.studies.monitor.plan import MonitorPlan
from viewshed_lab.studies.monitor.streams import ONSETS, StreamEvidence
from viewshed_lab.studies.monitor.traces import SPOOFED, Called
from viewshed_lab.studies.pages import Table, fill_template

ALARM_RATES = (1.0, 6.0, 10.0)
"""False alarms per hour for which limits are evaluated."""

HONEST = (*ONSETS, "stated_noise")
"""Cases that are not attacks: onsets of conditions, and onset of pose noise with a stated covariance."""


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """Scores of a stream under a calibration."""

    stream: StreamEvidence  # the stream
    scores: F32  # (T - EARLIER_SWEEPS,) of its sweeps
    surprises: F32  # (T - EARLIER_SWEEPS, E, SECTORS) of their evidence
    attacked: F32  # (C, K, E, SECTORS) surprises of the attacked sweeps

    @property
    def hours(self) -> float:
        """Duration at 10 Hz."""
        return len(self.scores) / 36000.0

    def alarms(self, limit: float) -> int:
        """Return the number of false alarms at a limit."""
        return int((peaks_of(self.scores) > limit).sum())


def judge(calibration: Calibration, stream: StreamEvidence) -> Judged:
    """Return the scores of a stream; attacked sweeps branch off the stream's past, and extend the branch."""
    surprises = calibration.changes(changes_of(stream.benign, calibration.prior_scale))
    begins: dict[int, list[int]] = defaultdict(list)
    for case, (_, first) in enumerate(stream.cases):
        begins[first].append(case)
    past, attacked = Past(calibration.prior_scale, EVIDENCE), np.zeros(stream.attacked.shape, np.float32)
    for number, evidence in enumerate(stream.benign):
        for case in begins.get(number, ()):
            branch, reference = past.copy(), past.reference()
            for k, tampered in enumerate(stream.attacked[case]):
                changes = reference.changes(numbers_of(branch.onset(tampered)))
                attacked[case, k] = calibration.changes(changes[None])[0]
                branch.add(tampered)
        past.add(evidence)
    return Judged(stream, _scores(surprises), surprises, attacked)


def _scores_alone(judged: Judged) -> Judged:
    """Return a judged stream without its evidence and surprises, to save memory."""
    stream = replace(judged.stream, benign=judged.stream.benign[:0])
    return replace(judged, stream=stream, surprises=judged.surprises[:0])


def rate_interval(alarms: int, hours: float) -> tuple[float, float]:
    """Return the 95 % interval of an alarm rate per hour (Garwood, 1936).

    >>> [round(end, 2) for end in rate_interval(0, 3.0)]
    [0.0, 1.23]
    """
    low = stats.chi2.ppf(0.025, 2 * alarms) / 2 if alarms else 0.0
    return float(low) / hours, float(stats.chi2.ppf(0.975, 2 * alarms + 2)) / 2 / hours


def files_of(
    plan: MonitorPlan,
    calibration: Calibration,
    report: Iterable[StreamEvidence],
    benign: Iterable[StreamEvidence],
    called: Sequence[Called],
    left_out: Mapping[str, tuple[int, float, float]],
) -> dict[str, bytes]:
    """Return the page by file name.

    Streams of ``report`` have attacks; those of ``benign`` only add to the false alarm rates. ``left_out`` is the
    result of :func:`tried`.

    Raises:
        ValueError: there are no streams with attacks.
    """
    judged = [judge(calibration, stream) for stream in report]
    if not judged:
        raise ValueError("a page needs streams to report on, got none; run the study")
    # Hours of surprises by sector would fill the memory; only the scores are needed.
    all_judged = [*judged, *(_scores_alone(judge(calibration, stream)) for stream in benign)]
    rates = _rates(calibration, all_judged)
    styles = [(str(style), some) for style, some in rates.groupby("style", sort=False)]
    groups = [(f"{key}: {value}", some) for key in ("sensor", "conditions", "speed", "poses")
              for value, some in rates.groupby(key, sort=False)]  # fmt: skip
    page = fill_template(
        "monitor/page.md", places=len({one.stream.style for one in judged}),
        minutes=f"{rates['hours'].sum() * 60.0:.0f}", calibration_minutes=f"{calibration.hours * 60.0:.0f}",
        styles=", ".join(plan.calibration),
        promises="\n".join(f"- {calibration.promise(rate)}" for rate in ALARM_RATES),
        places_table=_rate_table([("all", rates), *styles]), groups_table=_rate_table(groups),
        exceeded=_exceeded([*styles, *groups]),
        families_table=_families(calibration, judged), reliability_table=_reliability(calibration, all_judged),
        left_out_table=_left_out(calibration, judged), tried_table=_tried(left_out), clean_table=_clean(all_judged),
        worsened_table=_worsened(judged), traces=[_traces(called), *_strips(called)],
    )  # fmt: skip
    about = facts(
        seed=str(plan.seed),
        plan=plan.name,
        streams=f"{len(judged)} of {plan.seconds:g} s with attacks, {len(all_judged) - len(judged)} without",
    )
    return page.files("monitor.md", about)


def _rates(calibration: Calibration, judged: Sequence[Judged]) -> pd.DataFrame:
    """Return one row per stream: style and facts, hours, and the false alarms at the limits of ``ALARM_RATES``."""
    limits = {rate: calibration.limit(rate, extrapolate=True) for rate in ALARM_RATES}
    return pd.DataFrame([
        {"style": one.stream.style, **one.stream.facts, "hours": one.hours}
        | {rate: one.alarms(limit) for rate, limit in limits.items()}
        for one in judged
    ])  # fmt: skip


def _rate_table(groups: Iterable[tuple[str, pd.DataFrame]]) -> Table:
    """Return the table of false alarms of groups of streams, and their rates per hour."""
    rows = []
    for name, group in groups:
        hours, cells = group["hours"].sum(), []
        for alarms in group[[*ALARM_RATES]].sum():
            cells += [str(alarms), _rate(alarms, hours)]
        rows.append([name, f"{hours * 60:.1f}", *cells])
    words = [(f"alarms at a limit of {rate:g} an hour", f"an hour, limit of {rate:g}") for rate in ALARM_RATES]
    return Table(["", "minutes", *(word for both in words for word in both)], rows)


def _rate(alarms: int, hours: float) -> str:
    """Return the alarm rate per hour with its interval, as text."""
    low, high = rate_interval(alarms, hours)
    return f"{alarms / hours:.1f} [{low:.1f}, {high:.1f}]"


def _exceeded(groups: Sequence[tuple[str, pd.DataFrame]]) -> str:
    """Return a list, one line per limit, of the groups whose alarm rate exceeds the rate of the limit."""
    lines = []
    for rate in ALARM_RATES:
        counts = [(name, int(group[rate].sum()), float(group["hours"].sum())) for name, group in groups]
        more = [f"{name} {_rate(alarms, hours)}" for name, alarms, hours in counts if alarms > rate * hours]
        lines.append(f"- at a limit of {rate:g} an hour: {', '.join(more) or 'none'}")
    return "\n".join(lines)


def _by_family(judged: Sequence[Judged]) -> dict[str, F32]:
    """Return the surprises (C, K, E, SECTORS) of the attacked sweeps of each attack."""
    by_name: dict[str, list[F32]] = defaultdict(list)
    for one in judged:
        for case, (name, _) in enumerate(one.stream.cases):
            by_name[name].append(one.attacked[case])
    return {name: np.stack(by_name[name]) for name in sorted(by_name)}


def _scores(surprises: F32) -> F32:
    """Return the scores (…) of surprises (…, E, SECTORS)."""
    return np.asarray(sector_scores(surprises, of_place(EVIDENCE)).max(axis=-1))


def _families(calibration: Calibration, judged: Sequence[Judged]) -> Table:
    benign = np.concatenate([one.scores for one in judged])
    rows, means = [], []
    kinds = list(EVIDENCE)
    for name, surprises in _by_family(judged).items():
        scores = _scores(surprises)
        caught = [float((scores.max(axis=1) > calibration.limit(r, extrapolate=True)).mean()) for r in ALARM_RATES]
        area = auroc(benign, scores[:, 0])
        median = np.median(np.nan_to_num(surprises[:, 0]).max(axis=2), axis=0)
        best = ", ".join(f"{kinds[k]} {median[k]:.1f}" for k in np.argsort(-median)[:2])
        rows.append([name, str(len(scores)), f"{area:.3f}", *(f"{one:.2f}" for one in caught), best])
        if name not in HONEST:
            means.append([area, *caught])
    mean = np.mean(means, axis=0)
    rows.append(["mean of the attacks", "", f"{mean[0]:.3f}", *(f"{one:.2f}" for one in mean[1:]), ""])
    by_style = [_onset_auroc([one for one in judged if one.stream.style == style]) for style in _styles(judged)]
    worst, best = np.nanmin(by_style), np.nanmax(by_style)
    rows.append(["onset AUROC by style", "", f"{worst:.3f} to {best:.3f}", *("" for _ in ALARM_RATES), ""])
    limits = (f"caught in .5 s at {r:g} alarms an hour" for r in ALARM_RATES)
    return Table(["attack", "cases", "onset AUROC", *limits, "median surprise"], rows)


def _styles(judged: Sequence[Judged]) -> list[str]:
    return sorted({one.stream.style for one in judged})


def _onset_auroc(judged: Sequence[Judged]) -> float:
    """Return the mean over the attacks of the AUROC of their first sweeps; NaN without any."""
    benign = np.concatenate([one.scores for one in judged])
    attacks = [surprises for name, surprises in _by_family(judged).items() if name not in HONEST]
    return float(np.mean([auroc(benign, _scores(surprises)[:, 0]) for surprises in attacks])) if attacks else np.nan


def _reliability(calibration: Calibration, judged: Sequence[Judged]) -> Table:
    shares = (0.1, 0.03, 0.01, 0.003, 0.001)
    rows = []
    for name in ["all", *_styles(judged)]:
        members = [one for one in judged if name in ("all", one.stream.style)]
        p: F64 = np.concatenate([[calibration.p_value(float(s)) for s in one.scores] for one in members])
        rows.append([name, *(f"{(p <= share).mean():.4f}" for share in shares)])
    return Table(["share of sweeps with p at most", *(f"{share:g}" for share in shares)], rows)


def _left_out(calibration: Calibration, judged: Sequence[Judged]) -> Table:
    """Return the table of the monitor's figures without each kind of evidence, at an equal number of false alarms."""
    limit, hours = calibration.limit(6.0, extrapolate=True), sum(one.hours for one in judged)
    count = max(sum(one.alarms(limit) for one in judged), 1)
    families = {name: surprises for name, surprises in _by_family(judged).items() if name not in HONEST}
    rows = []
    for name in ["none", *EVIDENCE]:
        kept = np.array([[kind != name] for kind in EVIDENCE])
        benign = [_scores(one.surprises * kept) for one in judged]
        peaks = np.sort(np.concatenate([peaks_of(one) for one in benign]))[::-1]
        own_limit = float(peaks[min(count, len(peaks) - 1)]) if len(peaks) else 0.0
        benign_scores = np.concatenate(benign)
        attacked: list[NDArray[np.float32]] = [_scores(surprises * kept) for surprises in families.values()]
        area = np.mean([auroc(benign_scores, scores[:, 0]) for scores in attacked])
        caught = np.mean([(scores.max(axis=1) > own_limit).mean() for scores in attacked])
        rows.append([name, f"{area:.3f}", f"{caught:.2f}"])
    return Table(["left out", "onset AUROC, mean", f"caught in .5 s at {count / hours:.0f} an hour, mean"], rows)


def _tried(results: Mapping[str, tuple[int, float, float]]) -> Table:
    """Return the table of rejected evidence, by attack on development streams."""
    rows = [[name, str(cases), f"{area:.2f}", f"{late:.2f}"] for name, (cases, area, late) in results.items()]
    return Table(["attack", "cases", "onset AUROC of mixed pixels", "share with returns out of their time"], rows)


def _clean(judged: Sequence[Judged]) -> Table:
    """Return the table of the share of sweeps without a corruption that are called degraded, by conditions."""
    rows = []
    for name in sorted({one.stream.facts["conditions"] for one in judged}):
        members = [one.stream.degraded for one in judged if one.stream.facts["conditions"] == name]
        degraded = np.concatenate(members)
        rows.append([name, str(len(members)), str(len(degraded)), f"{degraded.mean():.3f}"])
    return Table(["conditions", "streams", "sweeps", "share degraded"], rows)


def _worsened(judged: Sequence[Judged]) -> Table:
    """Return the table of the share of streams called degraded within .5 s of a corruption of severity 5."""
    shares = pd.DataFrame([one.stream.worsened for one in judged], dtype=float).mean()
    rows = [[name, f"{share:.2f}"] for name, share in [*shares.items(), ("mean", shares.mean())]]
    return Table(["corruption, severity 5", "share called"], rows)


def _traces(called: Sequence[Called]) -> Table | str:
    """Return the table of called sweeps by trace and in all; sweeps of a trace without a key count as honest."""
    by_trace = {name: [one for one in called if one.trace == name] for name in sorted({one.trace for one in called})}
    if not by_trace:
        return "No traces were given."
    rows = []
    for name, part in [*by_trace.items(), *([("all", list(called))] if len(by_trace) > 1 else [])]:
        spoofed, honest = [one for one in part if one.is_spoofed], [one for one in part if not one.is_spoofed]
        alarms = sum(one.inconsistent for one in honest)
        rows.append([
            name,
            "no key" if all(one.is_spoofed is None for one in part) else _share([one.inconsistent for one in spoofed]),
            "" if name == "all" else ", ".join(_delays(part)),
            _share([one.inconsistent for one in honest]),
            f"{rate_interval(alarms, max(len(honest), 1) / 36000.0)[1]:.0f}",
            _share([one.degraded for one in honest]),
            "" if name == "all" else ", ".join(f"{one.number}: {one.score:.1f}" for one in spoofed),
            f"{max((one.score for one in honest), default=0.0):.1f}",
        ])  # fmt: skip
    upper = "honest called an hour, upper end (95 %)"
    header = ["trace", "spoofed called", "delay in sweeps", "honest called", upper, "honest degraded"]
    return Table([*header, "scores of the spoofed", "highest honest"], rows)


def _share(which: Sequence[bool]) -> str:
    return f"{sum(which)} of {len(which)}"


def _delays(trace: Sequence[Called]) -> list[str]:
    """Return the delay in sweeps until each spoofed one of a trace is called, or ``missed`` after half a second."""
    delays = []
    for number, one in enumerate(trace):
        if one.is_spoofed:
            hits = [delay for delay, later in enumerate(trace[number : number + 6]) if later.inconsistent]
            delays.append(str(hits[0]) if hits else "missed")
    return delays


def _strips(called: Sequence[Called]) -> list[str]:
    """Return, per trace, the verdicts on called sweeps, on spoofed sweeps and on those around them, as text."""
    strips = []
    for name in sorted({one.trace for one in called}):
        of_trace = [one for one in called if one.trace == name]
        lines = [
            f"{c.number:5d}  p {c.p_value:8.1e}  score {c.score:5.2f}  {'SPOOFED' if c.is_spoofed else '':8}"
            f"{'called' if c.inconsistent else ''}  {c.reason if c.inconsistent else ''}".rstrip()
            for number, c in enumerate(of_trace)
            if c.inconsistent or c.is_spoofed or any(o.is_spoofed for o in of_trace[max(number - 3, 0) : number + 4])
        ]
        strips.append("\n".join([f"### {name}", "```text", *lines, "```"]))
    return strips


def trace_page(called: Sequence[Called], limit: float, per_hour: float) -> str:
    """Return the page of the traces alone, with their p-values over time."""
    about = facts(limit=f"score {limit:.2f}, for {per_hour:g} false alarms an hour")
    names = sorted({one.trace for one in called})
    known, others = [name for name in names if name in SPOOFED], [name for name in names if name not in SPOOFED]
    parts = []
    if known:
        parts.append(
            f"{' and '.join(known)}: real sweeps of one car (Allenpandas/LiDAR-Spoofing-Forensics-Datasets, Apache-2.0)"
            " without rings. The poses published with them are not used. The authors do not say which sweeps are"
            " spoofed. This key is inferred: in single statistics, these sweeps stand out by gaps of 10 to 25 times."
        )
    parts += [
        f"{name}: without a key of its spoofed sweeps, all sweeps count as honest."
        if all(one.is_spoofed is None for one in called if one.trace == name)
        else f"{name}: the spoofed sweeps were given with `--key`."
        for name in others
    ]
    intro = (
        " ".join(parts) + " The upper end of a rate is that of a Poisson interval (Garwood) for sweeps at 10 Hz. Below"
        " are all called sweeps, and those around each spoofed one:"
    )
    return page(
        "Public traces of spoofed drives", about, f"## What is called\n\n{_traces(called)}", intro, *_strips(called)
    )
