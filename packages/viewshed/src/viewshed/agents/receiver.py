"""What arrives, taken or refused: each message costs a bounded amount of work, and each refusal has a counted reason.

Size, form, key, age, sequence and rate are looked at before the signature, and no state changes before it is verified:
a forger can neither spend the rate of an honest agent nor move its sequence number.
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
"""Number of signatures of each key, before the newest, that are kept to tell a copy from another message."""

NUMBERS_PER_S = 1000
"""A sequence number may rise by this a second of the agent's clock, and once by this more: no agent sends so often."""

MAX_LINKS = 256
"""Links that are remembered; of more the longest unused is forgotten."""

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
    BEFORE_START = "from before the receiver began, or a replay of it"
    DOUBLED = "received before"
    OLD_EPOCH = "of an earlier start of its agent than one that was taken already"
    EPOCH_AHEAD = "its agent says that it started later than it sent"
    JUMPED = "its number is too far above the newest one"
    LATE = "older than one of the same agent that was taken already"
    CLOCK_WENT_BACK = "newer by its number, older by its time"
    TOO_OFTEN = "more messages than its agent may send"
    NO_TIME = "forged messages used up the time for verifying"
    FORGED = "the signature is not that of its agent"
    TWO_OF_ONE_NAME = "another message of this agent has the same number: two senders use one name and key"
    NOT_WRITTEN = "the receiver could not write down that it took it"
    BAD_CONTENT = "its content is not what a message may say"
    UNKNOWN_FRAME = "its pose is in a frame that is not known"
    OTHER_GRID = "its view is on a grid that is not taken"
    EMPTY_VIEW = "its view says nothing of any cell"


@dataclass(frozen=True, slots=True)
class ReceiverLimits:
    """What a receiver takes."""

    max_bytes: int = MAX_BYTES  # of a signed message
    max_age_s: float = 1.0  # largest age of a message by the receiver's clock
    max_ahead_s: float = 0.5  # and so far in its future
    max_hz: float = 25.0  # messages a second of one agent, over a while
    burst: int = 10  # messages of one agent at once
    forged_per_s: float = 5.0  # forged messages of one link and second that are still verified, over a while
    forged_burst: int = 50  # and at once
    # seconds of work a second that forged messages may cost, whatever link they come by. Half of it is for all, the
    # other half is split among the keys, so that forging under one leaves the others theirs.
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
    """What became of one message."""

    message: ViewMessage | None  # what it says, or None where it was refused
    reason: Reason | None = None  # why it was refused, or None
    agent: str = ""  # who it is from by its own words, empty where nobody could be read
    detail: str = ""  # more of the reason, for people


@dataclass(slots=True)
class AgentRecord:
    """What a receiver remembers of an agent."""

    bucket: Bucket  # messages that it may send
    lost: int = 0  # messages before the newest that have not come
    taken: int = 0  # messages taken
    # messages refused after its signature was verified, by reason
    refused: Counter[Reason] = field(default_factory=Counter)


class _RefusedError(Exception):
    def __init__(self, reason: Reason, detail: str = "") -> None:
        super().__init__(reason.value)
        self.reason = reason
        self.detail = detail


KEPT_AHEAD_NS = 500_000_000
"""The file names a time so far behind the newest message, so that it is written twice a second at most."""

_MAX_FILE_BYTES = 1_000_000


@dataclass(slots=True)
class Bucket:
    """Tokens that come back at a constant rate."""

    rate: float
    size: float
    tokens: float
    at_ns: int

    def level(self, now_ns: int) -> float:
        """Return the tokens that are there at a time of a clock that never goes back."""
        self.tokens = min(self.size, self.tokens + self.rate * (now_ns - self.at_ns) / 1e9)
        self.at_ns = now_ns
        return self.tokens


@dataclass(slots=True)
class Stream:
    """The messages of one key."""

    budget: Bucket  # seconds of work that forged messages under this key may cost
    epoch: int = -1  # greatest epoch that was signed with it, -1 for none
    newest: int = -1  # greatest sequence number of that epoch, -1 for none since the receiver began
    newest_ns: int | None = None  # nothing is taken that is stamped earlier; None where nothing is known of the key
    kept_ns: int = -1  # time that the file names
    signatures: dict[int, bytes] = field(default_factory=dict)  # of the newest messages, by their numbers


def read_state(path: Path) -> dict[bytes, tuple[int, int]]:
    """Return epoch and time of each key id; nothing where there is no file yet.

    Raises:
        ValueError: it is no such file.
        OSError: it cannot be read.
    """
    if not path.exists():
        return {}
    try:
        if path.stat().st_size > _MAX_FILE_BYTES:
            raise ValueError("it is too large")
        found = {bytes.fromhex(key): (epoch, t_ns) for key, (epoch, t_ns) in json.loads(path.read_bytes()).items()}
        for epoch, t_ns in found.values():
            if type(epoch) is not int or type(t_ns) is not int or epoch > MAX_EPOCH or not 0 <= t_ns <= 2 * MAX_T_NS:
                raise ValueError("it holds other numbers")
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f"state must be a file that a receiver wrote, got {path} ({error}); remove it") from error
    return found


def write_state(path: Path, streams: Mapping[bytes, Stream]) -> None:
    """Write epoch and time of each key, so that what was taken is not taken by the next receiver.

    Raises:
        OSError: it cannot be written.
    """
    found = {}
    for key_id, stream in streams.items():
        if stream.newest_ns is not None:
            # A key that nobody has used since the file was read keeps its time.
            ahead_ns = KEPT_AHEAD_NS if stream.newest >= 0 else 0
            found[key_id.hex()] = (stream.epoch, stream.newest_ns + ahead_ns)
    write_atomic(path, json.dumps(found).encode())
    for key_id, stream in streams.items():
        stream.kept_ns = found.get(key_id.hex(), (-1, -1))[1]


class Receiver:
    """Takes or refuses signed messages.

    A receiver that begins cannot know what the one before it took. Without ``state`` it refuses all that is stamped, by
    the agent's clock, before its own start and ``max_ahead_s``: the one before it took nothing that was stamped later.

    Args:
        keys: whom to believe.
        frames: names of maps that poses may be in.
        grids: grids that views may be on; None takes any that a message can have.
        own: the receiver's own name, or empty.
        limits: sizes, ages and rates.
        state: file that keeps epoch and time of the newest message of each key, for the next receiver: replays are
            then refused even where its clock is wrong. Written about twice a second, and by one receiver alone; None
            keeps nothing.
        start_ns: since when it listens, by its clock; None: since its first message.

    Raises:
        ValueError: the file is none that a receiver wrote.
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
        kept = {} if self._state is None else read_state(self._state)
        self._streams = {
            key_id: Stream(Bucket(1.0, 1.0, 1.0, 0), epoch, newest_ns=t_ns, kept_ns=t_ns)
            for key_id, (epoch, t_ns) in kept.items()
        }

    def receive(self, data: bytes | bytearray | memoryview, now_ns: int, link: str = "") -> Receipt:
        """Return what a message says, or why it is refused; never raises because of what the bytes are.

        Args:
            data: what arrived.
            now_ns: the receiver's clock, nanoseconds since 1970.
            link: who brought it, if the transport knows; a link that brings forged messages is not listened to for a
                while. Where that is not known, leave it out: others' messages come the same way.
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
            # Of an agent whose key is known, so that there are no more of them than keys.
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
        """Count the time that passes for rates and budgets, in which a clock that is set back stands still."""
        self._passed_ns += 0 if self._now_ns is None else max(0, now_ns - self._now_ns)
        self._now_ns = now_ns
        # Set back behind the start, the clock begins anew: otherwise nothing is taken until it gets there again.
        self._start_ns = now_ns if self._start_ns is None else min(self._start_ns, now_ns)

    def _link(self, link: str) -> Bucket | None:
        """Return the bucket of forged messages of a link, the longest unused one given up for a new one."""
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
        """Look at age, epoch, sequence and rate. Nothing is remembered yet, for anybody can write a heading."""
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
        """Refuse what a receiver before this one may have taken, where this one has taken nothing of the key."""
        until_ns = stream.newest_ns
        if until_ns is None:
            until_ns = (self._start_ns or 0) + round(self.limits.max_ahead_s * _NS)
        if heading.t_ns <= until_ns:
            raise _RefusedError(Reason.BEFORE_START, f"by {(until_ns - heading.t_ns) / _NS:.3f} s")

    def _check_number(self, heading: MessageHeading, signature: bytes, stream: Stream) -> None:
        """Look at epoch and sequence number; those of an epoch are compared with each other alone."""
        if heading.epoch < stream.epoch:
            raise _RefusedError(
                Reason.OLD_EPOCH,
                f"epoch {heading.epoch} after {stream.epoch}; two senders have one key, or start it again",
            )
        # The time is bounded by the receiver's clock: no epoch can shut an agent out for longer than max_ahead_s.
        if heading.epoch * 1_000_000 > heading.t_ns:
            raise _RefusedError(Reason.EPOCH_AHEAD, f"epoch {heading.epoch} at {heading.t_ns // 1_000_000} ms")
        is_known = heading.epoch == stream.epoch and stream.newest >= 0
        known = stream.signatures.get(heading.sequence) if is_known else None
        if known == signature:
            raise _RefusedError(Reason.DOUBLED, f"number {heading.sequence}")
        if is_known and known is None and heading.sequence <= stream.newest:
            raise _RefusedError(Reason.LATE, f"number {heading.sequence} after {stream.newest}")
        if known is None and stream.newest_ns is not None and heading.t_ns < stream.newest_ns:
            raise _RefusedError(Reason.CLOCK_WENT_BACK, f"by {(stream.newest_ns - heading.t_ns) / _NS:.3f} s")
        if is_known and stream.newest_ns is not None:
            most = stream.newest + round(NUMBERS_PER_S * (1.0 + (heading.t_ns - stream.newest_ns) / _NS))
            if heading.sequence > most:
                raise _RefusedError(Reason.JUMPED, f"number {heading.sequence} after {stream.newest}; start it again")

    def _is_signed(self, data: bytes, key: VerifyingKey, stream: Stream) -> bool:
        """Verify a signature, if those that were forged have left time for it: of this key, or of all."""
        half_s = 0.5 * self.limits.forged_share
        parts = ((stream.budget, half_s / max(len(self.keys), 1)), (self._forged, half_s))
        for budget, part_s in parts:
            if budget.level(self._passed_ns) > 0.0:
                begin_ns = thread_time_ns()
                is_signed = is_signed_by(data, key)
                if not is_signed:
                    budget.tokens -= (thread_time_ns() - begin_ns) / _NS / part_s
                return is_signed
        raise _RefusedError(Reason.NO_TIME, f"{self.limits.forged_share:g} s a second")

    def _check_content(
        self, payload: bytes, signature: bytes, heading: MessageHeading, stream: Stream, record: AgentRecord
    ) -> ViewMessage:
        """Remember the signed message, and decode and check what it says."""
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
        """Make a message the newest of its key, for this receiver and, where it keeps a file, for the next one."""
        if heading.epoch != stream.epoch:
            stream.signatures = {}
        elif stream.newest >= 0:
            record.lost += heading.sequence - stream.newest - 1
        stream.epoch, stream.newest, stream.newest_ns = heading.epoch, heading.sequence, heading.t_ns
        oldest = stream.newest - SEQUENCES_KEPT
        stream.signatures = {number: each for number, each in stream.signatures.items() if number > oldest}
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
        """Return a sentence for the messages taken, for each reason of refusal, and for each agent's losses."""
        lines = [f"{self.taken} taken, {self.refused.total()} refused"]
        lines += [f"{count} refused: {reason.value}" for reason, count in self.refused.most_common()]
        return lines + [f"{name}: {each.taken} taken, {each.lost} lost" for name, each in sorted(self.agents.items())]
