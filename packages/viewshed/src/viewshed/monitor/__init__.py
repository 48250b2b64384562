"""④ Integrity: monitors that say when an estimate is to be doubted."""

from __future__ import annotations

from viewshed.monitor.deviation import DeviationMonitor, Rule, load_monitor, save_monitor
from viewshed.monitor.report import IntegrityReport
from viewshed.monitor.stream_monitor import StreamMonitor
from viewshed.monitor.sweep_monitor import SweepMonitor, load_sweep_monitor, save_sweep_monitor

__all__ = [
    "DeviationMonitor",
    "IntegrityReport",
    "Rule",
    "StreamMonitor",
    "SweepMonitor",
    "load_monitor",
    "load_sweep_monitor",
    "save_monitor",
    "save_sweep_monitor",
]
