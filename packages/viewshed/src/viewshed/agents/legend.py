"""Legend of tracks in viewers: a word and a color for each explanation, and for what a command center believes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from viewshed.detections import ObjectKind, moved_boxes
from viewshed.geometry import Rigid
from viewshed.objects.explained import Explanation

if TYPE_CHECKING:
    from viewshed.agents.many import CommonPicture
    from viewshed.objects.object_stream import SeenObjects


class LegendItem(NamedTuple):
    """A word, and the color (red, green, blue in [0, 1]) of its tracks."""

    word: str
    color: tuple[float, float, float]


BELIEVED, NOT_BELIEVED = len(Explanation), len(Explanation) + 1
"""Indices of a center's tracks in the legend."""

LEGEND = (
    LegendItem("seen", (0.08, 0.55, 0.16)),
    LegendItem("missed this time", (0.52, 0.66, 0.10)),
    LegendItem("hidden", (0.16, 0.38, 0.95)),
    LegendItem("left the view", (0.45, 0.45, 0.50)),
    LegendItem("too few returns", (0.05, 0.66, 0.78)),
    LegendItem("view under alarm", (0.48, 0.33, 0.20)),
    LegendItem("missing though visible", (0.90, 0.06, 0.10)),
    LegendItem("new in cells seen free", (1.00, 0.45, 0.00)),
    LegendItem("seen through", (0.90, 0.10, 0.75)),
    LegendItem("where nothing is seen", (0.50, 0.10, 0.75)),
    LegendItem("faster than physics", (0.92, 0.74, 0.00)),
    LegendItem("believed", (0.08, 0.55, 0.16)),
    LegendItem("not believed", (0.90, 0.06, 0.10)),
)
"""By :class:`Explanation`, then ``BELIEVED`` and ``NOT_BELIEVED``; cool colors are not suspicious."""


@dataclass(frozen=True, slots=True, eq=False)
class ShownTracks:
    """Tracks to draw, in one frame."""

    ids: NDArray[np.int64]  # (K,) int64
    boxes: NDArray[np.float64]  # (K, 7) columns ``viewshed.detections.BOX_COLUMNS``
    velocities: NDArray[np.float64]  # (K, 2) m/s along x and y
    existence: NDArray[np.float64]  # (K,) probability
    legend: NDArray[np.intp]  # (K,) indices in ``LEGEND``
    reasons: tuple[str, ...]  # (K,) one sentence each

    def __len__(self) -> int:
        """Return the number of tracks."""
        return len(self.ids)

    def moved(self, other_from_here: Rigid) -> ShownTracks:
        """Return the tracks in another frame with an upright z axis."""
        turn = other_from_here.rotation[:2, :2]
        return replace(self, boxes=moved_boxes(self.boxes, other_from_here), velocities=self.velocities @ turn.T)


def tracks_of_agent(seen: SeenObjects) -> ShownTracks:
    """Return the tracks of one agent to show, in their own frame."""
    explained, chosen = seen.explained, np.flatnonzero(seen.shown)
    tracks = explained.tracks
    return ShownTracks(
        tracks.ids[chosen], tracks.boxes[chosen], tracks.states[chosen, 2:], tracks.existence[chosen],
        explained.explanations[chosen].astype(np.intp), tuple(explained.reasons[k] for k in chosen),
    )  # fmt: skip


def explained_rows(seen: SeenObjects, shown: ShownTracks) -> list[dict[str, object]]:
    """Return a description of each shown track as plain values; boxes in the frame of ``shown``."""
    explained, chosen = seen.explained, np.flatnonzero(seen.shown)
    return [
        {
            "id": int(shown.ids[k]), "kind": ObjectKind(explained.tracks.kinds[n]).name,
            "explanation": LEGEND[shown.legend[k]].word, "reason": shown.reasons[k],
            "accused": bool(explained.accused[n]), "e_value": float(f"{explained.e_values[n]:.4g}"),
            "existence": round(float(shown.existence[k]), 4), "box": shown.boxes[k].round(3).tolist(),
            "velocity_mps": shown.velocities[k].round(3).tolist(),
        }
        for k, n in enumerate(chosen)
    ]  # fmt: skip


def tracks_of_center(picture: CommonPicture) -> ShownTracks:
    """Return the confirmed or believed joint tracks of a center, in the world."""
    tracks, chosen = picture.tracks, np.flatnonzero(picture.tracks.confirmed | picture.believed)
    names = np.array(picture.agents)
    reported = [", ".join(names[picture.reporters[k]]) for k in chosen]
    return ShownTracks(
        tracks.ids[chosen], tracks.boxes[chosen], tracks.states[chosen, 2:], picture.existence[chosen],
        np.where(picture.believed[chosen], BELIEVED, NOT_BELIEVED),
        tuple(f"reported by {who}" if who else "reported by nobody now" for who in reported),
    )  # fmt: skip
