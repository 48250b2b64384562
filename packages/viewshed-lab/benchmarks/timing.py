"""Medians over interleaved repeats: every round runs each candidate once, in a new random order."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

Job = Callable[[], object]
Clock = Callable[[], int]
MIN_REPEATS, MAX_REPEATS = 7, 301


@dataclass(frozen=True, slots=True)
class Timing:
    """Milliseconds of one candidate: median, 10th and 90th percentile; and its number of runs."""

    median_ms: float
    low_ms: float
    high_ms: float
    repeats: int


def interleaved(
    jobs: Mapping[str, Job], rng: np.random.Generator, budget_s: float = 2.0, clock: Clock = time.perf_counter_ns
) -> dict[str, Timing]:
    """Return the timing of each job by name; all share the rounds, so that a disturbance affects all."""
    return {name: summary(times) for name, times in times_of(jobs, rng, budget_s, clock).items()}


def times_of(
    jobs: Mapping[str, Job], rng: np.random.Generator, budget_s: float = 2.0, clock: Clock = time.perf_counter_ns
) -> dict[str, list[float]]:
    """Return the milliseconds of each run of each job by name, from rounds in which each job runs once.

    ``clock`` returns nanoseconds; ``time.thread_time_ns`` excludes the time of other processes.
    """
    for job in jobs.values():  # warm-up: compiles, and fills caches
        job()
    once_s = sum(_elapsed_ms(job, clock) for job in jobs.values()) / 1e3
    repeats = int(np.clip(budget_s / max(once_s, 1e-6), MIN_REPEATS, MAX_REPEATS))
    names = list(jobs)
    times_ms: dict[str, list[float]] = {name: [] for name in names}
    for _ in range(repeats):
        for pick in rng.permutation(len(names)):
            times_ms[names[pick]].append(_elapsed_ms(jobs[names[pick]], clock))
    return times_ms


def summary(times_ms: list[float]) -> Timing:
    """Return the median and the 10th and 90th percentile of times in milliseconds."""
    low, median, high = np.percentile(times_ms, [10, 50, 90])
    return Timing(float(median), float(low), float(high), len(times_ms))


def bandwidth_bytes_per_s() -> float:
    """Return the bytes per second that one thread reads and writes when copying 256 MB, the best of seven runs."""
    source = np.ones(256 * 1_000_000 // 8)
    target = np.empty_like(source)
    np.copyto(target, source)
    best_ms = min(_elapsed_ms(lambda: np.copyto(target, source)) for _ in range(7))
    return 2 * source.nbytes / (best_ms / 1e3)


def _elapsed_ms(job: Job, clock: Clock = time.perf_counter_ns) -> float:
    start = clock()
    job()
    return (clock() - start) / 1e6
