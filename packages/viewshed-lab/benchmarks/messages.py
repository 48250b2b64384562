"""What messages between agents take: ``python -m benchmarks.messages [--forged N] [--regions N] [--page FILE]``.

Bytes of views and whole messages on real sweeps, times to decode and verify, times to refuse, and a flood of forged
messages among honest ones. Writes docs/results/messages.md.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from viewshed import FovEstimate, Rigid, Sweep
from viewshed.agents.fov_code import decode_fov, encode_fov, has_std
from viewshed.agents.receiver import Reason, Receiver, ReceiverLimits
from viewshed.agents.signing import KeyRing, SigningKey, is_signed_by, open_envelope, sign, sign_message
from viewshed.agents.view_message import MAX_BYTES, SensorFacts, ViewMessage, decode_message, field_sizes
from viewshed.detections import Detections
from viewshed.estimators import load_estimator
from viewshed.io import read_index, read_indexed
from viewshed.io.export import claimed_by_cpm, to_cpm
from viewshed.io.messages.cpm import CONTAINERS, Station, decode_cpm, encode_cpm
from viewshed.io.messages.uper import encode
from viewshed.monitor.report import IntegrityReport
from viewshed.sensors import lidar_model
from viewshed_lab._page import facts, page, table
from viewshed_lab._results import write_page
from viewshed_lab.sim.lidar.measurement import measure
from viewshed_lab.sim.lidar.weather import CONDITIONS
from viewshed_lab.sim.observe import pose_and_motion
from viewshed_lab.sim.raycast.caster import cast_world
from viewshed_lab.sim.world import AgentPlan
from viewshed_lab.sim.worlds import WORLDS

ROOT = Path(__file__).resolve().parents[3]
PAGE = ROOT / "docs" / "results" / "messages.md"
INDEX = ROOT.parent / "shared" / "data" / "index.json"
SEED = 20_261_123
DETECTIONS = 20
RUNS = 15
START_NS = 1_760_000_000_000_000_000
STEP_NS = 100_000_000
LISTENS_NS = START_NS - 1_000_000_000
METHODS = {"shadow_map": 1, "mc_dropout": 3}
"""Estimators, each with a number k: it gets every k-th sweep."""

WORLDS_SEEN = ("street", "junction", "highway", "parking", "residential")
SENSORS = ("vlp16", "hdl32e", "hdl64e", "os1_128")
"""Sensors of the simulated sweeps, which had no part in the design of the code."""

REGION_BYTES = 300
SHAPES = {"sectors": 56, "polygon": 66}
"""Shapes of a perception region, each with its initial number of sectors or corners."""

ENOUGH = 0.8
"""Polygons are not tried if sectors keep at least this share of the visible cells."""

HONEST_EACH = 100
"""Number of forged messages before each honest one."""

SIZES = """## Bytes of a view

State, probability in 16 levels and, with `mc_dropout`, deviation in 8 levels of 256² cells. Beside it the same planes,
quantized alike, deflated one by one by zlib at its highest level. Each sweep counts once. What the code expects at its
beginning, and how soon it forgets, was chosen on the real sweeps; the simulated ones had no part in that."""
WHOLE = f"""## Bytes of a message

The view of `shadow_map`, {DETECTIONS} detections, pose with covariance, report and
signature. Bytes of each field, and of the whole message."""
REGIONS = f"""## Bytes of a Collective Perception Message

Perception regions (ETSI TS 103 324) of the visible cells of `shadow_map` in at most {REGION_BYTES} bytes, sectors or
polygons, whichever keep more where sectors keep less than {ENOUGH:.0%}; every real sweep, and simulated ones."""
TIMES = """## Times

Of each sweep the least of several runs, in milliseconds; then median and 95th percentile over the sweeps. Decoding a
message includes that of its view, and all checks; the rows for signature and view alone are what no check can save.
More processes than cores cost times, those of whole messages most: between two of them others use the caches."""
REFUSALS = """## Refusing

Microseconds from the bytes to the counted reason."""

FLOOD = """## A flood of forged messages

By a forger who hears each honest message first and sends, before that arrives, copies with a changed bit in signature
or content, the message before, the same payload signed by a key of its own, parts, extensions and rubbish."""


class Row:
    """Values of many sweeps, and a target for median and 95th percentile."""

    def __init__(
        self, name: str, values: Sequence[float], targets: tuple[float, float] | None, digits: int = 0
    ) -> None:
        self.name, self.targets, self.digits = name, targets, digits
        self.median, self.high, self.most = (float(np.percentile(values, share)) for share in (50, 95, 100))
        self.count = len(values)

    def cells(self) -> list[str]:
        """Return name, sweeps, median, 95th percentile, maximum, target, and whether it is met."""
        shown = [f"{value:,.{self.digits}f}" for value in (self.median, self.high, self.most)]
        if self.targets is None:
            return [self.name, str(self.count), *shown, "–", ""]
        target = " / ".join("–" if np.isinf(value) else f"{value:,g}" for value in self.targets)
        is_met = self.median <= self.targets[0] and self.high <= self.targets[1]
        return [self.name, str(self.count), *shown, f"≤ {target}", "met" if is_met else "**missed**"]


HEADER = ["what", "sweeps", "median", "95 %", "most", "target", ""]


def main() -> None:
    """Measure, print and write the page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.messages", description=__doc__)
    parser.add_argument("--index", type=Path, default=INDEX, help="index of real sweeps")
    parser.add_argument("--forged", type=int, default=1_000_000, help="forged messages in the flood")
    parser.add_argument("--regions", type=int, default=1000, help="sweeps whose perception regions are measured")
    parser.add_argument(
        "--flood", action="store_true", help="the flood alone: no page, exits with 1 where one is taken"
    )
    parser.add_argument("--page", type=Path, default=PAGE, help="where the Markdown goes")
    arguments = parser.parse_args()
    key = SigningKey.generate("car1")
    rng = np.random.default_rng(SEED)
    if arguments.flood:
        view = load_estimator().estimate(next(simulated()))
        content = flood(view, key, arguments.forged, rng)
        print(content)
        sys.exit(0 if "| of these accepted | 0 |" in content else 1)
    sweeps = list(readable(arguments.index))
    views = {method: estimates(method, sweeps[::step]) for method, step in METHODS.items()}
    others = {"`shadow_map`, simulated": estimates("shadow_map", simulated())}
    more = max(arguments.regions - len(views["shadow_map"]), 0)
    regions_of = chain(views["shadow_map"], (estimates("shadow_map", [sweep])[0] for sweep in simulated(more)))
    signed = [sign_message(message_of(view, k, rng), key) for k, view in enumerate(views["shadow_map"])]
    named = {f"`{method}`": of_method for method, of_method in views.items()} | others
    content = page(
        "Messages between agents: bytes and times",
        facts(
            load=f"{os.getloadavg()[0]:.0f} processes that wanted to run",
            seed=str(SEED),
            sweeps=f"{len(sweeps)} real ones",
        ),
        SIZES, table(HEADER, [row.cells() for name, of_name in named.items() for row in view_rows(name, of_name)]),
        WHOLE, table(HEADER, [row.cells() for row in message_rows(signed)]),
        REGIONS, regions(regions_of),
        TIMES, table(HEADER, [row.cells() for row in time_rows(views, signed, key)]),
        REFUSALS, refusals(signed[0], key),
        flood(views["shadow_map"][0], key, arguments.forged, rng),
    )  # fmt: skip
    write_page(arguments.page, content)
    print(content)


def readable(index: Path) -> Iterator[Sweep]:
    """Yield the readable sweeps of an index."""
    for entry in read_index(index):
        try:
            yield read_indexed(entry)
        except (ValueError, OSError):
            continue


def simulated(count: int = len(WORLDS_SEEN) * len(SENSORS)) -> Iterator[Sweep]:
    """Yield simulated sweeps: a snapshot of each world with each sensor, then of other worlds of the same kinds."""
    for sweep in range(count):
        number, sensor = sweep // len(SENSORS), SENSORS[sweep % len(SENSORS)]
        rng = np.random.default_rng([SEED, number])
        world = WORLDS[WORLDS_SEEN[number % len(WORLDS_SEEN)]](rng, AgentPlan(sensor=sensor, sensor_height_m=1.8))
        agent, model = world.agents[0], lidar_model(sensor)
        motion = pose_and_motion(world, agent, 1.0, 0.1)[1]
        exact = cast_world(world.snapshot(1.0), model, world.world_from_sensor(agent, 1.0), motion, seed=number)
        yield measure(exact, CONDITIONS["clear"], rng).sweep()


def estimates(method: str, sweeps: Iterable[Sweep]) -> list[FovEstimate]:
    """Return the estimates of a method for each sweep."""
    estimator = load_estimator(method)
    return [estimator.estimate(sweep) for sweep in sweeps]


def message_of(view: FovEstimate, number: int, rng: np.random.Generator) -> ViewMessage:
    """Return a message with a view, and with detections around a car in a town."""
    boxes = np.column_stack([
        rng.normal(0, 20, (DETECTIONS, 2)), np.zeros(DETECTIONS), rng.uniform(0.5, 5.0, (DETECTIONS, 3)),
        rng.uniform(-3, 3, DETECTIONS),
    ])  # fmt: skip
    kinds, returns = rng.integers(0, 5, DETECTIONS, dtype=np.uint8), rng.integers(5, 900, DETECTIONS, dtype=np.int32)
    return ViewMessage(
        agent="car1", sequence=number, t_ns=START_NS + STEP_NS * number, frame="map",
        world_from_level=Rigid.from_yaw(0.3, np.array([601_234.5, 5_300_000.25, 12.0])),
        pose_covariance=np.diag([0.04, 0.04, 0.01, 1e-4, 1e-4, 4e-4]), sensor=SensorFacts("HDL-32E", 1.84, 70.0),
        view=view, detections=Detections(boxes, kinds, returns), report=IntegrityReport("benchmark", 1.0, 2.0, 0.3),
    )  # fmt: skip


def view_rows(name: str, views: Sequence[FovEstimate]) -> list[Row]:
    """Return rows of the bytes of views, by our code and by zlib."""
    code = [len(encode_fov(view)) for view in views]
    return [Row(name, code, (4000, 7000)), Row(f"{name}, planes by zlib", [deflated(view) for view in views], None)]


def deflated(view: FovEstimate) -> int:
    """Return the bytes of the planes of a view, quantized to the same levels, by zlib."""
    planes = [view.state, np.minimum(16 * view.visible_prob, 15).astype(np.uint8)]
    if has_std(view) and view.std is not None:
        planes.append(np.minimum(16 * view.std, 7).astype(np.uint8))
    return sum(len(zlib.compress(plane.tobytes(), 9)) for plane in planes)


def message_rows(signed: Sequence[bytes]) -> list[Row]:
    """Return rows of the bytes of each field, of envelope and signature, and of the whole message."""
    payloads = [open_envelope(data).payload for data in signed]
    sizes = [field_sizes(payload) for payload in payloads]
    rows = [Row(name, [size[name] for size in sizes], None) for name in sizes[0]]
    envelopes = [len(data) - len(payload) for data, payload in zip(signed, payloads, strict=True)]
    rows.append(Row("envelope with key id and signature", envelopes, None))
    return [*rows, Row("**message**", [len(data) for data in signed], (7000, 11_000))]


def regions(views: Iterable[FovEstimate]) -> str:
    """Return the table of perception regions in at most ``REGION_BYTES``."""
    sizes, kept, damaged, wrong = [], [], 0, 0
    for view in views:
        best: dict[str, Any] = {"viewshed:share_kept": 0.0}
        for shape in SHAPES:
            if best["viewshed:share_kept"] < ENOUGH:
                best = max(best, region_of(view, shape), key=lambda found: found["viewshed:share_kept"])
        sent = best["perceptionRegionContainer"]
        [content] = encode_cpm(Station(1, 48.0, 11.0), START_NS, sent)
        contained = decode_cpm(content)["payload"]["cpmContainers"]
        damaged += contained[1:] != ([{"perceptionRegionContainer": sent}] if sent else [])
        sizes.append(len(encode(CONTAINERS[4][1], sent, "regions")) if sent else 0)
        kept.append(100.0 * best["viewshed:share_kept"])
        wrong += bool((claimed_by_cpm(best, view.grid.centers) & ~view.visible()).any())
    rows = [Row("bytes", sizes, (REGION_BYTES, REGION_BYTES)), Row("percent of the visible cells kept", kept, None, 1)]
    share = float(np.mean(kept))
    verdict = "met" if share >= 85.0 else "**missed**"
    return table(HEADER, [row.cells() for row in rows]) + (
        f"\n\nMean of the cells kept: {share:.1f} % (target ≥ 85 %: {verdict}). Messages that came back changed:"
        f" {damaged}. Views whose regions cover another cell: {wrong}."
    )


def region_of(view: FovEstimate, shape: str) -> dict[str, Any]:
    """Return the regions of a view in a shape, with as many sectors or corners as fit into ``REGION_BYTES``."""
    count = SHAPES[shape]
    while True:
        region = to_cpm(view, count, shape)
        sent = region["perceptionRegionContainer"]
        if not sent or len(encode(CONTAINERS[4][1], sent, "regions")) <= REGION_BYTES:
            return region
        count -= 4


def least_ms(job: Callable[[], object], runs: int = RUNS) -> float:
    """Return the shortest of some runs in milliseconds."""
    return min(elapsed_us(job) for _ in range(runs)) / 1e3


def elapsed_us(job: Callable[[], object]) -> float:
    """Return the microseconds of one run."""
    begin = time.perf_counter_ns()
    job()
    return (time.perf_counter_ns() - begin) / 1e3


def time_rows(views: dict[str, list[FovEstimate]], signed: Sequence[bytes], key: SigningKey) -> list[Row]:
    """Return rows of times to encode and decode views, and to verify and decode messages."""
    rows = []
    for method, of_method in views.items():
        encode_ms = [least_ms(partial(encode_fov, view), 3) for view in of_method]
        rows.append(Row(f"encode a view of `{method}`", encode_ms, None, 3))
        rows.append(Row("decode it", [decode_ms(view) for view in of_method], None, 3))
    public = key.verifying()
    payloads = [open_envelope(data).payload for data in signed]

    def verify_and_decode(data: bytes, payload: bytes) -> None:
        is_signed_by(data, public)
        decode_message(payload)

    verify = [least_ms(partial(is_signed_by, data, public)) for data in signed]
    decode = [least_ms(partial(decode_message, payload)) for payload in payloads]
    both = [least_ms(partial(verify_and_decode, *pair)) for pair in zip(signed, payloads, strict=True)]
    return [
        *rows,
        Row("verify a message", verify, None, 3),
        Row("decode a message", decode, None, 3),
        Row("**verify and decode a message**", both, (0.5, np.inf), 3),
    ]


def decode_ms(view: FovEstimate) -> float:
    """Return the time to decode a view in milliseconds."""
    return least_ms(partial(decode_fov, encode_fov(view), view.grid, view.threshold, has_std(view)))


def bad_messages(good: bytes, key: SigningKey) -> dict[str, tuple[bytes, int, Reason]]:
    """Return bad messages by name: bytes, clock error of the receiver in seconds, and expected reason of refusal."""
    stranger, payload = SigningKey.generate("car1"), open_envelope(good).payload
    forged = bytearray(good)
    forged[-1] ^= 1
    return {
        "100 MB": (bytes(100_000_000), 0, Reason.TOO_LARGE),
        "rubbish of 10 kB": (bytes(range(256)) * 40, 0, Reason.MALFORMED),
        "cut off": (good[:-1], 0, Reason.MALFORMED),
        "yesterday's": (good, 86_400, Reason.TOO_OLD),
        "a clock 5 s ahead": (good, -5, Reason.TOO_NEW),
        "signed by an unknown key": (sign(payload, stranger), 0, Reason.UNKNOWN_KEY),
        "a changed signature": (bytes(forged), 0, Reason.FORGED),
        "a payload of rubbish, signed": (sign(payload[:40] + bytes(9000), key), 0, Reason.BAD_CONTENT),
    }


def refusals(good: bytes, key: SigningKey) -> str:
    """Return the table of times to refuse."""
    rows = []
    for name, (data, off_s, reason) in bad_messages(good, key).items():
        times_us = []
        for _ in range(300):
            here = Receiver(KeyRing((key.verifying(),)), start_ns=LISTENS_NS)
            now_ns = START_NS + 1_000_000_000 * off_s
            times_us.append(elapsed_us(partial(here.receive, data, now_ns)))
            if set(here.refused) != {reason}:
                raise RuntimeError(f"{name} was refused as {here.refused}, not as {reason}")
        median, high = np.percentile(times_us, [50, 99])
        limit = 500 if reason in (Reason.FORGED, Reason.BAD_CONTENT) else 100
        verdict = "met" if high <= limit else "met by the median alone" if median <= limit else "**missed**"
        rows.append([name, reason.value, f"{median:.1f}", f"{high:.1f}", f"≤ {limit}", verdict])
    return table(["message", "reason", "median", "99 %", "target", ""], rows)


def flood(view: FovEstimate, key: SigningKey, forged: int, rng: np.random.Generator) -> str:
    """Return the section on a flood of forged messages: accepted ones, and the delay of honest messages."""
    stranger, limits = SigningKey.generate("car1"), ReceiverLimits(max_age_s=0.15)
    here, quiet = (Receiver(KeyRing((key.verifying(),)), limits=limits, start_ns=LISTENS_NS) for _ in range(2))
    message, previous, accepted = message_of(view, 0, rng), b"", 0
    alone_us, among_us, forged_us = [], [], []
    for number in range(max(1, forged // HONEST_EACH)):
        now_ns = START_NS + STEP_NS * number
        honest = sign_message(replace(message, sequence=number, t_ns=now_ns), key)
        kinds = forgeries(honest, previous or honest[:-1], stranger, rng)
        alone_us.append(elapsed_us(partial(quiet.receive, honest, now_ns)))
        for pick in rng.integers(len(kinds), size=HONEST_EACH):
            begin = time.perf_counter_ns()
            receipt = here.receive(kinds[pick], now_ns)
            forged_us.append((time.perf_counter_ns() - begin) / 1e3)
            accepted += receipt.message is not None
        among_us.append(elapsed_us(partial(here.receive, honest, now_ns)))
        previous = honest
    alone, among = np.percentile(alone_us, [50, 99]) / 1e3, np.percentile(among_us, [50, 99]) / 1e3
    rows = [
        ["forged messages", f"{len(forged_us):,}", ""],
        ["of these accepted", str(accepted), "0"],
        ["honest messages taken", f"{here.taken:,} of {len(among_us):,}", "all"],
        ["honest ones without forged, median and 99 %", f"{alone[0]:.3f} and {alone[1]:.3f} ms", ""],
        [
            f"honest ones, each behind {HONEST_EACH} forged",
            f"{among[0]:.3f} and {among[1]:.3f} ms, {among[0] / alone[0]:.2f} and {among[1] / alone[1]:.2f} ×",
            "99 % ≤ 2 ×",
        ],
        [
            "a forged one, median and 99 %",
            " and ".join(f"{value:.1f} µs" for value in np.percentile(forged_us, [50, 99])),
            "",
        ],
    ]
    reasons = [[reason.value, f"{count:,}"] for reason, count in here.refused.most_common()]
    return "\n\n".join([FLOOD, table(["what", "measured", "target"], rows), table(["refused as", "times"], reasons)])


def forgeries(honest: bytes, previous: bytes, stranger: SigningKey, rng: np.random.Generator) -> list[bytes]:
    """Return the forgeries of an honest message that a forger sends; most are well-formed."""
    payload = open_envelope(honest).payload
    signature, content = bytearray(honest), bytearray(honest)
    signature[-1 - int(rng.integers(64))] ^= 1 << int(rng.integers(8))
    content[60 + int(rng.integers(len(payload) - 100))] ^= 1 << int(rng.integers(8))
    return [
        bytes(signature),
        bytes(content),
        previous,
        sign(payload, stranger),
        honest[: int(rng.integers(len(honest)))],
        honest + b"\0",
        rng.bytes(3000),
        bytes(MAX_BYTES + 1),
    ]


if __name__ == "__main__":
    main()
