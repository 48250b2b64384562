"""④ Integrity: monitors that say when an estimate is to be doubted."""

from __future__ import annotations

from viewshed.integrity.monitor import DeviationMonitor, IntegrityReport, Rule, load_monitor, save_monitor

__all__ = ["DeviationMonitor", "IntegrityReport", "Rule", "load_monitor", "save_monitor"]
