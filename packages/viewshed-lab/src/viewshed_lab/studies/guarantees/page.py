"""The page of the study of guarantees: certificates, attacks on them, guaranteed masks, broken assumptions, driving."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from viewshed.fov.estimate import FovEstimate
from viewshed.guarantees.certificate import certify
from viewshed.guarantees.conformal import BANDS_M, PLACE_EDGES, THRESHOLDS, lower_bound
from viewshed.guarantees.envelope import Threat
from viewshed.preprocess.leveling import level
from viewshed_lab._page import facts
from viewshed_lab.studies.figures import compared, png_of
from viewshed_lab.studies.formatting import (
    format_interval,
    format_number,
    format_rate,
    format_rates,
    format_share,
    share_interval,
)
from viewshed_lab.studies.guarantees import attacks
from viewshed_lab.studies.guarantees.driving import CASES, CERTIFIED, LAST_S, MONITORS, STAYS_S, drive_through
from viewshed_lab.studies.guarantees.jobs import ALPHA, DELTA, TARGETS, Line, calibration_of, lines_of, retested_shares
from viewshed_lab.studies.guarantees.scenes import FRAME, GRID, SEEDS, THREATS, WITHSTOOD, default_estimator, own_scene
from viewshed_lab.studies.pages import Picture, Table, fill_template


def files_of(folder: Path) -> dict[str, bytes]:
    """Return the files by name: pictures, then the page ``guarantees.md``."""
    lines = {part: lines_of(folder, part) for part in _PARTS}
    if not any(lines.values()):
        raise ValueError(f"{folder} must hold results, got none; run without --no-run")
    retested = retested_shares(folder)
    parts: dict[str, tuple[list[Line], Callable[[list[Line]], Table | Picture | None]]] = {
        "certificates": (lines["certificates"], _certificates), "final": (lines["certificates"], _final),
        "picture": (lines["attacks"], lambda _: _picture()), "attacks": (lines["attacks"], _attacks),
        "worst": (lines["attacks"], _worst), "worst_picture": (lines["attacks"], _worst_picture),
        "adapted": (lines["adapted"], _adapted), "broken": (lines["broken"], _broken),
        "driving": (lines["driving"], _driving), "strip": (lines["driving"], _strip),
        "speeds": (lines["speeds"], _speeds), "masks": (lines["report"], partial(_masks, folder)),
        "attacked": (lines["attacked"], _attacked), "places": (lines["calibration"], lambda _: _places(folder)),
        "development": (retested, _development), "survey": (lines["survey"], _survey),
        "crossview": (lines["crossview"], _crossview), "costs": (lines["costs"], _costs),
    }  # fmt: skip
    page = fill_template(
        "guarantees/page.md", counts={part: len(of) for part, of in lines.items()}, alpha=ALPHA, delta=DELTA,
        aims=_aims(retested, lines), filled=_filled(lines["speeds"]), certified=CERTIFIED,
        drives=_drives(lines["driving"]), last_s=f"{LAST_S:g}", stays_s=f"{STAYS_S:g}",
        **{name: make(of) if of else None for name, (of, make) in parts.items()},
    )  # fmt: skip
    seeds = ", ".join(f"{name} {seed}" for name, seed in SEEDS.items())
    about = facts(
        scenes=f"preset nuscenes, frame {FRAME} of each scene, seeds: {seeds}", development="set development, road"
    )
    return page.files("guarantees.md", about)


_STATES = ListedColormap(["#b9b4c7", "#dcefff", "#4f6d8f", "#6d6875"])
"""Colors of UNKNOWN, FREE, SURFACE and HIDDEN."""

AIMED = ("far wall", "removal", "ghost wall", "weather")
"""Cases of the target, which was set before any drive; the vanishing pedestrian was added later."""

_PARTS = ("certificates", "broken", "adapted", "calibration", "report", "attacked", "costs", "attacks", "survey",
          "driving", "speeds", "crossview")  # fmt: skip


def _sum(lines: list[Line], key: str, kind: str) -> Any:
    return np.sum([line[key][kind] for line in lines], axis=0)


def _precision_recall(areas: Any) -> str:
    right, false, visible = (float(area) for area in areas)
    return format_rates(right / max(right + false, 1e-9), right / max(visible, 1e-9))


def _worst_precision(lines: list[Line], key: str) -> float:
    """Return the precision of the right cells without attack and all false cells that an attack can leave or open."""
    right, false = _sum(lines, key, "envelope")[0], _sum(lines, key, "reference")[1]
    return float(right / (right + false + sum(line[key]["gain_m2"] for line in lines)))


def _f1(areas: Any) -> float:
    right, false, visible = (float(area) for area in areas)
    return 2 * right / max(right + false + visible, 1e-9)


Aim = tuple[str, str, str, bool | None]
"""Description, target, measured figure, and whether it meets the target; None if the data cannot show it."""


def _aims(retested: list[Line], lines: dict[str, list[Line]]) -> Table | None:
    """Return the table of the targets of the study."""
    rows: list[Aim] = []
    if of := lines["certificates"]:
        not_given = "height and attitude, slope 0.01"
        areas = {words: _sum(of, f"{not_given} | {words}", "certified envelope") for words in ("added", "replaced:5")}
        rates = {words: (r / max(r + f, 1e-9), r / max(v, 1e-9)) for words, (r, f, v) in areas.items()}
        for words, minima in (("added", (0.90, 0.90)), ("replaced:5", (0.95, 0.55))):
            rows.append((
                f"certified against `{words}`, ground not given: precision / recall",
                f"≥ {format_rates(*minima)}", format_rates(*rates[words]),
                bool(np.all(np.array(rates[words]) >= minima)),
            ))  # fmt: skip
        for words, target in (("replaced:150", 0.75), ("wedge:10", 0.80)):
            worst = _worst_precision(of, f"{not_given} | {words}")
            rows.append((
                f"precision under the worst attack, `{words}`", f"≥ {format_rate(target)}", format_rate(worst),
                worst >= target,
            ))  # fmt: skip
        default = _f1(np.sum([line["default"] for line in of], axis=0))
        lost = default - _f1(_sum(of, f"{not_given} | added", "final"))
        rows.append(("F1 that the default loses inside the envelope", "≤ .010", format_rate(lost), lost <= 0.01))
    if of := lines["adapted"]:
        false_m2 = float(np.mean([line["final"][1] for line in of]))
        above = sum(line["beyond the clean envelope"] > line["bound"] for line in of)
        rows.append((
            "false area under the strongest search, default ∩ envelope", "≤ 60 m², none above its bound",
            f"{false_m2:.0f} m², {above} above", false_m2 <= 60.0 and not above,
        ))  # fmt: skip
    if of := lines["attacks"]:
        tallies = [tally for line in of for tally in line["tallies"].values()]
        tried, broken = (sum(tally[name] for tally in tallies) for name in ("tried", "violations"))
        rows.append(("attacks that break a certificate", "0 of 100000", f"{broken} of {tried}", not broken))
        pairs = [np.array(by_scene) for by_scene in _bounds(of).values()]
        ratios = [float(np.mean(p[p[:, 0] > 0, 1] / p[p[:, 0] > 0, 0])) for p in pairs if (p[:, 0] > 0).any()]
        rows.append((
            "bound / worst attack found, by threat", "≤ 3", f"{min(ratios, default=np.nan):.1f} to"
            f" {max(ratios, default=np.nan):.1f}", max(ratios, default=np.inf) <= 3.0,
        ))  # fmt: skip
    if of := lines["report"]:
        shares, recalls = np.array([(line["car"]["false_share"], line["car"]["recall"]) for line in of]).T
        beyond, recall = float((shares > ALPHA).mean()), float(recalls.mean())
        rows.append((
            "guaranteed mask, own scenes, a car: scenes with a false share above α / recall", "≤ .100 / ≥ .850",
            format_rates(beyond, recall), beyond <= 0.1 and recall >= 0.85,
        ))  # fmt: skip
    if retested:
        shares, kept = np.array([one["retested"] for one in retested]).T
        rows.append((
            "the same on other worlds, retested on 50 of them / kept of what the default rightly claims",
            "≤ .100 / ≥ .700", format_rates(float((shares > ALPHA).mean()), float(kept.mean())),
            bool((shares > ALPHA).mean() <= 0.1 and kept.mean() >= 0.7),
        ))  # fmt: skip
    if of := lines["survey"]:
        masks = [name for name in of[0] if name.startswith("guaranteed")]
        sums = [np.sum([line[name] for line in of], axis=0) for name in masks]
        off = [float(far / surveyed) for surveyed, far, _ in sums]
        rows.append((
            "surveyed ground: guaranteed cells that are off, by own calibration / retested", "≤ .010",
            format_rates(*off), max(off) <= 0.01,
        ))  # fmt: skip
    for line in lines["crossview"]:
        if "own scenes" in line["mask"] and line["over"]["columns"]:
            over, under = line["over"]["value"], line["under"]["value"]
            rows.append((
                f"guaranteed mask, real sequences, {line['sensor'].split(',')[0]}: over-claim / under-claim",
                "≤ .020 / ≤ .150", format_rates(over, under), over <= 0.02 and under <= 0.15,
            ))  # fmt: skip
    rows += _aims_of_driving(lines["driving"])
    rows += _aims_of_costs(lines["costs"])
    words_of = {True: "met", False: "missed", None: "not shown"}
    return Table(["aim", "wanted", "measured", ""], [[*row[:3], words_of[row[3]]] for row in rows]) if rows else None


def _aims_of_costs(lines: list[Line]) -> list[Aim]:
    """Return the rows of the fastest times per sweep: of the slowest certificate and of the guaranteed mask."""
    if not lines:
        return []
    costs = {name: [times[0] for times in of.values()] for name, of in lines[0].items() if name != "number"}
    masks, slowest = costs.pop("guaranteed mask"), np.max(list(costs.values()), axis=0)
    return [
        ("slowest certificate, HDL-32E / HDL-64E", "≤ 5 / ≤ 8 ms", f"{slowest[0]:.1f} / {slowest[1]:.1f} ms",
         bool((slowest <= (5.0, 8.0)).all())),
        ("guaranteed mask, HDL-32E / HDL-64E", "≤ .5 ms", f"{masks[0]:.2f} / {masks[1]:.2f} ms", max(masks) <= 0.5),
    ]  # fmt: skip


def _costs(lines: list[Line]) -> Table:
    """Return the table of times per sweep in milliseconds."""
    costs = {name: of for name, of in lines[0].items() if name != "number"}
    heads = [f"{sensor}, {points:,} points, ms" for sensor, (_, _, points) in costs["added"].items()]
    rows = [
        [name, *(f"{median:.2f} (fastest {fastest:.2f})" for fastest, median, _ in of.values())]
        for name, of in costs.items()
    ]
    return Table(["of a sweep, median of 40", *heads], rows)


def _aims_of_driving(lines: list[Line]) -> list[Aim]:
    """Return the rows of the closed loop: collisions compared with no monitor at the same junctions, travel times."""
    rows: list[Aim] = []
    known = {(line["case"], line["monitor"], line["number"]): line for line in lines}
    for monitor in MONITORS[1:]:
        pairs = [
            (line["collided"], known[case, MONITORS[0], number]["collided"])
            for (case, name, number), line in known.items()
            if name == monitor and case in AIMED and (case, MONITORS[0], number) in known
        ]
        if pairs:
            hit, alone = np.sum(pairs, axis=0)
            rows.append((
                f"collisions, far wall, removal, ghost wall, weather: {monitor}", "≤ 1/10 of no monitor's",
                f"{hit} beside {alone} in {len(pairs)} drives", bool(hit <= alone / 10) if alone else None,
            ))  # fmt: skip
        longer = _longer(lines, "none", monitor)
        if longer:
            more = 100 * float(np.mean(longer)) - 100
            rows.append((f"travel time without an attack: {monitor}", "≤ +15 %", f"{more:+.0f} %", more <= 15.0))
        elif any(line["case"] == "none" and line["monitor"] == monitor for line in lines):
            rows.append((f"travel time without an attack: {monitor}", "≤ +15 %", "never passed", False))
    return rows


def _longer(lines: list[Line], case: str, monitor: str) -> list[float]:
    """Return the ratios of travel times to those without monitor and attack, where both passed."""
    alone_s = {x["number"]: x["time_s"] for x in lines if (x["case"], x["monitor"]) == ("none", MONITORS[0])}
    both_s = [
        (x["time_s"], alone_s.get(x["number"], LAST_S)) for x in lines if (x["case"], x["monitor"]) == (case, monitor)
    ]
    return [time_s / without_s for time_s, without_s in both_s if max(time_s, without_s) < LAST_S]


def _certificates(lines: list[Line]) -> Table:
    """Return the table of the envelope's figures, by given ground and threat."""
    rows = []
    for key in (key for key in lines[0] if " | " in key):
        ground, words = key.split(" | ")
        clean = _sum(lines, key, "envelope")
        gain_m2, worst = sum(line[key]["gain_m2"] for line in lines), _worst_precision(lines, key)
        rows.append([
            ground, f"`{words}`", _precision_recall(clean), _precision_recall(_sum(lines, key, "certified envelope")),
            f"{gain_m2 / len(lines):.0f}", format_rate(worst),
        ])  # fmt: skip
    header = ["given", "threat", "envelope without attack: precision / recall", "certified part of it",
              "an attack adds at most, m²", "precision under the worst attack, at least"]  # fmt: skip
    return Table(header, rows)


def _final(lines: list[Line]) -> Table:
    """Return the table of the default's claims inside the envelope, by given ground and threat."""
    default = np.sum([line["default"] for line in lines], axis=0)
    rows = [["default alone", "", _precision_recall(default), format_rate(_f1(default)), "", ""]]
    for key in (key for key in lines[0] if " | " in key):
        ground, words = key.split(" | ")
        final, certified = _sum(lines, key, "final"), _sum(lines, key, "certified")
        if words == THREATS[0] or ground.endswith("slope 0.01"):
            change = _f1(final) - _f1(default)
            rows.append([
                ground, f"`{words}`", _precision_recall(final), f"{format_rate(_f1(final))} ({change:+.3f})",
                _precision_recall(certified),
                f"{sum(line[key]['over_claim_m2'] for line in lines) / len(lines):.0f}",
            ])  # fmt: skip
    header = ["given", "threat", "default ∩ envelope: precision / recall", "F1", "certified part: precision / recall",
              "of the claim owed to an attack at most, m²"]  # fmt: skip
    return Table(header, rows)


def _attacks(lines: list[Line]) -> Table | None:
    """Return the table of the number of attacks by threat and kind, and of those that broke a certificate."""
    tallies = pd.DataFrame([
        {"threat": key.partition(" ")[0].partition(":")[0], "how": key.split(" | ")[1], **tally}
        for line in lines for key, tally in line["tallies"].items()
    ])  # fmt: skip
    kinds, rows = (*attacks.HOW, "exhaustive"), []
    for name, group in [*tallies.groupby("threat", sort=False), ("all", tallies)]:
        counts = group.groupby("how")["tried"].sum().reindex(kinds, fill_value=0)
        rows.append(
            [name if name == "all" else f"`{name}`", *map(str, [*counts, counts.sum(), group["violations"].sum()])]
        )
    return Table(["threat", *kinds, "attacks", "violations"], rows)


def _bounds(lines: list[Line]) -> dict[str, list[tuple[float, float]]]:
    """Return by threat, for each own scene, the worst attack and the bound in m²."""
    pairs: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for line in (line for line in lines if not line["toy"]):
        tallies = pd.DataFrame(list(line["tallies"].values()), index=[key.split(" | ")[0] for key in line["tallies"]])
        for words, few in tallies.groupby(level=0, sort=False):
            pairs[words].append((few["best_m2"].max(), few["bound_m2"].iloc[0]))
    return pairs


def _worst(lines: list[Line]) -> Table | None:
    """Return the table of the bound and the worst attack by threat, over the own scenes."""
    rows = []
    for words, pairs in _bounds(lines).items():
        best, bound = np.array(pairs).T
        opened = best > 0
        ratio = float(np.mean(bound[opened] / best[opened])) if opened.any() else float("nan")
        rows.append([f"`{words}`", f"{best.mean():.1f}", f"{bound.mean():.1f}", format_number(ratio, 1)])
    header = ["threat", "worst attack found, m²", "bound, m²", "bound / worst, mean over scenes"]
    return Table(header, rows) if rows else None


def _worst_picture(lines: list[Line]) -> Picture | None:
    """Return the picture of bound and worst attack over the number of replaced beams, per scene and mean."""
    by_beams = {
        int(words[9:]): np.array(pairs) for words, pairs in _bounds(lines).items() if words.startswith("replaced:")
    }
    if not by_beams:
        return None
    figure = Figure((5.6, 3.2), dpi=90, layout="constrained")
    axis = figure.subplots()
    beams = sorted(by_beams)
    for column, (name, color) in enumerate((("worst attack found", "#c05a2b"), ("bound", "#2b5aa0"))):
        for number in range(len(by_beams[beams[0]])):
            axis.plot(beams, [by_beams[k][number, column] for k in beams], color=color, alpha=0.15, linewidth=1)
        axis.plot(beams, [by_beams[k][:, column].mean() for k in beams], "o-", color=color, label=name)
    axis.set(xscale="log", yscale="log", xlabel="replaced beams", ylabel="opened, m²", xticks=beams, xticklabels=beams)
    axis.minorticks_off()
    axis.legend(frameon=False)
    return Picture("guarantees_bound.png", png_of(figure), "Bound and worst attack found, by number of replaced beams.")


def _adapted(lines: list[Line]) -> Table:
    """Return the table of the area opened by adaptive attacks with 150 returns on beams, by victim."""
    names = {"default": "default", "final": "default ∩ envelope"}
    names |= {words: f"its certified part, `{words}`" for words in WITHSTOOD}
    rows = [
        [words, *(f"{np.mean([line[name][k] for line in lines]):.0f}" for k in (0, 1)),
         f"{max(line[name][1] for line in lines):.0f}"]
        for name, words in names.items()
    ]  # fmt: skip
    header = ["victim", "opened, m²", "of it false, m²", "false, worst scene, m²"]
    beyond, bound = (np.array([line[name] for line in lines]) for name in ("beyond the clean envelope", "bound"))
    rows.append([f"beyond the clean envelope: {beyond.mean():.0f}, bound {bound.mean():.0f},"
                 f" above its bound in {int((beyond > bound).sum())} scenes", "", "", ""])  # fmt: skip
    return Table(header, rows)


def _broken(lines: list[Line]) -> Table:
    """Return the table of figures certified against added points, by broken assumption."""
    rows = []
    for name in (name for name in lines[0] if name != "number"):
        right, false, visible, inside, outside = np.sum([line[name] for line in lines], axis=0)
        rows.append([name, _precision_recall((right, false, visible)), _precision_recall((inside, outside, visible))])
    return Table(["assumption", "certified: precision / recall", "envelope: precision / recall"], rows)


def _masks(folder: Path, lines: list[Line]) -> Table:
    """Return the table of how often the guaranteed mask breaks its guarantee on own scenes outside the calibration."""
    rows = []
    for target in TARGETS:
        calibration = calibration_of(folder, target)
        scenes = [line[target] for line in lines]
        broken, default = ([one[key] > ALPHA for one in scenes] for key in ("false_share", "default_false_share"))
        thresholds = ", ".join(
            format_rate(float(t)) for t in THRESHOLDS[calibration.levels[calibration.step(ALPHA, DELTA)]]
        )
        rows.append([
            target, thresholds, format_share(broken),
            *(format_rate(float(np.mean(values)))
              for values in (default, [one["recall"] for one in scenes], [one["of_default"] for one in scenes])),
        ])  # fmt: skip
    header = ["target", "thresholds by range band", "scenes with a false share above α", "the default alone",
              "recall of the truth", "kept of what the default rightly claims"]  # fmt: skip
    return Table(header, rows)


def _attacked(lines: list[Line]) -> Table:
    """Return the table of false shares of the guaranteed mask (car) and of the default's claim, by attack."""
    rows = []
    for attack in (name for name in lines[0] if name != "number"):
        row = [attack]
        for claim in ("guaranteed", "default"):
            right, false, _ = np.array([line[attack][claim] for line in lines]).T
            row += [format_share(false / np.maximum(right + false, 1e-9) > ALPHA),
                    format_rate(float(false.sum() / (right + false).sum()))]  # fmt: skip
        rows.append(row)
    header = ["attack", "scenes with a false share above α", "false share of the whole claim",
              "the default alone: scenes", "false share"]  # fmt: skip
    return Table(header, rows)


def _places(folder: Path) -> Table:
    """Return the table of lower bounds of visibility by bin of probability and range band, for a car."""
    seen = calibration_of(folder, "car").seen
    heads = [f"p ≥ {format_rate(float(edge))}" for edge in PLACE_EDGES]
    rows = [
        [f"{low:g} to {high:g} m", *(format_rate(lower_bound(int(k), int(n), 0.95)) for n, k in seen[band])]
        for band, (low, high) in enumerate(pairwise(BANDS_M))
    ]
    return Table(["range", *heads], rows)


def _development(lines: list[Line]) -> Table:
    """Return the table of broken guarantees on other worlds: own calibration, and retested on 50 other scenes."""
    rows = []
    masks = {
        "own": "calibration of the own scenes",
        "retested": "retested on 50 of these scenes, confidence .9",
        "expected": "retested on 50 of these scenes, confidence .5",
    }
    for name, words in masks.items():
        shares, kept = np.array([line[name] for line in lines]).T
        rows.append([words, format_share(shares > ALPHA), format_rate(float(kept.mean()))])
    default = [line["default_false_share"] > ALPHA for line in lines]
    rows.append(["the default alone", format_share(default), format_rate(1.0)])
    return Table(["mask", "scenes with a false share above α", "kept of what the default rightly claims"], rows)


def _survey(lines: list[Line]) -> Table:
    """Return the table of the shares of claimed cells that are off the surveyed ground, or behind a box."""
    rows = []
    for name in (name for name in lines[0] if name != "number"):
        surveyed, off, behind = np.sum([line[name] for line in lines], axis=0)
        shares = (format_rate(count / max(surveyed, 1), 4) for count in (off, behind))
        rows.append([name, f"{surveyed / len(lines):.0f}", *shares])
    header = ["mask", "claimed cells on surveyed ground, a sweep", "of these off by more than .3 m", "behind a box"]
    return Table(header, rows)


def _crossview(lines: list[Line]) -> Table:
    """Return the table of over-claim and under-claim on real posed sequences, by sensor and mask."""
    rows = []
    for line in lines:
        rates = [line[name] for name in ("over", "under")]
        words = [f"{format_interval(r['value'], (r['low'], r['high']))} of {r['columns']}" for r in rates]
        rows.append([line["sensor"], line["mask"], *words])
    return Table(["sensor", "mask", "over-claim", "under-claim"], rows)


def _driving(lines: list[Line]) -> Table:
    """Return the table of collisions, needless stops and travel times of the closed loop, by case and monitor."""
    rows = []
    for case in CASES:
        for monitor in MONITORS:
            of = [line for line in lines if (line["case"], line["monitor"]) == (case, monitor)]
            if not of:
                continue
            hit, passed = [line["collided"] for line in of], [x["time_s"] for x in of if x["time_s"] < LAST_S]
            longer = _longer(lines, case, monitor)
            more = f" ({100 * np.mean(longer) - 100:+.0f} %)" if longer else ""
            stood = np.array([line["needless_s"] for line in of])
            spread = f" ±{1.96 * np.std(passed, ddof=1) / np.sqrt(len(passed)):.1f}" if len(passed) > 1 else ""
            rows.append([
                case, monitor, str(len(of)), f"{sum(hit)}: {format_share(hit)}",
                f"{stood.mean():.1f} s in {int((stood > 0).sum())}", f"{sum(line['alarm_s'] > 0 for line in of)}",
                str(len(passed)), f"{np.mean(passed):.1f}{spread}{more}" if passed else "–",
            ])  # fmt: skip
    header = ["attack", "monitor", "drives", "collisions", "stood needlessly, mean", "drives with an alarm",
              "drives that passed", "time of these, s"]  # fmt: skip
    return Table(header, rows)


def _drives(lines: list[Line]) -> str:
    """Return a sentence on the number of drives per pair, and on the collision rates that they can rule out."""
    if not lines:
        return "no drives"
    counts = Counter((line["case"], line["monitor"]) for line in lines).values()
    low, high = (f"{share_interval(0, count)[1]:.0%}".replace("%", " %") for count in (max(counts), min(counts)))
    return (
        f"{min(counts)} to {max(counts)} drives a pair: without a collision they only show a rate below {low} (most"
        f" drives) or {high} (fewest)"
    )


def _speeds(lines: list[Line]) -> Table:
    """Return the table of the car's speed if only certified cells count, by threat."""
    rows = []
    for words in (name for name in lines[0] if name not in ("number", "filled")):
        speeds = np.array([line[words] for line in lines])
        rows.append([words, f"{speeds.mean():.1f}", f"{speeds.min():.1f} to {speeds.max():.1f}"])
    return Table(["what the car may count on", "speed, mean, m/s", "from, to"], rows)


def _filled(lines: list[Line]) -> str:
    """Return the share of the beams through a pedestrian's box that a pedestrian returns: mean (min to max)."""
    shares = np.array([line["filled"] for line in lines] or [np.nan])
    mean, low, high = (format_rate(float(of(shares))) for of in (np.mean, np.min, np.max))
    return f"{mean} ({low} to {high})"


def _strip(lines: list[Line]) -> Picture:
    """Return the picture of the car's estimate at some times of a drive, one row per monitor."""
    times = (2.0, 5.0, 7.0, 9.0, 11.0)
    monitors = [name for name in MONITORS if any(line["monitor"] == name for line in lines)]
    figure = Figure((12.5, 1.3 * len(monitors)), dpi=80, layout="constrained")
    axes = figure.subplots(len(monitors), len(times), squeeze=False)
    for monitor, row in zip(monitors, axes, strict=True):
        frames: list[tuple[float, float, tuple[float, float], FovEstimate]] = []
        drive = drive_through(0, "vanished", monitor, lambda *frame, to=frames: to.append(frame))
        for axis, target_s in zip(row, times, strict=True):
            axis.set(xticks=[], yticks=[])
            time_s, speed_mps, walker, estimate = min(frames, key=lambda frame: abs(frame[0] - target_s))
            half_m = estimate.grid.half_extent_m
            axis.imshow(
                estimate.state.T, cmap=_STATES, vmin=0, vmax=3, extent=(-half_m, half_m, -half_m, half_m),
                origin="lower", interpolation="nearest",
            )  # fmt: skip
            axis.set(xlim=(-5, 35), ylim=(-8, 8))
            axis.plot(0.0, 0.0, "s", color="black", markersize=5)
            axis.plot(*walker, "o", color="crimson", markersize=5)
            axis.set_title(f"{time_s:.0f} s, {speed_mps:.0f} m/s", fontsize=8)
        row[0].set_ylabel(monitor + (", hit" if drive.collided else ""), fontsize=8)
    return Picture("guarantees_driving.png", png_of(figure), "What the car believes while it drives, by monitor.")


def _picture() -> Picture:
    """Return the picture of one scene's envelope without and under attack, certified cells and opened cells."""
    scene, threat = own_scene("attacks", 1), Threat("replaced", 150)
    victim = attacks.own_victim(scene.leveled.sweep, GRID)
    clean, rng = victim.envelope, np.random.Generator(np.random.PCG64(1))
    beams = attacks.beams_within(threat, victim, rng, attacks.weights_of(clean, threat))
    sweep = victim.attacked(beams, np.full(len(beams), np.inf, np.float32), np.zeros((0, 3), np.float32))
    leveled = level(sweep, GRID)
    estimate, after = default_estimator(clean.target).estimate(leveled), victim.envelope_of(sweep)
    panels = {
        "envelope without attack": clean.claim,
        "150 beams replaced": after.claim,
        "final claim, certified against 5": certify(
            leveled, estimate, Threat("replaced", 5), victim.given
        ).certified_visible,
        "opened by the attack": after.claim & ~clean.open(),
    }
    figure = Figure((12.5, 3.4), dpi=90, layout="constrained")
    for axis, (title, claim) in zip(figure.subplots(1, len(panels)), panels.items(), strict=True):
        axis.imshow(compared(claim, scene.visible["car"], scene.known)[::-1, ::-1], interpolation="nearest")
        axis.set_title(title, fontsize=9)
        axis.set(xticks=[], yticks=[])
    alt = "Envelope without attack and under one, certified cells, cells that the attack opened."
    return Picture("guarantees.png", png_of(figure), alt)
