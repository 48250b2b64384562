"""Hooks to save and draw an estimate, so that ``fov`` needs no import of ``io`` and ``show``, the layers above it.

``viewshed/__init__.py`` sets them before any other module is imported.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from viewshed.fov.estimate import FovEstimate
    from viewshed.preprocess.leveling import LeveledSweep

save: Callable[[FovEstimate, Path], None]
"""Writes an estimate in the format of the path's suffix; raises ValueError if the suffix is unknown."""

draw: Callable[[FovEstimate, LeveledSweep | None, str, bool], bytes]
"""Returns a PNG of an estimate, its leveled sweep (or None), a title, and whether the background is dark."""
