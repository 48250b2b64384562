"""Draw a costmap with and without clearing by visibility: ``ros/python.sh ros/measure/costmap_picture.py PICTURE``.

Draws the case of ``test/test_costmap.py`` side by side, and prints its cell counts as JSON.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "viewshed_ros" / "test"))
from test_costmap import BEAMS, GRID, cleared, ranges_at, truth

IGNORED, KEPT, RIGHT, WRONG, WALL = (255, 255, 255), (205, 205, 205), (120, 190, 140), (210, 50, 40), (0, 0, 0)
"""Cells beyond the range or cut by a shadow's edge; still marked; rightly cleared; wrongly cleared; walls."""

SCALE, GAP = 3, 12
"""Pixels per cell side, and between the pictures."""


def main() -> None:
    """Draw the picture and print the counts."""
    seen, hidden = truth()
    without, with_view = cleared(with_view=False), cleared(with_view=True)
    panels = [_drawn(seen, hidden, is_cleared) for is_cleared in (without, with_view)]
    gap = np.full((panels[0].shape[0], GAP, 3), 255, np.uint8)
    Image.fromarray(np.hstack([panels[0], gap, panels[1]])).save(sys.argv[1], optimize=True)
    print(json.dumps({
        "hidden": int(hidden.sum()), "wrong_without": int((without & hidden).sum()),
        "wrong_with": int((with_view & hidden).sum()), "seen": int(seen.sum()),
        "right_without": int((without & seen).sum()), "right_with": int((with_view & seen).sum()),
    }))  # fmt: skip


def _drawn(
    seen: NDArray[np.bool_], hidden: NDArray[np.bool_], is_cleared: NDArray[np.bool_]
) -> NDArray[np.uint8]:  # fmt: skip
    """Return pixels (H, W, 3): x up, y left."""
    pixels = np.full((*GRID.shape, 3), IGNORED, np.uint8)
    pixels[hidden | seen] = KEPT
    pixels[seen & is_cleared] = RIGHT
    pixels[hidden & is_cleared] = WRONG
    angle = -np.pi + 2 * np.pi / BEAMS * np.arange(BEAMS)
    range_m = ranges_at(angle)
    range_m = np.where(np.isfinite(range_m), range_m, 1e9)
    walls, inside = GRID.index((np.stack([np.cos(angle), np.sin(angle)]) * range_m).T)
    pixels[walls[inside, 0], walls[inside, 1]] = WALL
    return np.kron(pixels[::-1, ::-1], np.ones((SCALE, SCALE, 1), np.uint8))


if __name__ == "__main__":
    main()
