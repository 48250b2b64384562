"""Accept or refuse incoming messages: bounded work per message, and a counted reason for each refusal.

Size, format, key, age, sequence number and rate are checked before the signature, and no state changes before it is
verified: a forger can neither use up an honest agent's rate limit nor advance its sequence number.
"""

from __future__ import annotations

import json
from collections import Counter, OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from time import thread_time_ns

from viewshed._files import write_atomic
from viewshed.agents.signing import (
    KeyRing,
    MessageHeading,
    OtherVersionError,
    VerifyingKey,
    is_signed_by,
    open_envelope,
    read_heading,
)
from viewshed.agents.view_message import MAX_BYTES, MAX_EPOCH, MAX_T_NS, ViewMessage, decode_message
from viewshed.fov.estimate import CellState
from viewshed.grid import BevGrid

SEQUENCES_KEPT = 64
"""Signatures kept per key, the most recent ones, to tell a duplicate from a different message of the same number."""

NUMBERS_PER_S = 1000
"""Maximum increase of a sequence number per second of the agent's clock, plus this much once; no agent sends faster."""

MAX_LINKS = 256
"""Maximum number of links with their own budget; beyond it, the least recently used one is evicted."""

_NS = 1_000_000_000


class Reason(Enum):
    """Why a message was refused, in words."""

    TOO_LARGE = "more bytes than a message may have"
    NOISY_LINK = "its link sent too many forged messages"
    MALFORMED = "no signed message"
    OTHER_VERSION = "a message in another version of the format"
    UNKNOWN_KEY = "signed by a key that is not known"
    KEY_NOT_VALID = "signed by a key that is not valid at its time"
    WRONG_SENDER = "names another agent than the one its key belongs to"
    OWN_NAME = "names the receiver itself as its sender"
    TOO_OLD = "too old: held up, replayed, or its clock is behind"
    TOO_NEW = "from the future: its clock is ahead"
    BEFORE_START = "sent before the receiver started, or replayed"
    DOUBLED = "received before"
    OLD_EPOCH = "from an earlier start of its agent than an accepted message"
    EPOCH_AHEAD = "its agent says that it started later than it sent"
    JUMPED = "its sequence number is too far above the newest one"
    LATE = "older than an accepted message of the same agent"
    CLOCK_WENT_BACK = "newer by its sequence number, older by its time stamp"
    TOO_OFTEN = "more messages than its agent may send"
    NO_TIME = "forged messages used up the time for verification"
    FORGED = "the signature is not that of its agent"
    TWO_OF_ONE_NAME = "another message of this agent has the same number: two senders use one name and key"
    NOT_WRITTEN = "the receiver could not save its state"
    BAD_CONTENT = "its content is not what a message may say"
    UNKNOWN_FRAME = "its pose is in an unknown frame"
    OTHER_GRID = "its view is on a grid that is not accepted"
    EMPTY_VIEW = "its view has no known cell"


@dataclass(frozen=True, slots=True)
class ReceiverLimits:
    """Limits on size, age, rate and verification work that a receiver enforces."""

    max_bytes: int = MAX_BYTES  # of a signed message
    max_age_s: float = 1.0  # largest age of a message by the receiver's clock
    max_ahead_s: float = 0.5  # largest lead of its time stamp over the receiver's clock
    max_hz: float = 25.0  # sustained messages per second and agent
    burst: int = 10  # messages of one agent in a burst
    forged_per_s: float = 5.0  # sustained forged messages per second and link that are still verified
    forged_burst: int = 50  # the same in a burst
    # CPU seconds per second that verifying forged messages may cost, over all links. Half of it is shared by all keys;
    # the other half is split evenly among them, so that forging under one key leaves the others their part.
    forged_share: float = 0.25

    def __post_init__(self) -> None:
        if not 0 < self.max_bytes <= MAX_BYTES:
            raise ValueError(f"max_bytes must lie in [1, {MAX_BYTES}], got {self.max_bytes}")
        for name in ("max_age_s", "max_hz", "forged_per_s", "burst", "forged_burst"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        if not self.max_ahead_s >= 0:
            raise ValueError(f"max_ahead_s must not be negative, got {self.max_ahead_s}")
        if not 0 < self.forged_share <= 1:
            raise ValueError(f"forged_share must lie in (0, 1], got {self.forged_share}")


@dataclass(frozen=True, slots=True)
class Receipt:
    """Result of receiving one message."""

    message: ViewMessage | None  # decoded message, or None where it was refused
    reason: Reason | None = None  # why it was refused, or None
    agent: str = ""  # sender it claims, not always verified; empty where none could be read
    detail: str = ""  # human-readable detail of the reason


@dataclass(slots=True)
class AgentRecord:
    """Rate limit and message counts of one agent."""

    bucket: Bucket  # rate limit: messages it may still send
    lost: int = 0  # messages before the newest one that have not arrived
    taken: int = 0  # messages accepted
    # messages refused after their signature was verified, by reason
    refused: Counter[Reason] = field(default_factory=Counter)


class _RefusedError(Exception):
    def __init__(self, reason: Reason, detail: str = "") -> None:
        super().__init__(reason.value)
        self.reason = reason
        self.detail = detail


KEPT_AHEAD_NS = 500_000_000
"""The state file names a time this far after the newest message, so that it is written at most twice a second."""

_MAX_FILE_BYTES = 1_000_000


@dataclass(slots=True)
class Bucket:
    """Token bucket, refilled at a constant rate."""

    rate: float
    size: float
    tokens: float
    at_ns: int

    def level(self, now_ns: int) -> float:
        """Refill up to ``now_ns`` of a monotonic clock and return the tokens available."""
        self.tokens = min(self.size, self.tokens + self.rate * (now_ns - self.at_ns) / 1e9)
        self.at_ns = now_ns
        return self.tokens


@dataclass(slots=True)
class Stream:
    """Sequence state of one key."""

    budget: Bucket  # verification time that forged messages under this key may cost
    epoch: int = -1  # greatest epoch accepted, -1 for none
    newest: int = -1  # greatest sequence number of that epoch, -1 where this receiver has accepted none
    newest_ns: int | None = None  # earlier time stamps are refused; None where nothing is known of the key
    kept_ns: int = -1  # time in the state file
    signatures: dict[int, bytes] = field(default_factory=dict)  # of the newest messages, by sequence number


def read_state(path: Path) -> dict[bytes, tuple[int, int]]:
    """Return epoch and time of each key id from a state file; empty where the file does not exist yet.

    Raises:
        ValueError: it is not a state file.
        OSError: it cannot be read.
    """
    if not path.exists():
        return {}
    try:
        if path.stat().st_size > _MAX_FILE_BYTES:
            raise ValueError("it is too large")
        state = {bytes.fromhex(key): (epoch, t_ns) for key, (epoch, t_ns) in json.loads(path.read_bytes()).items()}
        for epoch, t_ns in state.values():
            if type(epoch) is not int or type(t_ns) is not int or epoch > MAX_EPOCH or not 0 <= t_ns <= 2 * MAX_T_NS:
                raise ValueError("it holds other numbers")
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f"state must be a file that a receiver wrote, got {path} ({error}); remove it") from error
    return state


def write_state(path: Path, streams: Mapping[bytes, Stream]) -> None:
    """Write epoch and time of each key, so that the next receiver refuses what this one has accepted.

    Raises:
        OSError: it cannot be written.
    """
    state = {}
    for key_id, stream in streams.items():
        if stream.newest_ns is not None:
            # A key not used since the file was read keeps its time.
            ahead_ns = KEPT_AHEAD_NS if stream.newest >= 0 else 0
            state[key_id.hex()] = (stream.epoch, stream.newest_ns + ahead_ns)
    write_atomic(path, json.dumps(state).encode())
    for key_id, stream in streams.items():
        stream.kept_ns = state.get(key_id.hex(), (-1, -1))[1]


class Receiver:
    """Accepts or refuses signed messages.

    A new receiver does not know what its predecessor accepted. Without ``state`` it refuses every time stamp before its
    own start plus ``max_ahead_s``, because the predecessor accepted nothing stamped later.

    Args:
        keys: public keys of the trusted agents.
        frames: names of the maps that poses may be in.
        grids: grids that views may be on; None accepts any that a message can have.
        own: the receiver's own name, or empty.
        limits: limits on sizes, ages and rates.
        state: file with epoch and time of the newest message of each key, for the next receiver, which then refuses
            replays even if its clock is wrong. Written about twice a second, by one receiver only; None keeps nothing.
        start_ns: start of listening by its own clock; None is the time of the first message.

    Raises:
        ValueError: the file was not written by a receiver.
        OSError: it cannot be read.
    """

    def __init__(
        self,
        keys: KeyRing,
        frames: frozenset[str] = frozenset({"map"}),
        grids: tuple[BevGrid, ...] | None = None,
        own: str = "",
        limits: ReceiverLimits | None = None,
        *,
        state: Path | str | None = None,
        start_ns: int | None = None,
    ) -> None:
        self.keys = keys
        self.frames = frames
        self.grids = grids
        self.own = own
        self.limits = ReceiverLimits() if limits is None else limits
        self.taken = 0
        self.refused: Counter[Reason] = Counter()
        self.agents: dict[str, AgentRecord] = {}
        self._links: OrderedDict[str, Bucket] = OrderedDict()
        self._start_ns, self._now_ns, self._passed_ns = start_ns, start_ns, 0
        self._forged = Bucket(1.0, 1.0, 1.0, 0)
        self._state = None if state is None else Path(state)
        last_state = {} if self._state is None else read_state(self._state)
        self._streams = {
            key_id: Stream(Bucket(1.0, 1.0, 1.0, 0), epoch, newest_ns=t_ns, kept_ns=t_ns)
            for key_id, (epoch, t_ns) in last_state.items()
        }

    def receive(self, data: bytes | bytearray | memoryview, now_ns: int, link: str = "") -> Receipt:
        """Return the decoded message, or the reason for refusing it; never raises because of the bytes received.

        Args:
            data: bytes that arrived.
            now_ns: the receiver's clock, nanoseconds since 1970.
            link: peer that delivered it, if the transport knows; a link that delivers forged messages is ignored for a
                while. Leave it empty if unknown, because other agents' messages arrive the same way.
        """
        agent = ""
        self._pass_time(now_ns)
        try:
            size = memoryview(data).nbytes
            if size > self.limits.max_bytes:
                raise _RefusedError(Reason.TOO_LARGE, f"{size} bytes")
            message_bytes = bytes(data)
            bucket = self._link(link)
            if bucket is not None and bucket.level(self._passed_ns) < 1.0:
                raise _RefusedError(Reason.NOISY_LINK, link)
            try:
                envelope = open_envelope(message_bytes)
                heading = read_heading(envelope.payload)
            except OtherVersionError as error:
                raise _RefusedError(Reason.OTHER_VERSION, str(error)) from None
            except ValueError as error:
                raise _RefusedError(Reason.MALFORMED, str(error)) from None
            agent = heading.agent
            key = self._key_of(envelope.key_id, heading)
            # Only agents with a known key get a record: the number of records is bounded by the number of keys.
            burst = float(self.limits.burst)
            record = self.agents.setdefault(
                agent, AgentRecord(Bucket(self.limits.max_hz, burst, burst, self._passed_ns))
            )
            stream = self._streams.setdefault(envelope.key_id, Stream(Bucket(1.0, 1.0, 1.0, self._passed_ns)))
            self._check_heading(heading, envelope.signature, stream, record, now_ns)
            if not self._is_signed(message_bytes, key, stream):
                if bucket is not None:
                    bucket.tokens -= 1.0
                raise _RefusedError(Reason.FORGED)
            message = self._check_content(envelope.payload, envelope.signature, heading, stream, record)
        except _RefusedError as refused:
            self.refused[refused.reason] += 1
            return Receipt(None, refused.reason, agent, refused.detail)
        self.taken += 1
        return Receipt(message, None, agent)

    def _pass_time(self, now_ns: int) -> None:
        """Advance the monotonic time of rates and budgets; it stands still while the clock is set back."""
        self._passed_ns += 0 if self._now_ns is None else max(0, now_ns - self._now_ns)
        self._now_ns = now_ns
        # Clock set back before the start: move the start, or all messages are refused until the clock catches up.
        self._start_ns = now_ns if self._start_ns is None else min(self._start_ns, now_ns)

    def _link(self, link: str) -> Bucket | None:
        """Return the bucket of forged messages of a link; a new link may evict the least recently used one."""
        if not link:
            return None
        bucket = self._links.get(link)
        if bucket is None:
            burst = float(self.limits.forged_burst)
            bucket = self._links[link] = Bucket(self.limits.forged_per_s, burst, burst, self._passed_ns)
            if len(self._links) > MAX_LINKS:
                self._links.popitem(last=False)
        else:
            self._links.move_to_end(link)
        return bucket

    def _key_of(self, key_id: bytes, heading: MessageHeading) -> VerifyingKey:
        key = self.keys.find(key_id)
        if key is None:
            raise _RefusedError(Reason.UNKNOWN_KEY, key_id.hex())
        if key.agent != heading.agent:
            raise _RefusedError(Reason.WRONG_SENDER, f"key of {key.agent}")
        if heading.agent == self.own:
            raise _RefusedError(Reason.OWN_NAME)
        if not key.from_ns <= heading.t_ns <= key.until_ns:
            raise _RefusedError(Reason.KEY_NOT_VALID, key_id.hex())
        return key

    def _check_heading(
        self, heading: MessageHeading, signature: bytes, stream: Stream, record: AgentRecord, now_ns: int
    ) -> None:
        """Check age, epoch, sequence number and rate; change no state, because a heading is not authenticated."""
        age_s = (now_ns - heading.t_ns) / _NS
        if age_s > self.limits.max_age_s:
            raise _RefusedError(Reason.TOO_OLD, f"by {age_s - self.limits.max_age_s:.3f} s")
        if -age_s > self.limits.max_ahead_s:
            raise _RefusedError(Reason.TOO_NEW, f"by {-age_s - self.limits.max_ahead_s:.3f} s")
        if stream.newest < 0:
            self._check_first(heading, stream)
        self._check_number(heading, signature, stream)
        if record.bucket.level(self._passed_ns) < 1.0:
            raise _RefusedError(Reason.TOO_OFTEN, f"more than {self.limits.max_hz:g} a second")

    def _check_first(self, heading: MessageHeading, stream: Stream) -> None:
        """Refuse what an earlier receiver may have accepted, where this one has accepted nothing of the key."""
        barred_until_ns = stream.newest_ns
        if barred_until_ns is None:
            barred_until_ns = (self._start_ns or 0) + round(self.limits.max_ahead_s * _NS)
        if heading.t_ns <= barred_until_ns:
            raise _RefusedError(Reason.BEFORE_START, f"by {(barred_until_ns - heading.t_ns) / _NS:.3f} s")

    def _check_number(self, heading: MessageHeading, signature: bytes, stream: Stream) -> None:
        """Check epoch and sequence number; sequence numbers are compared only within an epoch."""
        if heading.epoch < stream.epoch:
            raise _RefusedError(
                Reason.OLD_EPOCH,
                f"epoch {heading.epoch} after {stream.epoch}; two senders have one key, or start it again",
            )
        # The receiver's clock bounds t_ns, so no epoch can lock an agent out for longer than max_ahead_s.
        if heading.epoch * 1_000_000 > heading.t_ns:
            raise _RefusedError(Reason.EPOCH_AHEAD, f"epoch {heading.epoch} at {heading.t_ns // 1_000_000} ms")
        same_epoch = heading.epoch == stream.epoch and stream.newest >= 0
        known_signature = stream.signatures.get(heading.sequence) if same_epoch else None
        if known_signature == signature:
            raise _RefusedError(Reason.DOUBLED, f"number {heading.sequence}")
        if same_epoch and known_signature is None and heading.sequence <= stream.newest:
            raise _RefusedError(Reason.LATE, f"number {heading.sequence} after {stream.newest}")
        if known_signature is None and stream.newest_ns is not None and heading.t_ns < stream.newest_ns:
            raise _RefusedError(Reason.CLOCK_WENT_BACK, f"by {(stream.newest_ns - heading.t_ns) / _NS:.3f} s")
        if same_epoch and stream.newest_ns is not None:
            max_sequence = stream.newest + round(NUMBERS_PER_S * (1.0 + (heading.t_ns - stream.newest_ns) / _NS))
            if heading.sequence > max_sequence:
                raise _RefusedError(Reason.JUMPED, f"number {heading.sequence} after {stream.newest}; start it again")

    def _is_signed(self, data: bytes, key: VerifyingKey, stream: Stream) -> bool:
        """Verify a signature, if forged messages have left time for it in this key's budget or in the shared one."""
        half_s = 0.5 * self.limits.forged_share
        budgets = ((stream.budget, half_s / max(len(self.keys), 1)), (self._forged, half_s))
        for budget, share_s in budgets:
            if budget.level(self._passed_ns) > 0.0:
                start_ns = thread_time_ns()
                is_signed = is_signed_by(data, key)
                if not is_signed:
                    budget.tokens -= (thread_time_ns() - start_ns) / _NS / share_s
                return is_signed
        raise _RefusedError(Reason.NO_TIME, f"{self.limits.forged_share:g} s a second")

    def _check_content(
        self, payload: bytes, signature: bytes, heading: MessageHeading, stream: Stream, record: AgentRecord
    ) -> ViewMessage:
        """Record the verified message, then decode and check its content."""
        record.bucket.tokens -= 1.0
        try:
            if heading.epoch == stream.epoch and heading.sequence in stream.signatures:
                raise _RefusedError(Reason.TWO_OF_ONE_NAME, f"number {heading.sequence}")
            self._remember(heading, signature, stream, record)
            try:
                message = decode_message(payload)
            except ValueError as error:
                raise _RefusedError(Reason.BAD_CONTENT, str(error)) from None
            self._check_message(message)
        except _RefusedError as refused:
            record.refused[refused.reason] += 1
            raise
        record.taken += 1
        return message

    def _remember(self, heading: MessageHeading, signature: bytes, stream: Stream, record: AgentRecord) -> None:
        """Make a message the newest of its key, here and in the state file if there is one."""
        if heading.epoch != stream.epoch:
            stream.signatures = {}
        elif stream.newest >= 0:
            record.lost += heading.sequence - stream.newest - 1
        stream.epoch, stream.newest, stream.newest_ns = heading.epoch, heading.sequence, heading.t_ns
        newest_dropped = stream.newest - SEQUENCES_KEPT
        stream.signatures = {number: each for number, each in stream.signatures.items() if number > newest_dropped}
        stream.signatures[heading.sequence] = signature
        if self._state is not None and heading.t_ns > stream.kept_ns:
            try:
                write_state(self._state, {key: each for key, each in self._streams.items() if self.keys.find(key)})
            except OSError as error:
                raise _RefusedError(Reason.NOT_WRITTEN, str(error)) from None

    def _check_message(self, message: ViewMessage) -> None:
        if message.frame not in self.frames:
            raise _RefusedError(Reason.UNKNOWN_FRAME, message.frame)
        if message.view is not None:
            if self.grids is not None and message.view.grid not in self.grids:
                raise _RefusedError(Reason.OTHER_GRID, str(message.view.grid))
            if (message.view.state == CellState.UNKNOWN).all():
                raise _RefusedError(Reason.EMPTY_VIEW)

    def summary(self) -> list[str]:
        """Return lines of text: messages accepted and refused, refusals by reason, and losses by agent."""
        lines = [f"{self.taken} taken, {self.refused.total()} refused"]
        lines += [f"{count} refused: {reason.value}" for reason, count in self.refused.most_common()]
        return lines + [f"{name}: {each.taken} taken, {each.lost} lost" for name, each in sorted(self.agents.items())]
