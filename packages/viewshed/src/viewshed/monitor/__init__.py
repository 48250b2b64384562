"""Monitors that raise alarms on streams and estimates that may have been attacked or degraded."""

from __future__ import annotations

from viewshed.monitor.calibration import Calibration, load_calibration, save_calibration, shipped_calibration
from viewshed.monitor.deviation import DeviationMonitor, Rule, load_monitor, save_monitor
from viewshed.monitor.report import IntegrityReport
from viewshed.monitor.stream_monitor import StreamMonitor

__all__ = [
    "Calibration",
    "DeviationMonitor",
    "IntegrityReport",
    "Rule",
    "StreamMonitor",
    "load_calibration",
    "load_monitor",
    "save_calibration",
    "save_monitor",
    "shipped_calibration",
]
