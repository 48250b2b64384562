"""Diagnostics of the node and alarms of its sensors, as text for an operator."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from threading import Lock

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from viewshed.pipeline import Answer, Caution, Statistics
from viewshed_ros.stops import Stale, stale_alarm

MAX_REASONS = 20
"""Maximum number of distinct reasons counted separately for a sensor; further ones are counted together."""

OTHER_REASONS = "for other reasons"


@dataclass(slots=True)
class SensorCounts:
    """Counts of one sensor's messages by outcome; thread-safe."""

    received: int = 0
    skipped: int = 0
    answered: int = 0
    reasons: Counter[str] = field(default_factory=Counter)
    last_note: str = ""
    _answered_before: int = 0
    _lock: Lock = field(default_factory=Lock, repr=False)

    def count(self, reason: str) -> None:
        """Count a problem by its reason."""
        with self._lock:
            known = reason in self.reasons or len(self.reasons) < MAX_REASONS
            self.reasons[reason if known else OTHER_REASONS] += 1

    def status(self, name: str, passed_s: float, facts: Mapping[str, object]) -> DiagnosticStatus:
        """Return the status over the ``passed_s`` since the last call, with additional facts."""
        with self._lock:
            reasons = dict(self.reasons)
        rate_hz = (self.answered - self._answered_before) / max(passed_s, 1e-3)
        self._answered_before = self.answered
        level, message = DiagnosticStatus.OK, f"{rate_hz:.1f} Hz"
        if not rate_hz:
            level, message = DiagnosticStatus.STALE, "no field of view"
        elif reasons:
            level, message = (
                DiagnosticStatus.WARN,
                f"{rate_hz:.1f} Hz, {sum(reasons.values())} problems",
            )
        values = {
            "rate in Hz": f"{rate_hz:.1f}", "messages": self.received, "beyond the rate": self.skipped,
            "answered": self.answered, "last note": self.last_note, **facts, **reasons,
        }  # fmt: skip
        return DiagnosticStatus(level=level, name=name, message=message, values=key_values(values))


def key_values(values: Mapping[str, object]) -> list[KeyValue]:
    """Return a mapping as key-value pairs of a status."""
    return [KeyValue(key=key, value=str(value)) for key, value in values.items()]


def pipeline_status(name: str, statistics: Statistics, facts: Mapping[str, str]) -> DiagnosticStatus:
    """Return the status of the pipeline: latencies, drops, refusals by reason, processor load."""
    values: dict[str, object] = {
        **facts, "latency": statistics.latencies, "answered": statistics.answered, "dropped": statistics.dropped,
        "cores busy": f"{statistics.busy_cores:.2f}",
    }  # fmt: skip
    values |= {f"refused: {reason}": count for reason, count in statistics.refused.items()}
    values |= {f"not published: {reason}": count for reason, count in statistics.unpublished.items()}
    level = DiagnosticStatus.WARN if statistics.refused or statistics.unpublished else DiagnosticStatus.OK
    return DiagnosticStatus(level=level, name=name, message=statistics.line(), values=key_values(values))


def alarm(name: str, answer: Answer, stale: Stale | None = None) -> DiagnosticStatus:
    """Return the alarm of one answer: caution, speed, and reasons."""
    caution = answer.reaction.caution
    values: dict[str, object] = {
        "caution": caution.name, "speed in m/s": f"{answer.speed_mps:.2f}",
        "latency in ms": f"{1e3 * answer.latency_s:.1f}",
    }  # fmt: skip
    if answer.report is not None:
        now = answer.report.now
        values |= {
            "inconsistent": now.inconsistent, "degraded": now.degraded, "stream alarm": answer.report.alarm,
            "score": f"{now.score:.3f}", "suspect sectors": int(now.suspect.sum()),
        }  # fmt: skip
        if not math.isnan(now.p_value):
            values["p-value"] = f"{now.p_value:.4f}"
        values |= {f"reason {number}": reason for number, reason in enumerate(now.reasons, 1)}
    values |= {f"note {number}": note for number, note in enumerate(answer.notes, 1)}
    if stale is not None:
        values |= {"refused": answer.refused} if answer.refused else {}
        return stale_alarm(name, stale, key_values(values))
    if answer.refused:
        level, message = DiagnosticStatus.ERROR, answer.refused
    elif caution >= Caution.WIDEN:
        level, message = DiagnosticStatus.ERROR, "what is impossible is not claimed"
    elif caution == Caution.ASK:
        level, message = DiagnosticStatus.WARN, "the view is worse than usual"
    else:
        level, message = DiagnosticStatus.OK, "the view is trusted"
    return DiagnosticStatus(level=level, name=name, message=message, values=key_values(values))
