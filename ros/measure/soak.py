"""Soak test of the node: ``ros/python.sh ros/measure/soak.py SWEEP.npz SECONDS`` prints JSON.

``python -m benchmarks.soak`` runs it and explains its numbers. The node is restarted by turns: the process by SIGINT,
or its lifecycle by deactivation and activation. Single messages cannot be traced, because best-effort topics may lose
some; so the number of sent messages is compared with the sums in the node's diagnostics.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import rclpy
from benchmarks.damage import DAMAGES, cloud_of
from benchmarks.soak import (
    CLOCKS,
    LINES,
    SEED,
    UNDER_WAY,
    Kind,
    Script,
    Soaked,
    log_line,
    memory_faults,
    memory_mb,
    period_s,
    plain,
)
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from load import Load, Stream, message_of, running_node, stamped

from viewshed.pipeline.latency import Latencies
from viewshed.sweep import Sweep

RESTARTED_SHARE = 7
"""Every k-th restart restarts the process; the others deactivate and activate the node."""


def main() -> None:
    """Run the test and print the results."""
    path, seconds = Path(sys.argv[1]), float(sys.argv[2])
    with np.load(path) as file:
        sweep = Sweep(file["points"], file.get("intensity"), file.get("ring"))
    rclpy.init()
    soak = Soak(sweep, seconds)
    soak.run()
    rclpy.try_shutdown()
    result = soak.soaked
    kinds = {
        name: {
            "sent": kind.sent, "answered": kind.answered, "refused": kind.refused, "dropped": kind.dropped,
            "reasons": dict(kind.reasons),
        }
        for name, kind in result.kinds.items()
    }  # fmt: skip
    print(json.dumps({
        "seconds": result.seconds, "restarts": result.restarts, "kinds": kinds, "log": result.log,
        "faults": result.faults,
    }))  # fmt: skip


class Soak:
    """The soak test of the node.

    Args:
        sweep: sent in all messages.
        seconds: duration.
    """

    def __init__(self, sweep: Sweep, seconds: float) -> None:
        cloud = cloud_of(sweep)
        self._messages = {name: message_of(damage.change(cloud)) for name, damage in DAMAGES.items()}
        self._stream, self._seconds = Stream("lidar", message_of(cloud)), seconds
        self._load = Load([self._stream])
        self._script = Script(np.random.default_rng(SEED))
        self._load.node.create_subscription(DiagnosticArray, "/diagnostics", self._take, 10)
        self._change = self._load.node.create_client(ChangeState, "field_of_view/change_state")
        self._diagnostics: dict[str, str] = {}
        self.soaked = Soaked(kinds={"all": Kind()})
        self._before = Kind()
        self._ended_with_mb: list[float] = []
        self._memories: list[tuple[float, float]] = []  # of this process: seconds since its begin, MB

    def run(self) -> None:
        """Run the test for its duration."""
        begin_s = time.perf_counter()
        while time.perf_counter() - begin_s < self._seconds:
            with running_node({"profile": "infrastructure", "rate_hz": "0.0", "diagnostics_hz": "10.0"}) as node:
                self._load.wait_for_node()
                self._memories, born_s = [], time.perf_counter()
                for _ in range(RESTARTED_SHARE):
                    until_s = time.perf_counter() + period_s(self._seconds)
                    self._work(node, begin_s, min(until_s, begin_s + self._seconds))
                    self._memories.append((time.perf_counter() - born_s, memory_mb(node.pid)))
                    self.soaked.restarts += 1
                    if node.poll() is not None or time.perf_counter() - begin_s >= self._seconds:
                        break
                    self._go_round()
                self._account(node)
            # Discard late diagnostics of the process that ended.
            for _ in range(50):
                self._load.spin(0.0)
            self._diagnostics.clear()
        self.soaked.seconds = time.perf_counter() - begin_s
        ends = ", ".join(f"{memory:.0f}" for memory in self._ended_with_mb)
        self.soaked.kinds["all"].reasons[f"processes, ended with {ends} MB"] = len(self._ended_with_mb)
        self._judge()

    def _work(self, node: subprocess.Popen[bytes], begin_s: float, until_s: float) -> None:
        kind, stream, log = self.soaked.kinds["all"], self._stream, self.soaked.log
        while (now_s := time.perf_counter()) < until_s:
            name, t_ns, is_more = self._script.next()
            stream.put_s[t_ns] = time.perf_counter()
            stream.publish(stamped(self._messages.get(name, stream.message), t_ns))
            kind.sent += 1
            kind.reasons[f"sent: {name}"] += 1
            # Refused messages get no grid, so the wait is limited.
            end_s = now_s + (0.0 if is_more else 0.2)
            while stream.waiting() >= UNDER_WAY and time.perf_counter() < end_s:
                self._load.spin(0.02)
            self._load.spin(0.0)
            if now_s - begin_s >= (len(log) + 1) * self._seconds / LINES:
                latencies = Latencies()
                for seconds in stream.latency_s:
                    latencies.add(seconds)
                self._count()
                log.append(log_line(self.soaked, now_s - begin_s, latencies, memory_mb(node.pid)))
                stream.latency_s.clear()

    def _go_round(self) -> None:
        """Deactivate and activate; what was learned is kept."""
        for number in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_ACTIVATE):
            future = self._change.call_async(ChangeState.Request(transition=Transition(id=number)))
            rclpy.spin_until_future_complete(self._load.node, future, timeout_sec=20.0)
            if not (future.done() and future.result().success):
                self.soaked.faults.append(f"the lifecycle refused transition {number}")
        self._load.wait_for_node()

    def _take(self, message: DiagnosticArray) -> None:
        """Keep the last diagnostics: those of the pipeline and of the sensor have their own names."""
        for status in message.status:
            self._diagnostics |= {f"{status.name}/{pair.key}": pair.value for pair in status.values}

    def _value(self, name: str, otherwise: int = 0) -> int:
        return int(self._diagnostics.get(name, otherwise))

    def _count(self) -> None:
        """Update the counts: those before this process, plus its diagnostics."""
        kind, before = self.soaked.kinds["all"], self._before
        kind.answered = before.answered + self._value("field_of_view/answered")
        refused = {
            key: int(value) for key, value in self._diagnostics.items() if "/refused: " in key and ": lidar/" not in key
        }
        kind.refused = before.refused + sum(refused.values())
        received = self._value("field_of_view: lidar/messages")
        kind.reasons["received"] = before.reasons["received"] + received
        replaced = self._value("field_of_view/dropped")
        kind.reasons["replaced by newer ones"] = before.reasons["replaced by newer ones"] + replaced
        for reason in {plain(key.partition("/refused: ")[2]) for key in refused}:
            count = sum(value for key, value in refused.items() if plain(key.partition("/refused: ")[2]) == reason)
            kind.reasons[f"refused: {reason}"] = before.reasons[f"refused: {reason}"] + count
        kind.dropped = replaced + before.reasons["replaced by newer ones"] + kind.sent - kind.reasons["received"]

    def _account(self, node: subprocess.Popen[bytes]) -> None:
        """Wait for the final diagnostics of the node and keep its counts, because the next process counts from 0."""
        if node.poll() is not None:
            self.soaked.faults.append(f"the node ended by itself with {node.returncode}")
            return
        end_s = time.monotonic() + 2.0
        while time.monotonic() < end_s:
            self._load.spin(0.1)
        self._count()
        kind = self.soaked.kinds["all"]
        self._ended_with_mb.append(memory_mb(node.pid))
        self.soaked.faults += memory_faults(self._memories)
        self._before = Kind(kind.sent, kind.answered, kind.refused, kind.dropped, Counter(kind.reasons))
        self._stream.put_s.clear()

    def _judge(self) -> None:
        """Record violations of the expected counts."""
        kind, faults = self.soaked.kinds["all"], self.soaked.faults
        if kind.sent != kind.answered + kind.refused + kind.dropped:
            faults.append(f"of {kind.sent} sent {kind.answered + kind.refused + kind.dropped} are known")
        damaged = sum(kind.reasons[f"sent: {name}"] for name, damage in DAMAGES.items() if damage.says)
        max_refused = damaged + kind.reasons["sent: time repeats"]
        if kind.refused > max_refused:
            faults.append(f"{kind.refused} were refused, but only {max_refused} could be")
        words = [damage.says for damage in DAMAGES.values() if damage.says] + [CLOCKS["time repeats"][1]]
        faults += [
            f"refused for a reason that nobody expects: {reason}"
            for reason in kind.reasons
            if reason.startswith("refused: ") and not any(word in reason for word in words)
        ]


if __name__ == "__main__":
    main()
