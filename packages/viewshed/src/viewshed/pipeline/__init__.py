"""⑤ Pipeline: sweeps in, estimates with their reports and reactions out, in real time."""

from __future__ import annotations

from viewshed.pipeline.clocks import RateLimit
from viewshed.pipeline.process import prepare_process
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
from viewshed.pipeline.stream import Answer, Pipeline, Statistics

__all__ = [
    "Answer", "Caution", "Finding", "Pipeline", "RateLimit", "ReactionRules", "ReactionState", "Statistics", "Vehicle",
    "prepare_process", "react", "speed_for_view", "withdraw",
]  # fmt: skip
