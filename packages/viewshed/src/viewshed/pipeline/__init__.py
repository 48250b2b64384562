"""Real-time pipeline: takes sweeps, returns estimates with integrity reports and reactions."""

from __future__ import annotations

from viewshed.pipeline.agent import Agent, Answer
from viewshed.pipeline.inbox import RateLimit
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
from viewshed.pipeline.stream import Pipeline, Statistics

__all__ = [
    "Agent", "Answer", "Caution", "Finding", "Pipeline", "RateLimit", "ReactionRules", "ReactionState", "Statistics",
    "Vehicle", "prepare_process", "react", "speed_for_view", "withdraw",
]  # fmt: skip
