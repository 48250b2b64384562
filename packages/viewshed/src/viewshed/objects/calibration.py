"""Fit the evidence model on benign drives: count tables on some of them, and take limits from the others."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from viewshed.arrays import F64
from viewshed.monitor.calibration import alarms_allowed
from viewshed.objects.before import FOLLOWED_AFTER, SeenBefore, surface_shares
from viewshed.objects.evidence import EvidenceCounts, EvidenceModel, birth_bins, jump_bins, view_bins
from viewshed.objects.jumps import LATEST, Sightings
from viewshed.objects.memory import rows_of
from viewshed.objects.sensor_view import Observed
from viewshed.objects.single import SingleFusion, cell_evidence

_NO_LIMITS = (np.inf, np.inf, np.inf)

_FALSE_JUMPS_M = (0.3, 3.0)
"""Lengths of the jumps of moved tracks for the tables."""

_OPEN = 0.5
"""A ghost is made only where at least this share of its box is free."""


def calibrate(drives: Sequence[Sequence[Observed]], rng: np.random.Generator, accused: float = 0.03) -> EvidenceModel:
    """Return the model fitted on benign drives.

    Tables are counted on every other drive; limits are taken from the others, so that at most the share ``accused`` of
    their confirmed tracks ever reaches one.

    Args:
        drives: observations of each drive, in order of time.
        rng: places tracks elsewhere, as examples of forged ones.
        accused: share of honest tracks.

    Raises:
        ValueError: there are fewer than two drives, or too few tracks for the share.
    """
    if len(drives) < 2:
        raise ValueError(f"drives must be two at least, some for the tables and some for the limit, got {len(drives)}")
    counts = EvidenceCounts()
    for drive in drives[::2]:
        count_drive(drive, counts, rng)
    model = model_of_counts(counts, accused)
    highest: list[F64] = []
    for drive in drives[1::2]:
        highest += highest_e_values(drive, model).values()
    return replace(model, limits=limits_of(np.array(highest).reshape(-1, 3), accused), tracks=len(highest))


def model_of_counts(counts: EvidenceCounts, accused: float) -> EvidenceModel:
    """Return a model with counted tables that accuses no track yet."""
    view, birth, jump = (counts.table(name) for name in ("view", "birth", "jump"))
    return EvidenceModel(counts.weights(), view, birth, jump, _NO_LIMITS, accused)


def limits_of(highest: F64, accused: float) -> tuple[float, float, float]:
    """Return limits that honest tracks reach with probability ``accused`` at most, equally rare for each suspicion.

    Args:
        highest: (T, 3) the largest e-values of each honest track.
        accused: probability that a new honest track reaches one of the three limits.

    Raises:
        ValueError: there are too few tracks for the share.
    """
    allowed = alarms_allowed(len(highest), accused, unit="tracks")
    ranked = np.sort(highest, axis=0)[::-1]
    for rank in range(allowed, -1, -1):
        limits = np.maximum(np.nextafter(ranked[rank], np.inf), 1.0)
        if (highest >= limits).any(axis=1).sum() <= allowed:
            break
    first, second, third = limits.tolist()
    return first, second, third


def highest_e_values(drive: Iterable[Observed], model: EvidenceModel) -> dict[int, F64]:
    """Return the largest e-values (3,) of each confirmed track of a drive, by id."""
    fusion, highest = SingleFusion(replace(model, limits=_NO_LIMITS)), dict[int, F64]()
    for tracks, detections, views in drive:
        explained = fusion.explain(tracks, detections, views)
        shown = explained.tracks
        for k in np.flatnonzero(shown.confirmed):
            number = int(shown.ids[k])
            highest[number] = np.maximum(highest.get(number, np.zeros(3)), explained.wealth[k])
    return highest


def count_drive(drive: Iterable[Observed], counts: EvidenceCounts, rng: np.random.Generator) -> None:
    """Count the evidence of the tracks of a benign drive, and of the same tracks put elsewhere.

    Elsewhere is at the same distance from the sensor in a random direction; a moved track jumps by up to 3 m.
    """
    ids, sightings = np.zeros(0, np.int64), Sightings.none(0)
    before = SeenBefore()
    for tracks, detections, views in drive:
        is_matched = tracks.detection >= 0
        boxes = detections.boxes[tracks.detection[is_matched]]
        view = views[0]
        elsewhere = _turned(boxes, view.place, rng)
        counts.add("view", view_bins(view.view.visible(boxes)), view_bins(view.view.visible(elsewhere)))
        if view.cells is not None:
            kinds = tracks.kinds[is_matched]
            counts.cells["honest"].append(cell_evidence(boxes, kinds, view)[1])
            forged_cells, forged_bins = cell_evidence(elsewhere, kinds, view)
            counts.cells["forged"].append(forged_bins)
        # Index -1, the appended row, is that of new tracks.
        sightings = sightings.joined(Sightings.none(1)).take(rows_of(tracks.ids, ids))
        ids = tracks.ids
        rows = np.flatnonzero(is_matched)
        sightings = sightings.after(rows, tracks.t_s, boxes[:, :2])
        if view.cells is not None:
            # A ghost made in the sweep stands in the open, has a surface, and moves like a track.
            honest = tracks.take(rows)
            ghosts, in_the_open = replace(honest, boxes=elsewhere), forged_cells.free >= _OPEN
            followed = np.isin((~np.isnan(sightings.times[rows])).sum(axis=1), FOLLOWED_AFTER)
            surface = surface_shares(view.cells, honest.boxes)
            births = (
                before.free_shares(honest, surface, followed),
                before.free_shares(ghosts, surface, followed & in_the_open),
            )  # fmt: skip
            counts.add("birth", birth_bins(births[0]), birth_bins(births[1]))
        length, azimuth = rng.uniform(*_FALSE_JUMPS_M, len(rows)), rng.uniform(-np.pi, np.pi, len(rows))
        detected = sightings.take(rows)
        places = detected.places.copy()
        places[:, -LATEST:] += np.stack([length * np.cos(azimuth), length * np.sin(azimuth)], axis=-1)[:, None]
        counts.add("jump", jump_bins(detected.jumps()[0]), jump_bins(Sightings(detected.times, places).jumps()[0]))
        before.add(tracks.t_s, view.cells)


def _turned(boxes: F64, place: F64, rng: np.random.Generator) -> F64:
    """Return boxes (K, 7) at the same distance from a point, in random directions and with random headings."""
    distance_m = np.hypot(*(boxes[:, :2] - place).T)
    azimuth = rng.uniform(-np.pi, np.pi, len(boxes))
    turned = boxes.copy()
    turned[:, :2] = place + np.column_stack([distance_m * np.cos(azimuth), distance_m * np.sin(azimuth)])
    turned[:, 6] = rng.uniform(-np.pi, np.pi, len(boxes))
    return turned
