"""Each bad message is refused for its own counted reason, and the others go on."""

import time
from collections.abc import Callable
from typing import Any

import cbor2
import numpy as np
import pytest
from cwt import COSE, COSEKey
from hypothesis import given
from hypothesis import strategies as st
from tests.messages import message_samples as samples

from viewshed import BevGrid
from viewshed.messages.receiver import SEQUENCES_KEPT, Reason, Receipt, Receiver, ReceiverLimits
from viewshed.messages.signing import (
    KeyRing,
    SigningKey,
    VerifyingKey,
    is_signed_by,
    open_envelope,
    read_heading,
    sign,
    sign_message,
)
from viewshed.messages.view_message import MAX_BYTES, decode_message, encode_message

NOW_NS = samples.NOW_NS
MS = 1_000_000
CAR1, CAR2, MAST, FORGER = (SigningKey.generate(name) for name in ("car1", "car2", "mast", "car1"))


def signed(sequence: int = 1, key: SigningKey = CAR1, t_ns: int | None = None, **changes: Any) -> bytes:
    """A small signed message; without a time it is sent 100 ms after the one before."""
    small: dict[str, Any] = {"view": None, "inner": None, "detections": None, "report": None}
    at_ns = NOW_NS + 100 * MS * sequence if t_ns is None else t_ns
    return sign_message(samples.message(sequence, key.agent, at_ns, **(small | changes)), key)


def receiver(**options: Any) -> Receiver:
    return Receiver(KeyRing((CAR1.verifying(), CAR2.verifying())), **options)


def give(to: Receiver, data: bytes, sequence: int = 1, late_ms: int = 10, link: str = "") -> Receipt:
    """Receive a message some time after that number was sent."""
    return to.receive(data, NOW_NS + 100 * MS * sequence + late_ms * MS, link)


def test_an_honest_message_is_taken() -> None:
    here = receiver()
    receipt = give(here, signed(view=samples.view()))
    assert receipt.reason is None
    assert receipt.agent == "car1"
    assert receipt.message is not None
    assert receipt.message.view is not None
    assert (here.taken, here.refused.total()) == (1, 0)
    assert here.agents["car1"].newest == 1


def test_the_envelope_is_cose_as_others_read_it() -> None:
    data = signed()
    key = COSEKey.new({1: 1, 3: -8, -1: 6, -2: CAR1.public, 2: CAR1.verifying().key_id})
    assert COSE.new().decode(data, keys=key) == open_envelope(data).payload
    tag = cbor2.loads(data)
    assert tag.tag == 18
    assert cbor2.loads(tag.value[0]) == {1: -8, 4: CAR1.verifying().key_id}
    assert tag.value[1] == {}
    heading = read_heading(open_envelope(data).payload)
    assert (heading.agent, heading.sequence, heading.t_ns) == ("car1", 1, NOW_NS + 100 * MS)


def forged(at: int) -> bytes:
    """An honest message with one byte changed, counted from the end."""
    data = bytearray(signed())
    data[-at] ^= 1
    return bytes(data)


def edited(**changes: Any) -> bytes:
    """A signed payload whose bytes the message class would not write."""
    fields = cbor2.loads(encode_message(samples.message(1, "car1", NOW_NS + 100 * MS, view=None, inner=None)))
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
    "another version": (lambda: edited(_0=2), Reason.MALFORMED),
    "no name": (lambda: edited(_1=""), Reason.MALFORMED),
    "a name of a number": (lambda: edited(_1=5), Reason.MALFORMED),
    "a sequence of text": (lambda: edited(_2="1"), Reason.MALFORMED),
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
    "300 tracks": (lambda: many_tracks(300), Reason.BAD_CONTENT),
    "10,000 tracks": (lambda: many_tracks(10_000), Reason.TOO_LARGE),
}  # fmt: skip


def many_tracks(count: int) -> bytes:
    """A signed message of more tracks than the message class would write."""
    payload = encode_message(samples.message(1, "car1", NOW_NS + 100 * MS, view=None, inner=None))
    columns = cbor2.loads(payload)[10]
    held = len(samples.message().tracks or ())
    many = {
        key: cbor2.CBORTag(column.tag, column.value[: len(column.value) // held] * count)
        if isinstance(column, cbor2.CBORTag) else column[: len(column) // held] * count
        for key, column in columns.items()
    }  # fmt: skip
    return edited(_10=many)


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


def test_a_receiver_may_take_late_messages_once() -> None:
    here = receiver(limits=ReceiverLimits(take_late=True))
    sent = {sequence: signed(sequence) for sequence in range(1, 5)}
    for sequence in (1, 4, 2, 2, 3):
        give(here, sent[sequence], 4)
    assert here.taken == 4
    assert here.refused == {Reason.DOUBLED: 1}
    assert here.agents["car1"].lost == 0


def test_what_lies_farther_back_than_is_remembered_is_late() -> None:
    here = receiver(limits=ReceiverLimits(take_late=True, max_age_s=60.0))
    newest = SEQUENCES_KEPT + 5
    give(here, signed(newest), newest)
    assert give(here, signed(newest - SEQUENCES_KEPT), newest).reason is Reason.LATE
    assert give(here, signed(newest - SEQUENCES_KEPT + 1), newest).reason is None
    assert len(here.agents["car1"].signatures) <= SEQUENCES_KEPT


def test_two_senders_of_one_name_are_noticed() -> None:
    here = receiver()
    assert give(here, signed(1)).reason is None
    assert give(here, signed(1, tracks=samples.tracks(2))).reason is Reason.TWO_OF_ONE_NAME
    assert here.agents["car1"].refused == {Reason.TWO_OF_ONE_NAME: 1}
    # A forger cannot make it look so.
    data = bytearray(signed(1, tracks=samples.tracks(2)))
    data[-1] ^= 1
    assert give(here, bytes(data)).reason is Reason.FORGED


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
    data = bytearray(signed(2**40, t_ns=NOW_NS + 300 * MS))
    data[-1] ^= 1
    for _ in range(50):
        assert give(here, bytes(data)).reason is Reason.FORGED
    assert give(here, signed(1)).reason is None
    assert here.agents["car1"].newest == 1


def test_a_link_of_forged_messages_is_muted_and_other_links_are_not() -> None:
    here = receiver(limits=ReceiverLimits(forged_burst=5, forged_per_s=1.0))
    reasons = [give(here, forged(1), link="stranger").reason for _ in range(9)]
    assert reasons == [Reason.FORGED] * 5 + [Reason.NOISY_LINK] * 4
    assert give(here, signed(1), link="friend").reason is None
    assert give(here, signed(2), 2, link="").reason is None
    # After a second it is listened to again, for one forged message.
    assert give(here, signed(14), 14, link="stranger").reason is None


def test_links_are_bounded_in_number() -> None:
    here = receiver()
    for k in range(1000):
        give(here, b"", link=f"link {k}")
    assert len(here._links) <= 256


def test_keys_are_rotated() -> None:
    """The next key is valid from 300 ms on, the old one until 500 ms; both until the old one is removed."""
    following = SigningKey.generate("car1")
    old = CAR1.verifying(until_ns=NOW_NS + 500 * MS)
    here = Receiver(KeyRing((old, following.verifying(from_ns=NOW_NS + 300 * MS))))
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
    with pytest.raises(ValueError, match="valid from some time until later"):
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


def test_yesterdays_messages_are_refused_by_a_receiver_that_remembers_nothing() -> None:
    recorded = [signed(sequence) for sequence in range(1, 6)]
    here = receiver()
    for data in recorded:
        assert here.receive(data, NOW_NS + 86_400_000 * MS).reason is Reason.TOO_OLD


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


def test_limits_are_checked() -> None:
    with pytest.raises(ValueError, match=r"max_bytes must lie in \[1, 49152\], got 0"):
        ReceiverLimits(max_bytes=0)
    with pytest.raises(ValueError, match="max_hz must be positive, got 0"):
        ReceiverLimits(max_hz=0)
    with pytest.raises(ValueError, match="max_ahead_s must not be negative"):
        ReceiverLimits(max_ahead_s=-1.0)


def least_s(call: Callable[[], object], times: int = 200) -> float:
    found = []
    for _ in range(times):
        begin = time.perf_counter()
        call()
        found.append(time.perf_counter() - begin)
    return min(found)


@pytest.mark.parametrize("name", ["100 MB", "text", "an unknown key", "yesterday's", "a clock 3 s ahead"])
def test_what_needs_no_signature_is_refused_within_a_tenth_of_a_millisecond(name: str) -> None:
    here, data = receiver(), REFUSED[name][0]()
    assert least_s(lambda: give(here, data)) < 1e-4


def test_what_needs_its_signature_is_refused_within_half_a_millisecond() -> None:
    here, data = receiver(), forged(1)
    assert least_s(lambda: give(here, data)) < 5e-4


def test_a_small_message_is_verified_and_decoded_within_a_millisecond() -> None:
    payload = open_envelope(DATA).payload
    assert is_signed_by(DATA, CAR1.verifying())
    key = CAR1.verifying()
    assert least_s(lambda: (is_signed_by(DATA, key), decode_message(payload))) < 1e-3
