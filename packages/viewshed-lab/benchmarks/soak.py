"""Hours of work in little: ``python -m benchmarks.soak [--minutes 30]``, or ``make soak``.

Sweeps come as fast as they are taken; one in a hundred is malformed, clocks repeat, go back and jump, bursts make the
pipeline drop, and everything is restarted again and again. First through ``viewshed.pipeline``, then through the ROS 2
node where ``ros/python.sh`` finds or makes its environment. Writes docs/results/soak.md; exits with 1 where a sweep is
not accounted for, where memory grows or where anything crashes.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.damage import DAMAGES, Cloud, cloud_of
from viewshed.estimators import load_estimator
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.grid import BevGrid
from viewshed.io import read_sweep
from viewshed.io.messages.pointcloud2 import sweep_of_cloud
from viewshed.io.samples import junction_path
from viewshed.monitor import StreamMonitor
from viewshed.pipeline import Answer, Pipeline, prepare_process
from viewshed.pipeline.latency import Latencies
from viewshed.sweep import Sweep
from viewshed_lab._page import facts, page, table
from viewshed_lab._results import write_page

ROOT = Path(__file__).resolve().parents[3]
PAGE = ROOT / "docs" / "results" / "soak.md"
SEED = 20_261_123
STEP_NS = 100_000_000

MALFORMED_SHARE = 0.01
CLOCK_SHARE = 0.004
BURST_SHARE = 0.002
BURST = 6
"""Number of sweeps in a burst."""

UNDER_WAY = 3
LINES = 30
"""Number of lines of the log, for any duration."""

RESTARTS, MIN_S = 20, 10.0
"""Number of restarts, and minimum time between two of them."""

WARM_SHARE, GROWTH = 0.2, 0.05
"""Share of the time for warm-up, and maximum relative growth of memory after it."""

CLOCKS = {
    "time repeats": (0, "a sweep must have another time"),
    "time goes back by 5 s": (-50 * STEP_NS, "time went back"),
    "time jumps by 60 s": (600 * STEP_NS, "time jumped"),
}
"""Clock errors: step in nanoseconds, and text of the refusal or note."""


@dataclass(slots=True)
class Kind:
    """Counts of the sweeps of one kind."""

    sent: int = 0  # sweeps put in
    answered: int = 0  # sweeps with an estimate
    refused: int = 0  # sweeps refused with a reason
    dropped: int = 0  # sweeps replaced by a newer one, or lost at a restart
    reasons: Counter[str] = field(default_factory=Counter)  # number of each refusal and note


@dataclass(slots=True)
class Soaked:
    """Result of a soak test."""

    seconds: float = 0.0  # duration
    restarts: int = 0  # number of restarts
    kinds: dict[str, Kind] = field(default_factory=dict)  # by kind of sweep
    # lines: seconds, sent, answered, dropped, refused, median and 99 % latency in ms, memory in MB
    log: list[list[float]] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)  # failed checks; empty if the soak is passed


def main() -> None:
    """Soak, print and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0, help="of each of the two soaks")
    parser.add_argument("--page", type=Path, default=PAGE, help="where the Markdown goes")
    chosen = parser.parse_args()
    prepare_process()
    pipeline = soak_pipeline(60.0 * chosen.minutes, np.random.default_rng(SEED))
    node = _soak_node(60.0 * chosen.minutes)
    parts = ["## Through `viewshed.pipeline`", *_section(pipeline)]
    parts += ["## Through the ROS 2 node"]
    parts += (
        ["Not done: its environment could not be made (`ros/python.sh` says why)."] if node is None else _section(node)
    )
    content = page(
        "Soak",
        facts(
            command=f"`python -m benchmarks.soak --minutes {chosen.minutes:g}`",
            sweeps="the embedded junction: HDL-32E, 32,731 returns",
            seed=str(SEED), load=f"{os.getloadavg()[0]:.1f} in the minute before the end, on all cores",
        ),
        _INTRO, *parts, _COLUMNS,
    )  # fmt: skip
    write_page(chosen.page, content)
    print(content)
    if pipeline.faults or (node is not None and node.faults):
        sys.exit(1)


_INTRO = f"""Sweeps are put in as fast as they are answered, {UNDER_WAY} under way at once; of all
{MALFORMED_SHARE:.0%} are malformed, {CLOCK_SHARE:.1%} come with a clock that repeats, goes back or jumps, and
{BURST_SHARE:.1%} as a burst of {BURST} at once, of which some must be dropped. Everything is ended and begun anew
{RESTARTS} times, evenly spread (not sooner than after {MIN_S:g} s). A soak is passed where each sweep is
accounted for, where no good sweep is refused and none answered that contradicts itself, where each reason is the
one expected, where nothing crashes, and where memory after the first {WARM_SHARE:.0%} of the time stays within
{GROWTH:.0%} of what it was there."""

_COLUMNS = """## How to read the log

- **s**: since the beginning. **sent**, **answered**, **dropped**, **refused**: until then, over all restarts.
- **dropped** sweeps were replaced by newer ones of the same sensor before their turn (bursts), or were on their way
  when everything was ended. Through ROS the messages that the best-effort profile lost before the node received
  them count as dropped as well.
- **refused** sweeps are the malformed ones and those whose time repeats: nothing else may be.
- **median** and **99 %**: latency since the line before, in milliseconds, from putting a sweep in to its answer,
  its time in the inbox included.
- **MB**: resident memory of the process. The node is a new process at every seventh restart; memory must not grow
  within a process, measured before each restart."""


@dataclass(slots=True)
class Script:
    """Random sequence of sweeps to send: kind and time of each."""

    rng: np.random.Generator  # draws kinds of errors
    t_ns: int = 10**15  # of the last sweep
    _left_of_burst: int = 0
    _last: str = "no points"

    def next(self) -> tuple[str, int, bool]:
        """Return the next sweep's kind and time in nanoseconds, and whether another follows at once."""
        drawn, kind = self.rng.random(), "good"
        if self._left_of_burst:
            self._left_of_burst -= 1
        elif drawn < MALFORMED_SHARE:
            kind = str(self.rng.choice(list(DAMAGES)))
        elif drawn < MALFORMED_SHARE + CLOCK_SHARE and self._last == "good":
            # A repeated time must repeat that of an accepted sweep: not after a malformed one or a burst.
            kind = str(self.rng.choice(list(CLOCKS)))
        elif drawn > 1.0 - BURST_SHARE:
            self._left_of_burst = BURST - 1
        self.t_ns += CLOCKS[kind][0] if kind in CLOCKS else STEP_NS
        self._last = kind if not self._left_of_burst else "burst"
        return kind, self.t_ns, self._left_of_burst > 0


def soak_pipeline(seconds: float, rng: np.random.Generator) -> Soaked:
    """Run the soak of a pipeline for some seconds and return its result."""
    cloud, script, soaked = cloud_of(_sweep()), Script(rng), Soaked()
    soaked.kinds = {name: Kind() for name in ("good", *DAMAGES, *CLOCKS)}
    taken = [Latencies()]
    begin_s = time.perf_counter()
    while time.perf_counter() - begin_s < seconds:
        answers: list[Answer] = []
        pipeline = Pipeline(
            load_estimator("shadow_map"), partial(_take, answers, taken), monitor=StreamMonitor(),
            stale_after_s=math.inf,
        )  # fmt: skip
        sent: dict[int, str] = {}
        begun = [0]
        number, dropped, until_s = 0, 0, time.perf_counter() + period_s(seconds)
        while (now_s := time.perf_counter()) < min(until_s, begin_s + seconds):
            # 1. Put in the next sweep; it is decoded when its turn comes.
            kind, t_ns, is_more = script.next()
            pipeline.put(partial(_decoded, begun, number, cloud, kind, t_ns))
            sent[number], number = kind, number + 1
            soaked.kinds[kind].sent += 1
            # 2. Wait while UNDER_WAY sweeps are in flight, or one waits for its turn, which the next would replace.
            # A burst does not wait.
            dropped += _settle(soaked, sent, answers)
            while not is_more and (len(sent) >= UNDER_WAY or begun[0] < number - 1):
                time.sleep(0.0002)
                dropped += _settle(soaked, sent, answers)
            if now_s - begin_s >= (len(soaked.log) + 1) * seconds / LINES:
                soaked.log.append(log_line(soaked, now_s - begin_s, taken[0], memory_mb(os.getpid())))
                taken[0] = Latencies()
        # 3. Restart. Waiting sweeps are still answered; the others must be as many as the pipeline counts as dropped.
        statistics = pipeline.close()
        dropped += _settle(soaked, sent, answers)
        counted = statistics.dropped + sum(statistics.unpublished.values())
        if sent or dropped != counted:
            soaked.faults.append(
                f"{len(sent)} sweeps without an answer, {dropped} replaced, {counted} counted as dropped or unpublished"
            )
        soaked.restarts += 1
    soaked.seconds = time.perf_counter() - begin_s
    soaked.log.append(log_line(soaked, soaked.seconds, taken[0], memory_mb(os.getpid())))
    soaked.faults += faults_of(soaked)
    return soaked


def period_s(seconds: float) -> float:
    """Return the seconds between restarts in a soak of ``seconds``."""
    return max(seconds / (RESTARTS + 1), MIN_S)


def _take(answers: list[Answer], taken: list[Latencies], answer: Answer) -> None:
    taken[0].add(answer.latency_s)
    answers.append(replace(answer, leveled=None, estimate=answer.estimate and _NOTHING))


_NOTHING = FovEstimate(
    BevGrid(2, 1.0), np.zeros((2, 2), np.float32), np.full((2, 2), CellState.UNKNOWN, np.uint8)
)  # fmt: skip
"""Placeholder for the estimates of answers, which are not kept."""


def _decoded(begun: list[int], number: int, cloud: Cloud, kind: str, t_ns: int) -> Sweep:
    begun[0] = number
    damaged = DAMAGES[kind].change(cloud) if kind in DAMAGES else cloud
    return sweep_of_cloud(damaged).replace(t_ns=t_ns)


def _settle(soaked: Soaked, sent: dict[int, str], answers: list[Answer]) -> int:
    """Count the answered sweeps; return the number of earlier ones that were dropped."""
    dropped = 0
    while answers:
        answer = answers.pop(0)
        # Sweeps are answered in order: an earlier one without an answer was dropped.
        for number in [number for number in sent if number < answer.number]:
            soaked.kinds[sent.pop(number)].dropped += 1
            dropped += 1
        kind = soaked.kinds[sent.pop(answer.number)]
        kind.answered += answer.estimate is not None
        kind.refused += answer.estimate is None
        for reason in (answer.refused, *answer.notes):
            if reason:
                kind.reasons[plain(reason)] += 1
    return dropped


def plain(reason: str) -> str:
    """Return a reason with its numbers replaced, so that equal ones can be counted.

    >>> plain("time jumped by 60.1 s: the stream begins anew")
    'time jumped by # s: the stream begins anew'
    """
    return re.sub(r"-?\d+(\.\d+)?", "#", reason)


def log_line(soaked: Soaked, passed_s: float, taken: Latencies, memory: float) -> list[float]:
    """Return a line of the log."""
    counts = [
        sum(getattr(kind, name) for kind in soaked.kinds.values())
        for name in ("sent", "answered", "dropped", "refused")
    ]  # fmt: skip
    return [passed_s, *counts, 1e3 * taken.quantile(0.5), 1e3 * taken.quantile(0.99), memory]


def faults_of(soaked: Soaked) -> list[str]:
    """Return the failed checks as sentences."""
    faults = []
    for name, kind in soaked.kinds.items():
        if kind.sent != kind.answered + kind.refused + kind.dropped:
            faults.append(f"{name}: of {kind.sent} sent only {kind.answered + kind.refused + kind.dropped} are known")
        damage = DAMAGES.get(name)
        must_refuse = damage is not None and bool(damage.says)
        if must_refuse and kind.answered:
            faults.append(f"{name}: {kind.answered} were answered")
        # A repeated time of a dropped sweep counts as new.
        if not (must_refuse or name == "time repeats") and kind.refused:
            faults.append(f"{name}: {kind.refused} were refused")
        says = damage.says if damage is not None else CLOCKS[name][1] if name in CLOCKS else ""
        if says and kind.refused and not any(plain(says) in reason for reason in kind.reasons):
            faults.append(f"{name}: nothing said {says!r}, but {list(kind.reasons)}")
    return faults + memory_faults(soaked.log)


def memory_faults(log: Sequence[Sequence[float]]) -> list[str]:
    """Return a sentence if memory, the last number of each line, grew too much after the warm-up; the first is time."""
    warm = [line[-1] for line in log if line[0] >= WARM_SHARE * log[-1][0]]
    growth = max(warm) / warm[0] - 1.0
    return [f"memory grew by {growth:.1%}, from {warm[0]:.0f} MB on"] if growth > GROWTH else []


def memory_mb(process: int) -> float:
    """Return the resident memory of a process in 10⁶ bytes."""
    pages = int(Path(f"/proc/{process}/statm").read_text(encoding="utf-8").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def _sweep() -> Sweep:
    return read_sweep(junction_path())


def _soak_node(seconds: float) -> Soaked | None:
    """Run the soak of the ROS 2 node and return its result; None without an environment for it."""
    with tempfile.TemporaryDirectory() as folder:
        np.savez(place := Path(folder) / "sweep.npz", **_columns(_sweep()))
        command = [str(ROOT / "ros" / "python.sh"), str(ROOT / "ros" / "measure" / "soak.py"), str(place), str(seconds)]
        done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode == 3:
        return None
    if done.returncode:
        return Soaked(faults=[f"the soak of the node crashed: {done.stderr.strip()[-800:]}"])
    values = json.loads(done.stdout.splitlines()[-1])
    kinds = {name: Kind(**{**kind, "reasons": Counter(kind["reasons"])}) for name, kind in values.pop("kinds").items()}
    return Soaked(**values, kinds=kinds)


def _columns(sweep: Sweep) -> dict[str, Any]:
    columns = {"points": sweep.points, "intensity": sweep.intensity, "ring": sweep.ring}
    return {name: column for name, column in columns.items() if column is not None}


def _section(soaked: Soaked) -> list[str]:
    """Return the parts of the page about one soak."""
    verdict = "**Passed.**" if not soaked.faults else "**Failed:** " + "; ".join(soaked.faults) + "."
    log = [[*(f"{count:.0f}" for count in line[:5]), *map(_tenths, line[5:])] for line in soaked.log]
    kinds = [
        [name, str(kind.sent), str(kind.answered), str(kind.refused), str(kind.dropped), _reasons(kind), _why(name)]
        for name, kind in soaked.kinds.items()
    ]  # fmt: skip
    counts = f"{soaked.seconds / 60:.1f} minutes, begun anew {soaked.restarts} times. {verdict}"
    return [
        counts, table(["s", "sent", "answered", "dropped", "refused", "median", "99 %", "MB"], log),
        "What became of each kind, and what was said:",
        table(["kind", "sent", "answered", "refused", "dropped", "said, and how often", "why"], kinds),
    ]  # fmt: skip


def _tenths(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.1f}"


def _reasons(kind: Kind) -> str:
    return (
        "; ".join(
            f"{reason.replace('|', '/')} ({count})"
            for reason, count in kind.reasons.most_common(40 if len(kind.reasons) > 20 else 3)
        )
        or "–"
    )


_CLOCK_WHY = (
    "a time that repeats is that of a sweep that was answered; where it goes back or jumps the stream begins anew"
)


def _why(name: str) -> str:
    if name in DAMAGES:
        return DAMAGES[name].why
    return (
        _CLOCK_WHY
        if name in CLOCKS
        else "after a clock or a sensor that changed the stream begins anew, and that is said"
    )


if __name__ == "__main__":
    main()
