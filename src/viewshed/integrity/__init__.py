"""④ Integrity: monitors that say when an estimate is to be doubted."""

from __future__ import annotations

from viewshed.integrity.deviation import DeviationMonitor, Rule, load_monitor, save_monitor
from viewshed.integrity.report import IntegrityReport

__all__ = ["DeviationMonitor", "IntegrityReport", "Rule", "load_monitor", "save_monitor"]
