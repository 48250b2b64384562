"""The monitor in the box: calibrated on simulated drives, one file for all sensors that were simulated.

``tools/ship_monitor.py`` writes it from a study (``viewshed study monitor``).
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from viewshed.integrity.sweep_monitor import SweepMonitor, load_sweep_monitor

FILE = Path(__file__).with_name("simulated.npz")


@lru_cache(maxsize=1)
def shipped_monitor() -> SweepMonitor:
    """Return the monitor in the box.

    Raises:
        OSError: this installation has none.
        ValueError: its file is damaged, or of another version.
    """
    return load_sweep_monitor(FILE)
