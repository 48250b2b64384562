"""Each bad message is refused for its own counted reason, and the others go on."""

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import cbor2
import numpy as np
import pytest
from cwt import COSE, COSEKey
from hypothesis import given
from hypothesis import strategies as st
from tests.agents import message_samples as samples

from viewshed import BevGrid
from viewshed.agents.receiver import (
    MAX_LINKS,
    SEQUENCES_KEPT,
    Reason,
    Receipt,
    Receiver,
    ReceiverLimits,
    write_state,
)
from viewshed.agents.signing import (
    KeyRing,
    SigningKey,
    VerifyingKey,
    is_signed_by,
    open_envelope,
    read_heading,
    sign,
    sign_message,
)
from viewshed.agents.view_message import MAX_BYTES, encode_message

NOW_NS = samples.NOW_NS
MS = 1_000_000
CAR1, CAR2, MAST, FORGER = (SigningKey.generate(name) for name in ("car1", "car2", "mast", "car1"))


def signed(sequence: int = 1, key: SigningKey = CAR1, t_ns: int | None = None, **changes: Any) -> bytes:
    """A small signed message; without a time it is sent 100 ms after the one before."""
    small: dict[str, Any] = {"view": None, "ground": None, "detections": None, "report": None}
    at_ns = NOW_NS + 100 * MS * sequence if t_ns is None else t_ns
    return sign_message(samples.message(sequence, key.agent, at_ns, **(small | changes)), key)


def receiver(keys: tuple[SigningKey, ...] = (CAR1, CAR2), **options: Any) -> Receiver:
    """A receiver that has listened for a second."""
    ring = KeyRing(tuple(key.verifying() for key in keys))
    return Receiver(ring, **({"start_ns": NOW_NS - 1000 * MS} | options))


def give(to: Receiver, data: bytes, sequence: int = 1, late_ms: int = 10, link: str = "") -> Receipt:
    """Receive a message some time after that number was sent."""
    return to.receive(data, NOW_NS + 100 * MS * sequence + late_ms * MS, link)


def test_the_envelope_is_cose_as_others_read_it() -> None:
    data = signed()
    key = COSEKey.new({1: 1, 3: -8, -1: 6, -2: CAR1.public, 2: CAR1.verifying().key_id})
    assert COSE.new().decode(data, keys=key) == open_envelope(data).payload
    tag = cbor2.loads(data)
    assert tag.tag == 18
    assert cbor2.loads(tag.value[0]) == {1: -8, 4: CAR1.verifying().key_id}
    assert tag.value[1] == {}
    heading = read_heading(open_envelope(data).payload)
    assert (heading.agent, heading.epoch, heading.sequence, heading.t_ns) == ("car1", 0, 1, NOW_NS + 100 * MS)


def forged(at: int, sequence: int = 1, key: SigningKey = CAR1, **changes: Any) -> bytes:
    """An honest message with one byte changed, counted from the end."""
    data = bytearray(signed(sequence, key, **changes))
    data[-at] ^= 1
    return bytes(data)


def edited(**changes: Any) -> bytes:
    """A signed payload whose bytes the message class would not write."""
    fields = cbor2.loads(encode_message(samples.message(1, "car1", NOW_NS + 100 * MS, view=None, ground=None)))
    return sign(cbor2.dumps(fields | {int(key[1:]): value for key, value in changes.items()}, canonical=True), CAR1)


REFUSED: dict[str, tuple[Callable[[], bytes], Reason]] = {
    "100 MB": (lambda: bytes(100_000_000), Reason.TOO_LARGE),
    "one byte too many": (lambda: bytes(MAX_BYTES + 1), Reason.TOO_LARGE),
    "nothing": (lambda: b"", Reason.MALFORMED),
    "text": (lambda: b"hello", Reason.MALFORMED),
    "an unsigned payload": (lambda: encode_message(samples.message()), Reason.MALFORMED),
    "cut off": (lambda: signed()[:-1], Reason.MALFORMED),
    "longer": (lambda: signed() + b"\0", Reason.MALFORMED),
    "another algorithm": (lambda: signed().replace(b"\x01\x27\x04", b"\x01\x26\x04", 1), Reason.MALFORMED),
    "an older version": (lambda: edited(_0=1), Reason.OTHER_VERSION),
    "a newer version": (lambda: edited(_0=5), Reason.OTHER_VERSION),
    "no version": (lambda: edited(_0="2"), Reason.MALFORMED),
    "no name": (lambda: edited(_1=""), Reason.MALFORMED),
    "a name of a number": (lambda: edited(_1=5), Reason.MALFORMED),
    "a sequence without an epoch": (lambda: edited(_2=1), Reason.MALFORMED),
    "a sequence of text": (lambda: edited(_2=[0, "1"]), Reason.MALFORMED),
    "an epoch of text": (lambda: edited(_2=["0", 1]), Reason.MALFORMED),
    "an epoch that is still to come": (lambda: signed(epoch=NOW_NS // MS + 101), Reason.EPOCH_AHEAD),
    "an unknown key": (lambda: signed(key=MAST), Reason.UNKNOWN_KEY),
    "a forger's key": (lambda: signed(key=FORGER), Reason.UNKNOWN_KEY),
    "another's name": (lambda: edited(_1="car2"), Reason.WRONG_SENDER),
    "yesterday's": (lambda: signed(t_ns=NOW_NS - 86_400 * 1000 * MS), Reason.TOO_OLD),
    "a clock 3 s behind": (lambda: signed(t_ns=NOW_NS - 3000 * MS), Reason.TOO_OLD),
    "a clock 3 s ahead": (lambda: signed(t_ns=NOW_NS + 3000 * MS), Reason.TOO_NEW),
    "a forged signature": (lambda: forged(1), Reason.FORGED),
    "a forged payload": (lambda: forged(100), Reason.FORGED),
    "a NaN covariance": (lambda: edited(_5=[cbor2.CBORTag(86, bytes(56)), cbor2.CBORTag(85, b"\xff" * 84)]),
                         Reason.BAD_CONTENT),
    "no pose": (lambda: edited(_5=1), Reason.BAD_CONTENT),
    "an unknown frame": (lambda: signed(frame="moon"), Reason.UNKNOWN_FRAME),
    "another grid": (lambda: signed(view=samples.view(BevGrid(32, 16.0))), Reason.OTHER_GRID),
    "an empty view": (lambda: signed(view=empty_view()), Reason.EMPTY_VIEW),
}  # fmt: skip


def empty_view() -> Any:
    from viewshed import FovEstimate

    return FovEstimate(samples.GRID, np.zeros((64, 64), np.float32), np.zeros((64, 64), np.uint8))


@pytest.mark.parametrize("name", REFUSED)
def test_a_bad_message_is_refused_for_its_reason_and_the_others_go_on(name: str) -> None:
    make, reason = REFUSED[name]
    here = receiver(grids=(samples.GRID,))
    receipt = give(here, make())
    assert receipt.message is None
    assert receipt.reason is reason, receipt.detail
    assert dict(here.refused) == {reason: 1}
    for sequence in (2, 3):
        assert give(here, signed(sequence, view=samples.view()), sequence).message is not None
        assert give(here, signed(sequence, CAR2), sequence).message is not None
    assert any(reason.value in line for line in here.summary())


def test_late_lost_doubled_and_replayed_messages_are_counted() -> None:
    here = receiver()
    sent = {sequence: signed(sequence) for sequence in range(1, 8)}
    for sequence in (1, 2, 5, 5, 4, 2, 7):
        give(here, sent[sequence], 7)
    record = here.agents["car1"]
    assert here.taken == 4
    assert here.refused == {Reason.DOUBLED: 2, Reason.LATE: 1}
    assert record.lost == 3  # 3, 4 and 6: what comes too late to be of use is lost
    assert "car1: 4 taken, 3 lost" in here.summary()


def test_signatures_are_remembered_in_a_bounded_number() -> None:
    """A copy of an older message than those is late, as any other message of its number."""
    here = receiver(limits=ReceiverLimits(max_age_s=60.0, max_hz=1000.0, burst=1000))
    sent = [signed(number) for number in range(SEQUENCES_KEPT + 1)]
    for data in sent:
        assert give(here, data, SEQUENCES_KEPT).reason is None
    assert give(here, sent[1], SEQUENCES_KEPT).reason is Reason.DOUBLED
    assert give(here, sent[0], SEQUENCES_KEPT).reason is Reason.LATE


def test_two_senders_of_one_name_are_noticed() -> None:
    here = receiver()
    assert give(here, signed(1)).reason is None
    assert give(here, signed(1, ground=samples.ground())).reason is Reason.TWO_OF_ONE_NAME
    assert here.agents["car1"].refused == {Reason.TWO_OF_ONE_NAME: 1}
    # A forger cannot make it look so.
    assert give(here, forged(1, ground=samples.ground())).reason is Reason.FORGED


def test_a_clock_that_went_back_is_noticed() -> None:
    here = receiver()
    give(here, signed(5), 5)
    assert give(here, signed(6, t_ns=NOW_NS + 400 * MS), 6).reason is Reason.CLOCK_WENT_BACK


def test_an_agent_sends_no_more_than_its_rate() -> None:
    here = receiver(limits=ReceiverLimits(max_hz=10.0, burst=3))
    receipts = [here.receive(signed(k, t_ns=NOW_NS + k * MS), NOW_NS + 10 * MS) for k in range(8)]
    assert [receipt.reason for receipt in receipts] == [None] * 3 + [Reason.TOO_OFTEN] * 5
    # Another agent is not held up by that, and after 100 ms the next message is taken.
    assert here.receive(signed(1, CAR2, t_ns=NOW_NS), NOW_NS + 10 * MS).reason is None
    assert here.receive(signed(9, t_ns=NOW_NS + 110 * MS), NOW_NS + 111 * MS).reason is None


def test_forged_messages_spend_nothing_of_the_honest_agent() -> None:
    here = receiver(limits=ReceiverLimits(burst=2, max_hz=1.0))
    data = forged(1, 2**40, t_ns=NOW_NS + 300 * MS)
    for _ in range(50):
        assert give(here, data).reason is Reason.FORGED
    assert give(here, signed(1)).reason is None
    assert give(here, signed(2), 2).reason is None


def test_a_link_of_forged_messages_is_muted_and_other_links_are_not() -> None:
    here = receiver(limits=ReceiverLimits(forged_burst=5, forged_per_s=1.0))
    reasons = [give(here, forged(1), link="stranger").reason for _ in range(9)]
    assert reasons == [Reason.FORGED] * 5 + [Reason.NOISY_LINK] * 4
    assert give(here, signed(1), link="friend").reason is None
    assert give(here, signed(2), 2, link="").reason is None
    # After a second it is listened to again, for one forged message and no more.
    again = [give(here, forged(1, 12), 12, link="stranger").reason for _ in range(2)]
    assert again == [Reason.FORGED, Reason.NOISY_LINK]


def test_of_too_many_links_the_longest_unused_is_forgotten() -> None:
    """A link that is forgotten is listened to again; one that was used since is not forgotten before it."""
    here = receiver(limits=ReceiverLimits(forged_burst=1, forged_per_s=0.001))

    def hear(link: str) -> Reason | None:
        return give(here, forged(1), link=link).reason

    for muted in ("first", "second"):
        assert [hear(muted), hear(muted)] == [Reason.FORGED, Reason.NOISY_LINK]
    assert hear("first") is Reason.NOISY_LINK
    for k in range(MAX_LINKS - 1):  # with "first" and "second" one too many
        give(here, b"", link=f"link {k}")
    assert hear("first") is Reason.NOISY_LINK
    assert hear("second") is Reason.FORGED


VERIFYING_MS = 0.525
"""Of a loaded machine."""

HONEST = tuple(SigningKey.generate(f"car{k}") for k in range(5))
SEIZED = SigningKey.generate("seized")


@pytest.fixture
def slow_verifying(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The agents whose keys were tried on a message, each time at a cost of :data:`VERIFYING_MS`."""
    tried: list[str] = []
    remembered = lru_cache(maxsize=None)(is_signed_by)  # a flood sends the same again

    def verify(data: bytes, key: VerifyingKey) -> bool:
        tried.append(key.agent)
        return remembered(data, key)

    monkeypatch.setattr("viewshed.agents.receiver.is_signed_by", verify)
    monkeypatch.setattr("viewshed.agents.receiver.thread_time_ns", lambda: round(VERIFYING_MS * MS) * len(tried))
    return tried


def flooded(here: Receiver, agents: tuple[SigningKey, ...], seconds: int) -> dict[str, int]:
    """Send 5,000 forged messages a second in the names of agents, and 10 honest ones a second of each honest agent.

    The forged ones look as honest as they can before they are verified. Return how many of each agent's were taken.
    """
    taken = dict.fromkeys([key.agent for key in HONEST], 0)
    for step in range(1, 10 * seconds + 1):
        wrong = [forged(1, step, key) for key in agents]
        for k in range(500):
            now_ns = NOW_NS + 100 * MS * step + k * MS // 5
            assert here.receive(wrong[k % len(wrong)], now_ns).reason in (Reason.FORGED, Reason.NO_TIME, Reason.LATE)
            if k % 100 == 50:
                key = HONEST[k // 100]
                taken[key.agent] += here.receive(signed(step, key), now_ns).message is not None
    return taken


def test_a_flood_under_a_key_that_nobody_honest_uses_costs_the_honest_nothing(slow_verifying: list[str]) -> None:
    here = receiver((*HONEST, SEIZED))
    assert flooded(here, (SEIZED,), seconds=2) == {key.agent: 20 for key in HONEST}
    # A burst of one second, and the two seconds: half of a quarter for all and a sixth of the other for this key.
    spent_s = 1e-3 * VERIFYING_MS * slow_verifying.count("seized")
    assert spent_s == pytest.approx(3 * (0.125 + 0.125 / 6), rel=0.02)


def test_a_flood_in_the_name_of_an_honest_agent_costs_no_other_agent_anything(slow_verifying: list[str]) -> None:
    taken = flooded(receiver(HONEST), HONEST[:1], seconds=2)
    assert [taken[key.agent] for key in HONEST[1:]] == [20] * 4
    assert 1e-3 * VERIFYING_MS * (len(slow_verifying) - sum(taken.values())) < 3 * 0.16


def test_a_flood_in_the_names_of_all_is_verified_within_its_time(slow_verifying: list[str]) -> None:
    taken = flooded(receiver(HONEST), HONEST, seconds=1)
    assert 1e-3 * VERIFYING_MS * (len(slow_verifying) - sum(taken.values())) < 2 * 0.26
    # With time enough for all of them nobody loses anything.
    here = receiver(HONEST, limits=ReceiverLimits(forged_share=1.0))
    slow_verifying.clear()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("viewshed.agents.receiver.thread_time_ns", lambda: MS // 10 * len(slow_verifying))
        assert flooded(here, HONEST, seconds=1) == {key.agent: 10 for key in HONEST}


def test_time_for_forged_messages_comes_back(slow_verifying: list[str]) -> None:
    here = receiver((CAR1, CAR2), limits=ReceiverLimits(forged_share=0.01))

    def verified(at: int) -> int:
        """Return how many of 100 forged messages of a tenth of a second are verified."""
        before = len(slow_verifying)
        for _ in range(100):
            give(here, forged(1, at), at)
        return len(slow_verifying) - before

    # 7.5 ms of the second before, at .525 ms, rounded up for key and all; then as much as a tenth of a second gives.
    assert verified(1) == 5 + 10
    assert verified(2) in (1, 2)
    assert verified(12) == 5 + 10
    # An honest message of another key is verified all the while.
    assert give(here, signed(12, CAR2), 12).reason is None


def test_a_clock_that_jumped_ahead_and_is_set_back_stops_no_bucket() -> None:
    limits = ReceiverLimits(max_hz=10.0, burst=1, forged_burst=1, forged_per_s=10.0)
    here = receiver(limits=limits)
    hour_ns = 3_600_000 * MS
    assert give(here, signed(1)).reason is None
    assert here.receive(b"", NOW_NS + hour_ns).reason is Reason.MALFORMED
    assert give(here, forged(1, 2), 2, link="noisy").reason is Reason.FORGED
    for sequence in (2, 3, 4):
        assert give(here, signed(sequence), sequence).reason is None
    assert give(here, forged(1, 5), 5, link="noisy").reason is Reason.FORGED
    assert give(here, signed(5), 5, late_ms=0).reason is None


def test_keys_are_rotated() -> None:
    """The next key is valid from 300 ms on, the old one until 500 ms; both until the old one is removed."""
    following = SigningKey.generate("car1")
    old = CAR1.verifying(until_ns=NOW_NS + 500 * MS)
    here = Receiver(KeyRing((old, following.verifying(from_ns=NOW_NS + 300 * MS))), start_ns=NOW_NS - 1000 * MS)
    assert give(here, signed(2, following), 2).reason is Reason.KEY_NOT_VALID
    assert give(here, signed(3, following), 3).reason is None
    assert give(here, signed(4), 4).reason is None
    assert give(here, signed(6), 6).reason is Reason.KEY_NOT_VALID
    here.keys.remove(old)
    assert give(here, signed(7), 7).reason is Reason.UNKNOWN_KEY
    assert give(here, signed(8, following), 8).reason is None


def test_one_key_belongs_to_one_agent() -> None:
    with pytest.raises(ValueError, match="a key must belong to one agent, got that of 'car1' for 'car9'"):
        KeyRing((CAR1.verifying(), VerifyingKey("car9", CAR1.public)))
    with pytest.raises(ValueError, match="must have 32 bytes, got 31"):
        VerifyingKey("car9", bytes(31))
    with pytest.raises(ValueError, match="valid from one time until a later"):
        CAR1.verifying(from_ns=2, until_ns=1)
    with pytest.raises(ValueError, match="signed by its agent 'car2', got the key of 'car1'"):
        sign_message(samples.message(1, "car2"), CAR1)
    assert repr(CAR1.private) not in repr(CAR1)


def test_a_receiver_refuses_its_own_name() -> None:
    here = receiver(own="car2")
    assert give(here, signed(1, CAR2)).reason is Reason.OWN_NAME


def test_an_agent_that_comes_and_goes_each_second_is_taken_and_forgotten_nowhere() -> None:
    here = receiver()
    for second in range(20):
        sequence = 10 * second + 1
        assert give(here, signed(sequence), sequence).reason is None
    assert list(here.agents) == ["car1"]
    assert here.agents["car1"].lost == 19 * 9


@pytest.mark.parametrize("late_ms", [1, 100, 490, 900])
def test_a_receiver_that_begins_anew_takes_no_replay(late_ms: int) -> None:
    """The last second is recorded, with agents' clocks up to half a second ahead, and played to the next receiver."""
    before, end_ns = receiver(), NOW_NS + 1000 * MS
    sent = [signed(k, t_ns=NOW_NS + 100 * MS * k + ahead * MS) for k, ahead in enumerate((0, 100, 300, 499) * 3, 1)]
    recorded = [data for data in sent if before.receive(data, min(end_ns, NOW_NS + 100 * MS * k_of(data))).message]
    assert len(recorded) >= 4
    after = Receiver(KeyRing((CAR1.verifying(),)))
    for data in recorded:
        assert after.receive(data, end_ns + late_ms * MS).reason in (Reason.BEFORE_START, Reason.TOO_OLD)
    # What is sent half a second after the start is taken.
    start_ns = end_ns + late_ms * MS
    assert after.receive(signed(50, t_ns=start_ns + 501 * MS), start_ns + 520 * MS).reason is None


def k_of(data: bytes) -> int:
    return read_heading(open_envelope(data).payload).sequence


def test_a_receiver_that_keeps_a_file_takes_no_replay_whatever_its_clock_says(tmp_path: Path) -> None:
    state = tmp_path / "seen.json"
    before = receiver(state=state)
    recorded = [signed(sequence, epoch=7) for sequence in range(1, 10)]
    for sequence, data in enumerate(recorded, 1):
        assert give(before, data, sequence).reason is None
    # The clock is an hour behind when the next one begins, and comes to the time of the recording.
    after = receiver(state=state, start_ns=NOW_NS - 3_600_000 * MS)
    for sequence, data in enumerate(recorded, 1):
        assert give(after, data, sequence).reason is Reason.BEFORE_START
    # Within half a second of the newest message new ones are taken; an earlier epoch of the agent is not.
    assert give(after, signed(15, epoch=6), 15).reason is Reason.OLD_EPOCH
    assert give(after, signed(15, epoch=7), 15).reason is None
    # What it heard nothing of since stays as it is: CAR2 of the first file, in the third receiver's.
    assert give(after, signed(16, CAR2), 16).reason is None
    for _ in range(3):
        last = receiver(state=state)
        assert give(last, signed(16, CAR2), 16).reason is Reason.BEFORE_START
        assert give(last, signed(30), 30).reason is Reason.OLD_EPOCH
    assert give(last, signed(22, CAR2), 22).reason is None


def test_the_file_is_small_and_written_twice_a_second(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written = 0

    def write(*args: Any) -> None:
        nonlocal written
        written += 1
        write_state(*args)

    monkeypatch.setattr("viewshed.agents.receiver.write_state", write)
    here = receiver(state=tmp_path / "seen.json")
    for sequence in range(1, 101):
        for key in (CAR1, CAR2):
            assert give(here, signed(sequence, key), sequence).reason is None
    assert 17 <= written <= 20
    assert (tmp_path / "seen.json").stat().st_size < 200
    assert [path.name for path in tmp_path.iterdir()] == ["seen.json"]


def test_what_cannot_be_written_down_is_not_taken(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    here = receiver(state=folder / "seen.json")
    folder.rmdir()
    receipt = give(here, signed(1))
    assert receipt.reason is Reason.NOT_WRITTEN
    assert str(folder) in receipt.detail
    folder.mkdir()
    assert give(here, signed(2), 2).reason is None


@pytest.mark.parametrize(
    "content", [b"", b"[]", b"{", b"\xff", b'{"00": 1}', b'{"00": [1, "a"]}', b'{"zz": [1, 2]}', b" " * 1_000_001]
)
def test_another_file_is_no_state(tmp_path: Path, content: bytes) -> None:
    state = tmp_path / "seen.json"
    state.write_bytes(content)
    with pytest.raises(ValueError, match=r"state must be a file that a receiver wrote, got .*seen.json .*; remove it"):
        receiver(state=state)


def test_a_clock_that_is_set_back_behind_the_start_is_a_new_start() -> None:
    here = Receiver(KeyRing((CAR1.verifying(),)))
    assert here.receive(b"", NOW_NS + 3_600_000 * MS).reason is Reason.MALFORMED
    assert give(here, signed(1)).reason is Reason.BEFORE_START
    assert give(here, signed(7), 7).reason is None


def test_an_agent_that_starts_again_begins_with_any_number() -> None:
    here = receiver()
    started_ms = NOW_NS // MS
    assert give(here, signed(900, epoch=started_ms, t_ns=NOW_NS + 100 * MS), 1).reason is None
    assert give(here, signed(0, epoch=started_ms + 150, t_ns=NOW_NS + 200 * MS), 2).reason is None
    assert give(here, signed(4, epoch=started_ms + 150), 4).reason is None
    assert give(here, signed(901, epoch=started_ms, t_ns=NOW_NS + 500 * MS), 5).reason is Reason.OLD_EPOCH
    assert give(here, signed(0, epoch=started_ms + 160, t_ns=NOW_NS + 300 * MS), 5).reason is Reason.CLOCK_WENT_BACK
    assert here.agents["car1"].lost == 3


def test_a_number_far_above_the_newest_shuts_nobody_out() -> None:
    here = receiver()
    assert give(here, signed(1)).reason is None
    receipt = give(here, signed(2**53, t_ns=NOW_NS + 200 * MS), 2)
    assert receipt.reason is Reason.JUMPED
    assert "number 9007199254740992 after 1" in receipt.detail
    assert give(here, signed(2), 2).reason is None
    # As many numbers as an agent can have sent meanwhile are no jump: milliseconds as numbers are taken.
    assert give(here, signed(1202, t_ns=NOW_NS + 400 * MS), 4).reason is None
    assert give(here, signed(3_602_802, t_ns=NOW_NS + 3_601_000 * MS), 36_010).reason is None


def test_neither_a_new_key_nor_a_new_epoch_is_bound_by_the_numbers_before() -> None:
    following = SigningKey.generate("car1")
    here = receiver((CAR1, following))
    assert give(here, signed(2**53, t_ns=NOW_NS + 100 * MS)).reason is None
    assert give(here, signed(2), 2).reason is Reason.LATE
    assert give(here, signed(3, following), 3).reason is None
    assert give(here, signed(4, epoch=1), 4).reason is None


def test_the_greatest_epoch_shuts_an_agent_out_for_half_a_second_at_most() -> None:
    here = receiver()
    ahead_ns = NOW_NS + 599 * MS
    assert give(here, signed(1, t_ns=ahead_ns, epoch=2**53)).reason is Reason.EPOCH_AHEAD
    assert give(here, signed(1, t_ns=ahead_ns, epoch=ahead_ns // MS)).reason is None
    assert give(here, signed(6, epoch=ahead_ns // MS + 1), 6).reason is None


def with_gaps(data: bytes) -> memoryview:
    return np.repeat(np.frombuffer(data, np.uint8), 2).data[::2]


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview, with_gaps])
def test_any_bytes_are_taken(kind: Callable[[bytes], Any]) -> None:
    here, data = receiver(), kind(signed(1))
    receipt = give(here, data)
    assert (receipt.reason, receipt.agent, here.taken, here.refused.total()) == (None, "car1", 1, 0)
    assert give(here, data).reason is Reason.DOUBLED
    assert give(here, kind(bytes(MAX_BYTES + 1))).reason is Reason.TOO_LARGE


def test_an_older_version_is_refused_with_both_versions() -> None:
    receipt = give(receiver(), edited(_0=1))
    assert receipt.detail == "the version of a payload must be 4, got 1; install the same release on agent and receiver"


def test_what_an_honest_key_signs_is_checked_all_the_same() -> None:
    """A compromised agent has a good key: its content is bounded, and its number counts as used."""
    here = receiver()
    assert give(here, edited(_5=1)).reason is Reason.BAD_CONTENT
    assert give(here, edited(_5=1)).reason is Reason.DOUBLED
    assert here.agents["car1"].refused == {Reason.BAD_CONTENT: 1}


DATA = signed(view=samples.view())


@given(st.integers(0, len(DATA) - 1), st.integers(1, 255))
def test_no_changed_byte_passes(at: int, change: int) -> None:
    data = DATA[:at] + bytes([DATA[at] ^ change]) + DATA[at + 1 :]
    receipt = give(receiver(), data)
    assert receipt.message is None
    assert receipt.reason is not None


@given(st.binary(max_size=200))
def test_no_rubbish_passes(data: bytes) -> None:
    begin = len("d2844da201270448") // 2 + 9
    for each in (data, DATA[:begin] + data):
        assert give(receiver(), each).reason is Reason.MALFORMED


@given(st.binary(max_size=200))
def test_no_signed_rubbish_passes(payload: bytes) -> None:
    assert give(receiver(), sign(payload, CAR1)).message is None


@pytest.mark.parametrize("name", ["100 MB", "text", "an unknown key", "yesterday's", "a clock 3 s ahead"])
def test_what_needs_no_signature_is_refused_without_verifying_one(name: str, slow_verifying: list[str]) -> None:
    """A signature costs most of a message's time; ``benchmarks/messages.py`` says how much."""
    here = receiver()
    assert give(here, REFUSED[name][0]()).reason is REFUSED[name][1]
    assert not slow_verifying
    assert give(here, forged(1)).reason is Reason.FORGED
    assert slow_verifying == ["car1"]


def test_limits_are_checked() -> None:
    for name, value, words in (("max_bytes", 0, "lie in \\[1, 49152\\], got 0"), ("max_hz", 0, "be positive, got 0"),
                               ("max_ahead_s", -1.0, "not be negative")):  # fmt: skip
        with pytest.raises(ValueError, match=f"{name} must {words}"):
            ReceiverLimits(**{name: value})  # type: ignore[arg-type]
