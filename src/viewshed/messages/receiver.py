"""What arrives, taken or refused: each message costs a bounded amount of work, and each refusal has a counted reason.

Size, form, key, age, sequence and rate are looked at before the signature, and no state changes before it is verified:
a forger can neither spend the rate of an honest agent nor move its sequence number.
"""

from __future__ import annotations

from collections import Counter, OrderedDict
from dataclasses import dataclass, field
from enum import Enum

from viewshed.fov.estimate import CellState
from viewshed.grid import BevGrid
from viewshed.messages.signing import KeyRing, MessageHeading, VerifyingKey, is_signed_by, open_envelope, read_heading
from viewshed.messages.view_message import MAX_BYTES, ViewMessage, decode_message

SEQUENCES_KEPT = 64
"""Of each agent so many sequence numbers before the newest are remembered; what is older still counts as replayed."""

MAX_LINKS = 256

_NS = 1_000_000_000


class Reason(Enum):
    """Why a message was refused, in words."""

    TOO_LARGE = "more bytes than a message may have"
    NOISY_LINK = "its link sent too many forged messages"
    MALFORMED = "no signed message of this version"
    UNKNOWN_KEY = "signed by a key that is not known"
    KEY_NOT_VALID = "signed by a key that is not valid at its time"
    WRONG_SENDER = "names another agent than the one its key belongs to"
    OWN_NAME = "names the receiver itself as its sender"
    TOO_OLD = "too old: held up, replayed, or its clock is behind"
    TOO_NEW = "from the future: its clock is ahead"
    DOUBLED = "received before"
    LATE = "older than one of the same agent that was taken already"
    CLOCK_WENT_BACK = "newer by its number, older by its time"
    TOO_OFTEN = "more messages than its agent may send"
    FORGED = "the signature is not that of its agent"
    TWO_OF_ONE_NAME = "another message of this agent has the same number: two senders use one name and key"
    BAD_CONTENT = "its content is not what a message may say"
    UNKNOWN_FRAME = "its pose is in a frame that is not known"
    OTHER_GRID = "its view is on a grid that is not taken"
    EMPTY_VIEW = "its view says nothing of any cell"


@dataclass(frozen=True, slots=True)
class ReceiverLimits:
    """What a receiver takes.

    Attributes:
        max_bytes: of a signed message.
        max_age_s: a message may be so old by the receiver's clock.
        max_ahead_s: and so far in its future.
        max_hz: messages a second of one agent, over a while.
        burst: messages of one agent at once.
        forged_per_s: forged messages of one link and second that are still verified, over a while.
        forged_burst: and at once.
        take_late: whether a message that comes after a newer one of its agent is taken.
    """

    max_bytes: int = MAX_BYTES
    max_age_s: float = 1.0
    max_ahead_s: float = 0.5
    max_hz: float = 25.0
    burst: int = 10
    forged_per_s: float = 5.0
    forged_burst: int = 50
    take_late: bool = False

    def __post_init__(self) -> None:
        if not 0 < self.max_bytes <= MAX_BYTES:
            raise ValueError(f"max_bytes must lie in [1, {MAX_BYTES}], got {self.max_bytes}")
        for name in ("max_age_s", "max_hz", "forged_per_s", "burst", "forged_burst"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        if not self.max_ahead_s >= 0:
            raise ValueError(f"max_ahead_s must not be negative, got {self.max_ahead_s}")


@dataclass(frozen=True, slots=True)
class Receipt:
    """What became of one message.

    Attributes:
        message: what it says, or None where it was refused.
        reason: why it was refused, or None.
        agent: who it is from by its own words, empty where nobody could be read.
        detail: more of the reason, for people.
    """

    message: ViewMessage | None
    reason: Reason | None = None
    agent: str = ""
    detail: str = ""


@dataclass(slots=True)
class _Bucket:
    """Tokens that come back at a constant rate."""

    rate: float
    size: float
    tokens: float
    at_ns: int

    def has_token(self, now_ns: int) -> bool:
        self.tokens = min(self.size, self.tokens + self.rate * max(0, now_ns - self.at_ns) / _NS)
        self.at_ns = max(self.at_ns, now_ns)
        return self.tokens >= 1.0


@dataclass(slots=True)
class AgentRecord:
    """What a receiver remembers of an agent.

    Attributes:
        newest: greatest sequence number that was signed by it, -1 for none.
        newest_ns: time of that message by the agent's clock.
        lost: messages before the newest that have not come.
        taken: messages taken.
        refused: messages refused after its signature was verified, by reason.
    """

    bucket: _Bucket
    newest: int = -1
    newest_ns: int = -1
    lost: int = 0
    taken: int = 0
    refused: Counter[Reason] = field(default_factory=Counter)
    signatures: dict[int, bytes] = field(default_factory=dict)


class _RefusedError(Exception):
    def __init__(self, reason: Reason, detail: str = "") -> None:
        super().__init__(reason.value)
        self.reason = reason
        self.detail = detail


class Receiver:
    """Takes or refuses signed messages.

    Args:
        keys: whom to believe.
        frames: names of maps that poses may be in.
        grids: grids that views may be on; None takes any that a message can have.
        own: the receiver's own name, or empty.
        limits: sizes, ages and rates.
    """

    def __init__(
        self,
        keys: KeyRing,
        frames: frozenset[str] = frozenset({"map"}),
        grids: tuple[BevGrid, ...] | None = None,
        own: str = "",
        limits: ReceiverLimits | None = None,
    ) -> None:
        self.keys = keys
        self.frames = frames
        self.grids = grids
        self.own = own
        self.limits = ReceiverLimits() if limits is None else limits
        self.taken = 0
        self.refused: Counter[Reason] = Counter()
        self.agents: dict[str, AgentRecord] = {}
        self._links: OrderedDict[str, _Bucket] = OrderedDict()

    def receive(self, data: bytes, now_ns: int, link: str = "") -> Receipt:
        """Return what a message says, or why it is refused; never raises because of what the bytes are.

        Args:
            data: what arrived.
            now_ns: the receiver's clock, nanoseconds since 1970.
            link: who brought it, if the transport knows; a link that brings forged messages is not listened to for a
                while. Where that is not known, leave it out: others' messages come the same way.
        """
        agent = ""
        try:
            if len(data) > self.limits.max_bytes:
                raise _RefusedError(Reason.TOO_LARGE, f"{len(data)} bytes")
            bucket = self._link(link, now_ns)
            if bucket is not None and not bucket.has_token(now_ns):
                raise _RefusedError(Reason.NOISY_LINK, link)
            try:
                envelope = open_envelope(data)
                heading = read_heading(envelope.payload)
            except ValueError as error:
                raise _RefusedError(Reason.MALFORMED, str(error)) from None
            agent = heading.agent
            key = self._key_of(envelope.key_id, heading)
            record = self._check_heading(heading, envelope.signature, now_ns)
            if not is_signed_by(data, key):
                if bucket is not None:
                    bucket.tokens -= 1.0
                raise _RefusedError(Reason.FORGED)
            message = self._check_content(envelope.payload, envelope.signature, heading, record)
        except _RefusedError as refused:
            self.refused[refused.reason] += 1
            return Receipt(None, refused.reason, agent, refused.detail)
        self.taken += 1
        return Receipt(message, None, agent)

    def _link(self, link: str, now_ns: int) -> _Bucket | None:
        """Return the bucket of forged messages of a link, the longest unused one given up for a new one."""
        if not link:
            return None
        bucket = self._links.get(link)
        if bucket is None:
            burst = float(self.limits.forged_burst)
            bucket = self._links[link] = _Bucket(self.limits.forged_per_s, burst, burst, now_ns)
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

    def _check_heading(self, heading: MessageHeading, signature: bytes, now_ns: int) -> AgentRecord:
        """Look at age, sequence and rate. Nothing is remembered yet, for anybody can write a heading."""
        age_s = (now_ns - heading.t_ns) / _NS
        if age_s > self.limits.max_age_s:
            raise _RefusedError(Reason.TOO_OLD, f"by {age_s - self.limits.max_age_s:.3f} s")
        if -age_s > self.limits.max_ahead_s:
            raise _RefusedError(Reason.TOO_NEW, f"by {-age_s - self.limits.max_ahead_s:.3f} s")
        record = self.agents.get(heading.agent)
        if record is None:  # of an agent whose key is known, so there are no more of them than keys
            bucket = _Bucket(self.limits.max_hz, float(self.limits.burst), float(self.limits.burst), now_ns)
            record = self.agents[heading.agent] = AgentRecord(bucket)
        known = record.signatures.get(heading.sequence)
        if known == signature:
            raise _RefusedError(Reason.DOUBLED, f"number {heading.sequence}")
        if known is None and heading.sequence <= record.newest:
            is_kept = heading.sequence > record.newest - SEQUENCES_KEPT
            if not is_kept or not self.limits.take_late:
                raise _RefusedError(Reason.LATE, f"number {heading.sequence} after {record.newest}")
        if heading.sequence > record.newest and heading.t_ns < record.newest_ns:
            raise _RefusedError(Reason.CLOCK_WENT_BACK, f"by {(record.newest_ns - heading.t_ns) / _NS:.3f} s")
        if not record.bucket.has_token(now_ns):
            raise _RefusedError(Reason.TOO_OFTEN, f"more than {self.limits.max_hz:g} a second")
        return record

    def _check_content(
        self, payload: bytes, signature: bytes, heading: MessageHeading, record: AgentRecord
    ) -> ViewMessage:
        """Remember the signed message, and decode and check what it says."""
        record.bucket.tokens -= 1.0
        try:
            if heading.sequence in record.signatures:
                raise _RefusedError(Reason.TWO_OF_ONE_NAME, f"number {heading.sequence}")
            self._remember(heading, signature, record)
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

    def _remember(self, heading: MessageHeading, signature: bytes, record: AgentRecord) -> None:
        if heading.sequence > record.newest:
            record.lost += heading.sequence - record.newest - 1 if record.newest >= 0 else 0
            record.newest, record.newest_ns = heading.sequence, heading.t_ns
            oldest = record.newest - SEQUENCES_KEPT
            record.signatures = {number: each for number, each in record.signatures.items() if number > oldest}
        else:
            record.lost -= 1
        record.signatures[heading.sequence] = signature

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
