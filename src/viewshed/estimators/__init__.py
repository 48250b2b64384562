"""The estimators by name: ``ESTIMATORS[name](grid)`` makes one with sound parameters."""
from __future__ import annotations
from collections.abc import Callable
from viewshed.bev import BevGrid
from viewshed.estimate import FovEstimator

ESTIMATORS: dict[str, Callable[[BevGrid], FovEstimator]] = {}
