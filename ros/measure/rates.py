"""Measure the node on this machine: ``ros/python.sh ros/measure/rates.py SWEEPS [--seconds S]`` prints JSON.

SWEEPS is a folder written by ``python -m benchmarks.robot``: an NPZ of each sweep, and of the laser's ranges, and
networks of several shapes.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from benchmarks.damage import cloud_of
from benchmarks.soak import memory_mb
from load import Load, Stream, message_of, processor_s, running_node, scan_bytes
from rclpy.serialization import serialize_message

from viewshed.estimators import load_estimator
from viewshed.geometry import Rigid
from viewshed.grid import GRIDS
from viewshed.monitor.evidence import SECTORS
from viewshed.preprocess.leveling import level
from viewshed.sweep import Sweep
from viewshed_ros.conversions import stamp_of
from viewshed_ros.layers import LAYERS, PosedEstimate
from viewshed_ros.nav2 import SpeedLimits

AGENTS = 10
NETWORKS = ("unet", "mc_dropout")
"""Networks: with one pass, and with several."""

UNDER_WAY = (1, 2, 3)
"""Messages in flight: with three, one for each working thread and one that waits."""

TOPIC_MESSAGES = 30
SENSOR_HZ = 10.0


def main() -> None:
    """Run all measurements and print the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sweeps", type=Path)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each measurement")
    arguments = parser.parse_args()
    rclpy.init()
    print(json.dumps(list(_measured(arguments.sweeps, arguments.seconds))))
    rclpy.try_shutdown()


def _measured(folder: Path, seconds: float) -> Iterator[dict[str, Any]]:
    clouds = {name: message_of(cloud_of(_sweep(folder / f"{name}.npz"))) for name in ("35k", "120k", "VLP-16")}
    with np.load(folder / "scan.npz") as laser:
        scan = scan_bytes(laser["ranges_m"], float(laser["field_of_view"]), float(laser["range_max_m"]))
    for monitor in ("never", "always"):
        for name in ("35k", "120k"):
            yield from _closed(name, clouds[name], monitor, seconds, is_scan=False)
        yield from _closed("LaserScan", scan, monitor, seconds, is_scan=True)
    for method in NETWORKS:
        network = {"method": method, "weights": "road_int8"}
        yield from _closed(f"35k, {method}", clouds["35k"], "never", seconds, is_scan=False, network=network)
    for path in sorted(folder.glob("shape_*.onnx")):
        network = {"method": NETWORKS[0], "weights": str(path), "stale_s": "10.0"}  # a busy machine may take .5 s
        yield from _closed(path.stem, clouds["35k"], "never", seconds / 5, is_scan=False, network=network)
    yield _at_ten_hz("VLP-16", [Stream("lidar", clouds["VLP-16"])], seconds)
    yield _at_ten_hz(
        f"{AGENTS} agents", [Stream(f"agent{number}", clouds["VLP-16"]) for number in range(AGENTS)], seconds
    )
    yield from _topics(_sweep(folder / "35k.npz"))
    with tempfile.TemporaryDirectory() as empty:
        for caches, prefix in (("cold", empty), ("warm", empty)):
            yield {"case": "start", "caches": caches, "first_s": _start_s(clouds["35k"], prefix)}


def _sweep(path: Path) -> Sweep:
    with np.load(path) as file:
        return Sweep(file["points"], file["intensity"], file.get("ring"))


def _closed(
    name: str, message: bytes, monitor: str, seconds: float, *, is_scan: bool, network: Mapping[str, str] | None = None
) -> Iterator[dict[str, Any]]:
    """Yield latencies and rates by number of messages in flight, for the profile's method or a network."""
    parameters = {"profile": "infrastructure", "rate_hz": "0.0", "monitor": monitor}
    if network:
        parameters |= {**network, "history": "0"}
    if is_scan:
        parameters |= {"lidar.type": "scan", "grid": "indoor"}
    stream = Stream("lidar", message)
    load = Load([stream], is_scan=is_scan)
    with running_node(parameters) as node:
        load.wait_for_node()
        load.first_answer()
        load.run_closed(1.0, 2)
        for under_way in UNDER_WAY:
            load.forget()
            before_s = processor_s(node.pid)
            passed_s = load.run_closed(seconds, under_way)
            used_s = processor_s(node.pid) - before_s
            yield {
                "case": name, "monitor": monitor, "under_way": under_way, **_latencies(stream),
                "hz": len(stream.latency_s) / passed_s, "processor_ms": 1e3 * used_s / max(len(stream.latency_s), 1),
                "cores": used_s / passed_s, "memory_mb": memory_mb(node.pid),
                "dropped": stream.dropped, "taken_ms": [round(1e3 * seconds, 2) for seconds in stream.latency_s],
            }  # fmt: skip
    load.close()


def _at_ten_hz(name: str, streams: list[Stream], seconds: float) -> dict[str, Any]:
    """Return latency, rate and load for sensors at 10 Hz each, with the profile ``robot``."""
    load = Load(streams)
    # The rate limit tolerates jitter, so all sweeps must be estimated.
    parameters = {"profile": "robot", "sensors": f"[{', '.join(stream.name for stream in streams)}]"}
    with running_node(parameters) as node:
        load.wait_for_node()
        load.first_answer()
        load.run_at(1.0, SENSOR_HZ)
        load.forget()
        begin_s, before_s = time.perf_counter(), processor_s(node.pid)
        load.run_at(seconds, SENSOR_HZ)
        passed_s, used_s = time.perf_counter() - begin_s, processor_s(node.pid) - before_s
        hz = [len(stream.latency_s) / seconds for stream in streams]
        result = {
            "case": name, **_latencies(*streams), "hz": min(hz), "hz_most": max(hz), "cores": used_s / passed_s,
            "memory_mb": memory_mb(node.pid),
        }  # fmt: skip
    load.close()
    return result


def _topics(sweep: Sweep) -> Iterator[dict[str, Any]]:
    """Yield the CPU time of making and serializing a message of each topic."""
    leveled = level(sweep.replace(world_from_sensor=Rigid.identity()), GRIDS["road"])
    estimate = load_estimator("shadow_map", grid="road").estimate(leveled)
    suspect, placed = np.zeros(SECTORS, np.bool_), leveled.level_from_sensor.inverse()
    view = PosedEstimate(estimate, stamp_of(1), "lidar", placed, "map", suspect, 5.0, SpeedLimits())
    for topic, layer in LAYERS.items():
        taken_s = []
        for _ in range(TOPIC_MESSAGES):
            begin_s = time.thread_time()
            message = layer.make(view)
            if not isinstance(message, bytes):
                serialize_message(message)
            taken_s.append(time.thread_time() - begin_s)
        yield {"case": "topic", "topic": topic, "processor_ms": 1e3 * float(np.median(taken_s))}


def _latencies(*streams: Stream) -> dict[str, float]:
    taken_ms = 1e3 * np.concatenate([stream.latency_s or [np.nan] for stream in streams])  # all were dropped
    p50, p99 = np.percentile(taken_ms, [50, 99])
    return {"p50_ms": float(p50), "p99_ms": float(p99), "worst_ms": float(taken_ms.max())}


def _start_s(message: bytes, caches: str) -> float:
    """Return the seconds from the start of the process to its first grid, with Python's bytecode cache in a folder."""
    load = Load([Stream("lidar", message)])
    os.environ["PYTHONPYCACHEPREFIX"] = caches
    begin_s = time.perf_counter()
    with running_node({"profile": "infrastructure", "rate_hz": "0.0"}):
        first_s = load.first_answer() - begin_s
    del os.environ["PYTHONPYCACHEPREFIX"]
    load.close()
    return first_s


if __name__ == "__main__":
    main()
