"""Write a recording's estimates for the Rerun viewer: points, states, suspect sectors and numbers over time."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed._extras import needed_for
from viewshed._files import draft_folder, require_parent
from viewshed.agents.legend import LEGEND
from viewshed.fov.estimate import CellState
from viewshed.monitor.report import sector_corners
from viewshed.objects.explained import Explanation
from viewshed.show.plot import COLORS, HEIGHTS_M, WORDS, color_map
from viewshed.show.view.frames import Frame

_VISIBLE_COLOR, _SUSPECT_COLOR, _DETECTION_COLOR = (30, 180, 130), (220, 40, 40), (150, 150, 150)
_SUSPICIOUS = range(Explanation.MISSING, len(Explanation))
_HEIGHT_MAP = "viridis"


def write_rerun(path: str | Path, frames: Iterable[Frame], title: str) -> int:
    """Write all frames to a Rerun file (``.rrd``) and return its size in bytes.

    Args:
        path: of the file.
        frames: consumed one by one; each is written before the next is taken.
        title: of the recording.

    Raises:
        ValueError: there are no frames.
        ImportError: rerun-sdk is not installed.
        OSError: the file cannot be written. No partial file remains, also if ``frames`` raises.
    """
    with needed_for("writing for Rerun"):
        import rerun
    target = Path(path)
    require_parent(target)
    with draft_folder(target) as folder:
        draft = folder / target.name
        draft.touch(exist_ok=False)  # raises Python's own error if the file cannot be created
        _write_frames(rerun, draft, frames, title)
        os.replace(draft, target)  # noqa: PTH105 - as open_atomic does
    return target.stat().st_size


def _write_frames(rerun: Any, path: Path, frames: Iterable[Frame], title: str) -> None:
    """Write all frames to a file."""
    stream, count, has_trust = rerun.RecordingStream("viewshed"), 0, False
    try:
        stream.save(path)
        stream.send_recording_name(title)
        stream.log("sweep/states", _state_colors(rerun), static=True)
        stream.log("level/tracks", _track_colors(rerun), static=True)
        for frame in frames:
            stream.set_time("sweep", sequence=count)
            if frame.estimate.t_ns is not None:
                stream.set_time("time", duration=np.timedelta64(frame.estimate.t_ns, "ns"))
            _log_frame(rerun, stream, frame)
            count, has_trust = count + 1, has_trust or bool(frame.trust)
        if not count:
            raise ValueError(f"frames must be at least one, got none; no file {path.name} was written")
        stream.send_blueprint(_views(has_trust=has_trust))
        stream.flush()
    finally:
        stream.disconnect()


def _state_colors(rerun: Any) -> Any:
    return rerun.AnnotationContext(
        [(int(state), WORDS[state], tuple(round(255 * part) for part in COLORS[state])) for state in CellState]
    )


def _track_colors(rerun: Any) -> Any:
    return rerun.AnnotationContext(
        [(at, item.word, tuple(round(255 * part) for part in item.color)) for at, item in enumerate(LEGEND)]
    )


def _views(*, has_trust: bool) -> Any:
    """Return the layout of views; states and probability are separate, because one would cover the other."""
    from rerun import blueprint

    images = [blueprint.Spatial2DView(origin=f"sweep/{name}", name=name) for name in ("states", "probability")]
    curves = ("numbers", "trust") if has_trust else ("numbers",)
    numbers = [*(blueprint.TimeSeriesView(origin=name) for name in curves), blueprint.TextLogView(origin="alarms")]
    level = blueprint.Spatial3DView(origin="level")
    columns = blueprint.Horizontal(level, blueprint.Vertical(*images), blueprint.Vertical(*numbers))
    return blueprint.Blueprint(columns, collapse_panels=True)


def _log_frame(rerun: Any, stream: Any, frame: Frame) -> None:
    """Log a frame; entities that it lacks clear those of the last frame."""
    estimate, report = frame.estimate, frame.report
    # 1. Bird's-eye images: the first row is farthest ahead, the first column leftmost.
    stream.log("sweep/states/image", rerun.SegmentationImage(estimate.state[::-1, ::-1]))
    stream.log("sweep/probability", rerun.DepthImage(estimate.visible_prob[::-1, ::-1], depth_range=(0.0, 1.0)))
    # 2. Points in the level frame, colored by their height above the ground.
    if frame.leveled is not None:
        low_m, high_m = HEIGHTS_M
        share = ((frame.leveled.height_m - low_m) / (high_m - low_m)).clip(0.0, 1.0)
        palette = color_map(_HEIGHT_MAP)
        colors = palette[(share * (len(palette) - 1)).round().astype(np.intp)]
        stream.log("level/points", rerun.Points3D(frame.leveled.points, colors=colors, radii=0.06))
    # 3. Edge of the view, and suspect sectors.
    rings = [np.asarray(ring.coords) for part in estimate.polygon().geoms for ring in (part.exterior, *part.interiors)]
    stream.log("level/visible", _strips(rerun, rings, _VISIBLE_COLOR))
    corners = np.empty((0, 2)) if report is None else sector_corners(report.suspect, estimate.grid.half_extent_m)
    fans = list(corners.reshape(-1, 3, 2)[:, [0, 1, 2, 0]])
    stream.log("level/suspect", _strips(rerun, fans, _SUSPECT_COLOR))
    # 4. Detections, and tracks in the colors of their explanations.
    if frame.detections is not None:
        boxes = _boxes(rerun, frame.detections.boxes, colors=[_DETECTION_COLOR])
        stream.log("level/detections", boxes)
    if frame.tracks is not None:
        tracks = frame.tracks
        labels = [
            f"{number} {LEGEND[at].word}"
            for number, at in zip(tracks.ids.tolist(), tracks.legend.tolist(), strict=True)
        ]
        stream.log("level/tracks", _boxes(rerun, tracks.boxes, class_ids=tracks.legend, labels=labels))
        against = [reason for at, reason in zip(tracks.legend, tracks.reasons, strict=True) if at in _SUSPICIOUS]
        for reason in against:
            stream.log("alarms", rerun.TextLog(f"{frame.name}: {reason}", level="WARN"))
    for agent in frame.trust:
        stream.log(["trust", agent.agent], rerun.Scalars(agent.trust))
    for lie in frame.lies:
        stream.log("alarms", rerun.TextLog(f"{frame.name}: {lie}", level="ERROR"))
    # 5. Numbers and sentences.
    stream.log("numbers/visible_m2", rerun.Scalars(estimate.area_m2()))
    if report is not None:
        stream.log("numbers/score", rerun.Scalars(report.score))
        level = "ERROR" if report.inconsistent else "WARN" if report.degraded else ""
        for reason in report.reasons if level else ():
            stream.log("alarms", rerun.TextLog(f"{frame.name}: {reason}", level=level))


def _boxes(rerun: Any, boxes: NDArray[np.float64], **style: Any) -> Any:
    """Return boxes (K, 7) as wireframe boxes; ``style`` is passed to Rerun."""
    half = boxes[:, 6] / 2
    turns = np.column_stack([np.zeros((len(boxes), 2)), np.sin(half), np.cos(half)])
    return rerun.Boxes3D(centers=boxes[:, :3], half_sizes=boxes[:, 3:6] / 2, quaternions=turns, radii=0.06, **style)


def _strips(rerun: Any, rings: list[Any], color: tuple[int, int, int]) -> Any:
    """Return rings (V, 2) as lines on the ground."""
    return rerun.LineStrips3D([np.column_stack([ring, np.full(len(ring), 0.05)]) for ring in rings], colors=[color])
