"""A message comes back as it was sent, fits its schema, and says nothing that it must not."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cbor2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.agents import message_samples as samples

from viewshed.agents import cbor
from viewshed.agents.view_message import FIELDS, MAX_BYTES, MAX_DETECTIONS, SensorFacts, decode_message, encode_message
from viewshed.detections import Detections, ObjectKind

ROOT = Path(__file__).resolve().parents[4]


OPTIONAL = ("view", "ground", "detections", "report")


def test_everything_comes_back() -> None:
    sent = samples.message()
    found = decode_message(encode_message(sent))
    for name in ("agent", "epoch", "sequence", "t_ns", "frame", "sensor"):
        assert getattr(found, name) == getattr(sent, name), name
    assert np.abs(found.world_from_level.as_matrix() - sent.world_from_level.as_matrix()).max() < 1e-12
    assert np.allclose(found.pose_covariance, sent.pose_covariance, rtol=1e-6)
    assert (found.view.state == sent.view.state).all()
    assert (found.view.visible() == sent.view.visible()).all()
    assert (found.view.grid, found.view.target, found.view.method) == (samples.GRID, sent.view.target, "shadow_map")
    assert (found.view.agent, found.view.t_ns) == ("car1", samples.NOW_NS)
    assert found.view.world_from_level is found.world_from_level
    places = np.random.default_rng(0).uniform(-14.0, 14.0, (200, 2))
    places = places[np.abs(places[:, 1] - 3.0) > 1.5]  # nodes lie a meter apart, and the step between two of them
    assert np.allclose(found.ground.at(places), sent.ground.at(places), atol=0.06)
    for name in ("boxes", "kinds", "returns"):
        assert np.allclose(getattr(found.detections, name), getattr(sent.detections, name), atol=1e-5)
    for name in ("monitor", "score", "threshold", "p_value", "degraded", "degraded_p_value"):
        assert getattr(found.report, name) == getattr(sent.report, name)
    assert np.flatnonzero(found.report.suspect).tolist() == [0, 5, 71]


@pytest.mark.parametrize("left_out", [OPTIONAL, *[(name,) for name in OPTIONAL]])
def test_what_an_agent_does_not_have_it_leaves_out(left_out: tuple[str, ...]) -> None:
    found = decode_message(encode_message(samples.message(**dict.fromkeys(left_out))))
    for name in OPTIONAL:
        assert (getattr(found, name) is None) == (name in left_out)
    # No detections are something else than none sent.
    assert len(decode_message(encode_message(samples.message(detections=Detections.none()))).detections) == 0


def test_deviations_are_sent_where_there_are_any() -> None:
    found = decode_message(encode_message(samples.message(view=samples.view(with_std=True))))
    assert np.isfinite(found.view.std).all()
    assert np.isnan(decode_message(encode_message(samples.message())).view.std).all()


def test_payloads_are_deterministic_and_what_cbor2_reads() -> None:
    payload = encode_message(samples.message())
    assert payload == encode_message(samples.message())
    assert payload == cbor2.dumps(cbor2.loads(payload), canonical=True)
    assert list(cbor2.loads(payload)) == list(range(len(FIELDS)))


def test_messages_fit_their_schema() -> None:
    pycddl = pytest.importorskip("pycddl", reason="needs pycddl")
    schema = pycddl.Schema((ROOT / "docs" / "view_message.cddl").read_text(encoding="utf-8"))
    full = encode_message(samples.message(view=samples.view(with_std=True)))
    schema.validate_cbor(full)
    schema.validate_cbor(encode_message(samples.message(**dict.fromkeys(OPTIONAL))))
    nothing_known = samples.message(sensor=SensorFacts("of our own"))
    schema.validate_cbor(encode_message(nothing_known))
    # The schema is no empty promise: without a field that must be there, or with one of another type, it objects.
    for key in range(7):
        fields = cbor2.loads(full)
        del fields[key]
        with pytest.raises(pycddl.ValidationError, match="missing key"):
            schema.validate_cbor(cbor2.dumps(fields))


def bad(change: dict[int, Any], **fields: Any) -> bytes:
    """A payload with some of its fields replaced, deterministic all the same."""
    return dumped(cbor.loads(encode_message(samples.message(**fields))) | change)


def dumped(fields: Any) -> bytes:
    data: bytes = cbor2.dumps(fields, canonical=True, default=typed)
    return data


def typed(encoder: Any, value: Any) -> None:
    tags = {"u1": 64, "i4": 78, "i8": 79, "f4": 85, "f8": 86}
    encoder.encode(cbor2.CBORTag(tags[value.dtype.str[1:]], value.tobytes()))


def changed(key: int, column: int, at: int, value: float) -> bytes:
    """A payload with one number of a typed array replaced."""
    fields = cbor.loads(encode_message(samples.message()))
    fields[key][column] = array = fields[key][column].copy()
    array[at] = value
    return dumped(fields)


VIEW, FOUND = (cbor.loads(encode_message(samples.message()))[key] for key in (7, 9))
BAD: dict[str, tuple[Callable[[], bytes], str]] = {
    "version": (lambda: bad({0: 1}), "whose version is 4"),
    "no map": (lambda: b"\x80", "must be a map"),
    "agent": (lambda: bad({1: "a b"}), "agent must be 1 to 32 letters"),
    "agent of bytes": (lambda: bad({1: b"a"}), "must have text here"),
    "long agent": (lambda: bad({1: "a" * 33}), "agent must be 1 to 32 letters"),
    "sequence": (lambda: bad({2: [0, 2**53 + 1]}), "sequence must lie in"),
    "negative sequence": (lambda: bad({2: [0, -1]}), "sequence must lie in"),
    "sequence in text": (lambda: bad({2: [0, "1"]}), "must have a whole number"),
    "sequence alone": (lambda: bad({2: 1}), "must have the fields of its schema"),
    "epoch": (lambda: bad({2: [2**53 + 1, 1]}), "epoch must lie in"),
    "true epoch": (lambda: bad({2: [True, 1]}), "must have a whole number"),
    "true time": (lambda: bad({3: True}), "must have a whole number"),
    "time": (lambda: bad({3: 2**63}), "t_ns must lie in"),
    "frame": (lambda: bad({4: ""}), "frame must be 1 to 32 letters"),
    "pose": (lambda: bad({5: []}), "types of its schema"),
    "pose of another type": (lambda: changed(5, 0, 0, np.nan), "must be finite"),
    "no rotation": (lambda: changed(5, 0, 3, 7.0), "norm 1"),
    "NaN covariance": (lambda: changed(5, 1, 0, np.nan), "of car1 must be .* finite numbers, got nan"),
    "negative variance": (lambda: changed(5, 1, 0, -1.0), "must have no negative eigenvalue"),
    "sensor": (lambda: bad({6: ["", 1.0, 1.0]}), "name of a sensor"),
    "whole height": (lambda: bad({6: ["a", 1, 1.0]}), "must have a float"),
    "two facts": (lambda: bad({6: ["a", 1.0]}), "not enough values"),
    "view of a list": (lambda: bad({7: [1]}), "fields of its schema"),
    "another grid": (lambda: bad({7: VIEW | {0: [60, 16.0, 0.0, 0.0]}}), "damaged, or not of this grid"),
    "huge grid": (lambda: bad({7: VIEW | {0: [4096, 16.0, 0.0, 0.0]}}), "at most 512 cells"),
    "grid of nothing": (lambda: bad({7: VIEW | {0: [64, float("nan"), 0.0, 0.0]}}), "half_extent_m must be positive"),
    "threshold": (lambda: bad({7: VIEW | {2: 1.5}}), "threshold must lie in"),
    "NaN threshold": (lambda: bad({7: VIEW | {2: float("nan")}}), "threshold must lie in"),
    "target": (lambda: bad({7: VIEW | {1: ["car", 0.0, 1.0, 1.0, 5]}}), "length_m must lie in"),
    "deviations claimed": (lambda: bad({7: VIEW | {4: True}}), "damaged"),
    "code": (lambda: bad({7: VIEW | {5: b"rubbish"}}), "damaged"),
    "ground": (lambda: bad({8: [16.0, bytes(2046)]}), "32 times 32 heights"),
    "ground of nothing": (lambda: bad({8: [float("nan"), bytes(2048)]}), "half_extent_m must be positive"),
    "ground text": (lambda: bad({8: [16.0, "a"]}), "must have bytes here"),
    "detections": (lambda: changed(9, 0, 3, -1.0), "positive sizes"),
    "returns of detections": (lambda: changed(9, 2, 0, -1), "returns must be counts of 0 or more, got -1"),
    "uneven detections": (lambda: bad({9: [FOUND[0][:-1], *FOUND[1:]]}), "7 numbers for each box"),
    "report": (lambda: bad({10: ["a", 1.0, 1.0, 2.0, False, 1.0, bytes(9)]}), "p_value must lie in"),
    "report without sectors": (lambda: bad({10: ["a", 1.0, 1.0, 1.0, False, 1.0, b""]}), "must have 72 sectors, got 0"),
    "another field": (lambda: bad({11: 1}), r"keys of a payload must lie in \[0, 10\], got 11"),
    "a field missing": (lambda: cbor2.dumps({0: 4, 1: "a"}), "must have the fields of its schema"),
    "too many bytes": (lambda: bytes(MAX_BYTES + 1), "at most 49152 bytes"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_what_a_message_must_not_say_is_refused(name: str) -> None:
    make, match = BAD[name]
    payload = make()
    with pytest.raises(ValueError, match=match):
        decode_message(payload)


def test_a_class_that_nobody_knows_costs_no_view() -> None:
    found = decode_message(changed(9, 1, 0, 9))
    assert found.view is not None
    assert found.detections.kinds.tolist()[:2] == [ObjectKind.OTHER, samples.message().detections.kinds[1]]


def test_ten_thousand_detections_are_refused_before_they_are_looked_at() -> None:
    boxes, kinds, returns = cbor.loads(encode_message(samples.message()))[9]
    with pytest.raises(ValueError, match="at most 49152 bytes"):
        decode_message(bad({9: [each.repeat(5000) for each in (boxes, kinds, returns)]}))
    with pytest.raises(ValueError, match="at most 512 detections, got 600"):
        decode_message(bad({9: [each.repeat(300) for each in (boxes, kinds, returns)]}))
    found = samples.message().detections.take(np.zeros(MAX_DETECTIONS + 1, np.intp))
    with pytest.raises(ValueError, match="at most 512 detections, got 513"):
        samples.message(detections=found)


def test_values_are_checked_when_a_message_is_made() -> None:
    with pytest.raises(ValueError, match="agent must be 1 to 32 letters"):
        samples.message(agent="a/b")
    with pytest.raises(ValueError, match=r"\(6, 6\) finite numbers, got shape \(3, 3\)"):
        samples.message(pose_covariance=np.eye(3))
    uneven = np.eye(6)
    uneven[0, 1] = 0.5
    with pytest.raises(ValueError, match="must be symmetric"):
        samples.message(pose_covariance=uneven)
    with pytest.raises(ValueError, match="height must be at most 30 m, or NaN, got 31"):
        SensorFacts("a", height_m=31.0)


@given(st.binary(max_size=300))
def test_rubbish_is_refused(payload: bytes) -> None:
    with pytest.raises(ValueError, match="payload"):
        decode_message(payload)


FULL = encode_message(samples.message())


@given(st.integers(0, len(FULL) - 1), st.integers(0, 255))
def test_a_changed_byte_is_refused_or_says_something_valid(at: int, value: int) -> None:
    payload = FULL[:at] + bytes([value]) + FULL[at + 1 :]
    try:
        found = decode_message(payload)
    except ValueError:
        return
    assert decode_message(encode_message(found)).sequence == found.sequence


@given(st.integers(0, len(FULL) - 1))
def test_a_message_that_is_cut_off_is_refused(end: int) -> None:
    with pytest.raises(ValueError, match=r"payload|array"):
        decode_message(FULL[:end])


PLAIN = st.recursive(
    st.integers(-(2**63), 2**63) | st.binary(max_size=20) | st.text(max_size=20) | st.booleans() | st.floats(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.integers(0, 300), inner, max_size=4),
    max_leaves=10,
)


def depth_of(value: Any) -> int:
    if isinstance(value, dict | list):
        return 1 + max(map(depth_of, value.values() if isinstance(value, dict) else value), default=0)
    return 0


@settings(max_examples=40)
@given(PLAIN.filter(lambda value: depth_of(value) <= cbor.MAX_DEPTH))
def test_the_reader_reads_what_cbor2_writes(value: Any) -> None:
    data = cbor2.dumps(value, canonical=True)
    assert repr(cbor.loads(data)) == repr(cbor2.loads(data))
    assert cbor.dumps(value) == data


@given(st.binary(max_size=40))
def test_what_the_reader_takes_is_deterministic(data: bytes) -> None:
    try:
        value = cbor.loads(data)
    except ValueError:
        return
    if not isinstance(value, np.ndarray):
        assert repr(cbor.loads(cbor.dumps(value))) == repr(value)
    assert cbor.dumps(value) == data


NOT_CBOR = [
    ("", "end within an item"), ("18", "end within an item"), ("1817", "shortest encoding"),
    ("190017", "shortest encoding"),
    ("9f01ff", "must be given"), ("fb3ff0000000000000", "shortest encoding"), ("fa3f800000", "shortest encoding"),
    ("fa7fc00000", "half-precision"), ("f97e01", "half-precision"), ("f6", "false, true or a float, got 22"),
    ("a201010002", "unsigned and ascend"),
    ("a2010101020000", "unsigned and ascend"), ("a16161f4", "unsigned and ascend"),
    ("a120f4", "unsigned and ascend"), ("61ff", "UTF-8"),
    ("6261", "end within a string"), ("c001", "tags in a payload"),
    ("d85543000000", "byte string of whole numbers"), ("d85501", "byte string of whole numbers"),
    ("d8405a7fffffff", "byte string of whole numbers"), ("9a7fffffff", "at most 512 items"),
    ("8181818181", "at most 4 arrays and maps deep"), ("0000", "1 more bytes"), ("d81c01", "tags in a payload"),
]  # fmt: skip


@pytest.mark.parametrize(("data", "match"), NOT_CBOR)
def test_what_is_not_deterministic_cbor_is_refused(data: str, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        cbor.loads(bytes.fromhex(data))
