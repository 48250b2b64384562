"""⑤ Pipeline: sweeps in, estimates with their reports and reactions out, in real time."""

from __future__ import annotations

from viewshed.pipeline.reactions import (
    Caution,
    Finding,
    ReactionRules,
    ReactionState,
    Vehicle,
    react,
    speed_for_view,
    withdraw,
)
from viewshed.pipeline.stream import SWITCH_INTERVAL_S, Answer, Pipeline, Statistics

__all__ = [
    "SWITCH_INTERVAL_S", "Answer", "Caution", "Finding", "Pipeline", "ReactionRules", "ReactionState", "Statistics",
    "Vehicle", "react", "speed_for_view", "withdraw",
]  # fmt: skip
