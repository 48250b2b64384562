"""What writes and draws an estimate: formats and pictures know the field of view, which knows these names alone.

``viewshed`` itself fills them in, before any of its modules is imported.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from viewshed.fov.estimate import FovEstimate
    from viewshed.preprocess.leveling import LeveledSweep

save: Callable[[FovEstimate, Path], None]
"""Writes an estimate in the format of the path's suffix; raises ValueError where there is none."""

draw: Callable[[FovEstimate, LeveledSweep | None, str, bool], bytes]
"""Returns a PNG of an estimate, with the sweep that it was made from or without, its heading, on a dark page or not."""
