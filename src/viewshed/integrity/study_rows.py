"""What a study of a monitor found, from lines by sweep to one row of plain numbers for each case."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from viewshed.integrity.roc import auroc, auroc_interval, tpr_at_fpr

REGIONS = ("touched", "wedge", "changed")
"""Where suspect cells should lie: cells with a return that was added or removed; cells whose azimuth the attacker
reaches; cells that the estimate calls visible on only one of the clean and the spoilt sweep."""
FALSE_ALARM_RATE = 0.01
_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class Located:
    """How well suspect cells fit a region, counted over all sweeps that have one.

    Attributes:
        cells: watched cells of the region.
        suspects: suspect cells.
        both: suspect cells of the region.
        watched: watched cells.
    """

    cells: int
    suspects: int
    both: int
    watched: int

    @property
    def precision(self) -> float:
        """Share of the suspect cells that lie in the region; NaN without suspects."""
        return self.both / self.suspects if self.suspects else float("nan")

    @property
    def recall(self) -> float:
        """Share of the region that is suspect; NaN without a region."""
        return self.both / self.cells if self.cells else float("nan")

    @property
    def chance(self) -> float:
        """Share of the watched cells that lie in the region: the precision of guessing; NaN without cells."""
        return self.cells / self.watched if self.watched else float("nan")


@dataclass(frozen=True, slots=True)
class Row:
    """One case over all sweeps; ``dataclasses.asdict`` makes it plain.

    Attributes:
        kind: benign, attack or corruption.
        name: of the attack or corruption.
        frames: sweeps that it was done to.
        refused: sweeps that it could not be done to.
        idle: frames on which the attack added and removed no return: nothing to see, yet counted as missed.
        alarms: share of the frames that alarm at the calibrated limit.
        auroc: P(score > that of a benign sweep), ties half; NaN for benign sweeps themselves.
        auroc_low: lower end of its 95 % interval over samples.
        auroc_high: upper end.
        caught: share of the frames above a limit that at most 1 % of these benign frames pass (with fewer than 100
            frames: that none of them passes); NaN for benign sweeps themselves.
        auroc_mean: AUROC of the plain mean deviation over the watched cells, for comparison; NaN likewise.
        located: by region of ``REGIONS``, where the case has one.
    """

    kind: str
    name: str
    frames: int
    refused: int
    idle: int
    alarms: float
    auroc: float
    auroc_low: float
    auroc_high: float
    caught: float
    auroc_mean: float
    located: dict[str, Located]


def rows_of(lines: Iterable[dict[str, Any]], seed: int = 0) -> list[Row]:
    """Return one row for each case of the lines, in their order; the order of the lines changes nothing.

    Args:
        lines: what ``watched`` returned of each sweep.
        seed: of the intervals.

    Raises:
        ValueError: there are no lines, or two are of one sweep.
    """
    ordered = sorted(lines, key=lambda line: int(line["number"]))
    if not ordered or len({line["number"] for line in ordered}) < len(ordered):
        raise ValueError(f"lines must be one for each sweep, got {[line['number'] for line in ordered]}")
    return [_row(ordered, place, seed) for place in range(len(ordered[0]["cases"]))]


def _row(lines: Sequence[dict[str, Any]], place: int, seed: int) -> Row:
    kind, name = (lines[0]["cases"][place][key] for key in ("kind", "name"))
    done = [(line["cases"][0], line["cases"][place], line["watched"]) for line in lines]
    done = [each for each in done if "refused" not in each[1]]
    alarms = float(np.mean([case["alarm"] for _, case, _ in done])) if done else _NAN
    told = _told([benign for benign, _, _ in done], [case for _, case, _ in done], seed, name)
    located = {region: found for region in REGIONS if (found := _located(done, region)) is not None}
    idle = sum(case.get("returns") == 0 for _, case, _ in done)
    return Row(kind, name, len(done), len(lines) - len(done), idle, alarms, *told, located)


def _told(benign: list[Any], spoilt: list[Any], seed: int, name: str) -> tuple[float, float, float, float, float]:
    """Return AUROC, its interval, the share caught, and the AUROC of the mean deviation; NaN for benign."""
    if not name or not spoilt:
        return (_NAN, _NAN, _NAN, _NAN, _NAN)
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, zlib.crc32(name.encode())])))
    calm, doubtful = ([case["score"] for case in cases] for cases in (benign, spoilt))
    low, high = auroc_interval(calm, doubtful, rng, paired=True)
    mean = auroc([case["mean_std"] for case in benign], [case["mean_std"] for case in spoilt])
    return auroc(calm, doubtful), low, high, tpr_at_fpr(calm, doubtful, FALSE_ALARM_RATE), mean


def _located(done: Sequence[tuple[Any, Any, int]], region: str) -> Located | None:
    having = [(case, watched) for _, case, watched in done if region in case["regions"]]
    if not having:
        return None
    cells, both = (sum(case["regions"][region][k] for case, _ in having) for k in (0, 1))
    return Located(cells, sum(case["suspects"] for case, _ in having), both, sum(watched for _, watched in having))
