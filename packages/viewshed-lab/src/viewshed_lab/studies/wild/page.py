"""The page of the wild study: own and other worlds, figures beyond F1, the ladder, the worst scenes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from viewshed.metrics import ConfusionCounts
from viewshed_lab._page import facts
from viewshed_lab.data.wild import GIVEN
from viewshed_lab.studies.formatting import commits, format_interval, format_number, format_rate, format_rates
from viewshed_lab.studies.pages import Picture, Table, fill_template
from viewshed_lab.studies.records import cells_of
from viewshed_lab.studies.statistics import f1
from viewshed_lab.studies.store import ResultStore
from viewshed_lab.studies.wild.evaluate import AS_GIVEN, LADDER
from viewshed_lab.studies.wild.figures import picture_of, reliability_of
from viewshed_lab.studies.wild.plan import WildPlan
from viewshed_lab.studies.wild.pool import Pool

OWN = "own"

JUDGED = ("shadow_map",)
"""Methods with tables of F1 by style, sensor and mounting, and with pictures of the worst scenes."""

_WHAT = {
    "rings": "Known: ring, time and intensity of each return; no sensor, no height, no attitude",
    "nothing": "Known: points alone",
    "table": "Known: the maker's beam table, rings, height and attitude",
}


def files_of(store: ResultStore[WildPlan]) -> dict[str, bytes]:
    """Return the files by name: pictures, then the page ``wild.md``."""
    results, plan = store.results(), store.plan
    store.require(results)
    pool = Pool(results.rows)
    other = _own_and_other(pool)[1]
    knowledge = {_WHAT[given]: given for given in GIVEN if given in plan.told}
    given = next(one for one in ("rings", *plan.told) if one in plan.told)

    def part(domain: str, target: str, what: str) -> Pool:
        return pool.of(domain=domain, target=target, told=knowledge[what], method=plan.judged)

    page = fill_template(
        "wild/page.md", domains=pool.names("domain"), targets=plan.targets, knowledge=knowledge, part=part, plan=plan,
        other=lambda domain, target, given=given: other.of(domain=domain, target=target, told=given),
        agreement=_agreement, beyond_f1=_beyond_f1, broken_down=_broken_down, ladder=_ladder, worst=_worst,
        reliability=_reliability,
    )  # fmt: skip
    about = facts(
        plan=f"{plan.name}: {plan.about}", sets=", ".join(plan.sets), sweeps=str(len(results.facts)),
        commits=commits(results),
    )  # fmt: skip
    return page.files("wild.md", about)


def _agreement(pool: Pool) -> Table:
    """Return the table of precision, recall and F1 by method, own and other, and of recall at equal precision."""
    rows, other = [], _own_and_other(pool)[1]
    bar = other.of(method=AS_GIVEN).counts.precision
    for method in pool.names("method"):
        row = [method]
        for part in _own_and_other(pool.of(method=method)):
            counts = part.counts
            row += [format_rates(counts.precision, counts.recall), format_interval(counts.f1, part.interval(f1))]
        rows.append([*row, format_rate(other.of(method=method).recall_at(bar))])
    header = ["method", "own: precision / recall", "own: F1", "other: precision / recall", "other: F1",
              f"other: recall at precision {format_rate(bar)}"]  # fmt: skip
    return Table(header, rows)


def _beyond_f1(pool: Pool) -> Table:
    """Return the table of calibration, doubt, claims without beams, and states by method, own / other."""
    rows = []
    for method in pool.names("method"):
        parts = _own_and_other(pool.of(method=method))
        rows.append([
            method,
            format_rates(*(part.mean_f1() for part in parts)),
            format_rates(*(part.where(part.rows["flat"] > 0).counts.f1 for part in parts)),
            format_rates(*(part.clear_f1() for part in parts)),
            format_rates(*(part.ece() for part in parts)),
            *(format_rates(*(part.mean(name) for part in parts)) for name in ("auroc", "auroc_std")),
            " / ".join(format_number(part.mean("aurc"), 4) for part in parts),
            format_rates(*(parts[1].share(name, "claimed_m2") for name in ("beyond_m2", "beyond_reach_m2"))),
            format_rates(parts[1].share("off_m2", "known_m2"), parts[1].share("off_sure_m2", "off_m2")),
            format_rates(*(part.share("unaimed_hidden", "unaimed") for part in parts)),
        ])  # fmt: skip
    header = ["own / other", "F1 by scene", "F1, flat", "F1, clear", "ECE", "AUROC", "AUROC std", "AURC",
              "beyond (other)", "off (other)", "HIDDEN"]  # fmt: skip
    return Table(header, rows)


def _own_and_other(pool: Pool) -> tuple[Pool, Pool]:
    return pool.of(set_name=OWN), pool.where(pool.rows["set_name"] != OWN)


def _broken_down(pool: Pool) -> Iterator[Table]:
    """Yield tables of precision, recall and F1 of the judged methods by style, sensor and mounting."""
    methods = [name for name in JUDGED if name in pool.names("method")]
    for key in ("style", "sensor", "mounting"):
        rows = []
        for name in sorted(pool.names(key)):
            part = pool.of(**{key: name})
            counts = [part.of(method=method).counts for method in methods]
            scenes = str(len(part.names("scene")))
            rows.append([name, scenes, *(format_rates(one.precision, one.recall, one.f1) for one in counts)])
        yield Table([key, "scenes", *methods], rows)


def _ladder(pool: Pool) -> Table | None:
    """Return the table of the shadow map's figures by step of exact knowledge, over the same scenes; None without."""
    with_ladder = pool.of(method=LADDER[0]).names("scene")
    if not with_ladder:
        return None
    same = pool.of(scene=with_ladder)
    rows = []
    for name in (AS_GIVEN, *LADDER):
        part = same.of(method=name)
        counts = part.counts
        shares = (
            part.share("off_m2", "known_m2"),
            part.share("off_sure_m2", "off_m2"),
            part.share("unaimed_hidden", "unaimed"),
        )
        rows.append([name, format_rates(counts.precision, counts.recall), format_interval(counts.f1, part.interval(f1)),
                     *map(format_rate, shares)])  # fmt: skip
    return Table(["the shadow map given", "precision / recall", "F1", "ground off", "of that claimed", "HIDDEN"], rows)


def _reliability(pool: Pool) -> Picture | None:
    """Return the reliability diagram of the judged methods on other worlds; None without any."""
    judged = pool.of(method=JUDGED)
    if judged.rows.empty:
        return None
    what = "share of cells that are visible, by the stated probability, on other worlds"
    return Picture(f"wild_{judged.names('domain')[0]}_reliability.png", reliability_of(judged), what)


def _worst(plan: WildPlan, pool: Pool) -> Iterator[Table | Picture]:
    """Yield a table of the worst scene of each of the worst styles for the last judged method, and their pictures."""
    judged = [name for name in JUDGED if name in pool.names("method")]
    if not judged or not plan.worst:
        return
    ranked = pool.of(method=judged[-1])
    ranked = Pool(ranked.rows.assign(f1=np.nan_to_num(f1(cells_of(ranked.rows)))).sort_values("f1", kind="stable"))
    chosen = ranked.rows.drop_duplicates("style")[: plan.worst]
    counts = [ConfusionCounts(*map(int, cells)) for cells in cells_of(chosen)]
    yield Table(
        ["scene", "sensor", "mounting", f"{judged[-1]}: precision / recall / F1", "height off by, m"],
        [
            [one.scene, one.sensor, one.mounting, format_rates(n.precision, n.recall, n.f1),
             f"{one.height_error_m:+.2f}"] for one, n in zip(chosen.itertuples(), counts, strict=True)
        ],
    )  # fmt: skip
    for one in chosen.itertuples():
        what = f"{one.scene}: exact ground, its error, a cut, true states, mistakes of {' and '.join(judged)}"
        yield Picture(f"wild_{one.domain}_{one.style}.png", picture_of(one, judged), what)
