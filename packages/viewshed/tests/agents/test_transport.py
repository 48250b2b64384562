"""Messages on the way: lost, late, doubled and in another order, the same for the same seed; and by zenoh."""

import datetime
import ipaddress
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from tests.agents import message_samples as samples

from viewshed.agents.receiver import Reason, Receiver
from viewshed.agents.signing import KeyRing, SigningKey, sign_message
from viewshed.agents.transport import QUEUE, Radio, RadioFaults, Tls, ZenohTransport
from viewshed.agents.view_message import MAX_BYTES

MS = 1_000_000


def radio(seed: int = 0, **faults: float) -> Radio:
    return Radio(np.random.default_rng(seed), RadioFaults(**faults))


def test_all_others_get_what_is_sent_and_the_sender_does_not() -> None:
    medium = radio()
    a, b, c = (medium.join(name) for name in "abc")
    a.send(b"one", 5)
    for end in (b, c):
        assert [(each.data, each.at_ns, each.link) for each in end.take(5)] == [(b"one", 5, "a")]
        assert end.take(5) == []
    assert a.take(5) == []
    c.close()
    a.send(b"two", 6)
    assert [each.data for each in b.take(6)] == [b"two"]
    assert c.take(6) == []


def arrivals(seed: int, **faults: float) -> list[tuple[int, bytes]]:
    """Numbers sent each 100 ms, and when they arrive."""
    medium = radio(seed, **faults)
    a, b = medium.join("a"), medium.join("b")
    for k in range(1000):
        a.send(k.to_bytes(2, "big"), 100 * MS * k)
        if k % 100 == 0:
            assert all(each.at_ns <= 100 * MS * k for each in b.take(-1))
    found = []
    for k in range(1200):
        found += [(each.at_ns, each.data) for each in b.take(100 * MS * k)]
    return found


def test_the_seed_decides_what_happens() -> None:
    faults = {"loss": 0.2, "jitter_s": 0.05, "doubled": 0.1}
    # More than QUEUE messages wait: the newest ones are there.
    assert arrivals(1, **faults) == arrivals(1, **faults)
    assert arrivals(1, **faults) != arrivals(2, **faults)


def test_faults_have_their_shares() -> None:
    medium = radio(3, loss=0.2, doubled=0.3, delay_s=0.05, jitter_s=0.01)
    a, b = medium.join("a"), medium.join("b")
    found = []
    for k in range(4000):
        a.send(k.to_bytes(2, "big"), 100 * MS * k)
        found += [(each.at_ns - 100 * MS * int.from_bytes(each.data, "big")) for each in b.take(100 * MS * k)]
    waits = np.array(found) / MS
    assert len(found) == pytest.approx(4000 * 0.8 * 1.3, rel=0.05)
    assert waits.min() >= 50.0
    assert waits.mean() == pytest.approx(60.0, abs=1.0)


def test_messages_overtake_each_other() -> None:
    medium = radio(4, reordered=0.2, reordered_s=0.25)
    a, b = medium.join("a"), medium.join("b")
    numbers = []
    for k in range(500):
        a.send(k.to_bytes(2, "big"), 100 * MS * k)
        numbers += [int.from_bytes(each.data, "big") for each in b.take(100 * MS * k)]
    behind = np.mean(np.diff(numbers) < 0)
    assert 0.1 < behind < 0.3


def test_what_waits_is_bounded() -> None:
    medium = radio()
    a, b = medium.join("a"), medium.join("b")
    for k in range(QUEUE + 10):
        a.send(k.to_bytes(2, "big"), k)
    found = b.take(10**9)
    assert len(found) == QUEUE
    assert b.dropped == 10
    assert int.from_bytes(found[0].data, "big") == 10


def test_names_and_faults_are_checked() -> None:
    medium = radio()
    medium.join("a")
    with pytest.raises(ValueError, match="a name of its own, got 'a' again"):
        medium.join("a")
    with pytest.raises(ValueError, match="1 to 32 letters"):
        medium.join("a/b")
    with pytest.raises(ValueError, match=r"loss must lie in \[0, 1\], got 2"):
        RadioFaults(loss=2)
    with pytest.raises(ValueError, match="delay_s must be finite and not negative, got nan"):
        RadioFaults(delay_s=float("nan"))


def test_over_a_bad_radio_each_message_is_taken_once_or_counted() -> None:
    """20 % loss, 200 ms of delay, jitter, doubles and reordering: what is taken is in order, and the books balance."""
    key = SigningKey.generate("car1")
    medium = radio(5, loss=0.2, delay_s=0.2, jitter_s=0.02, doubled=0.1, reordered=0.1)
    car, mast = medium.join("car1"), medium.join("mast")
    here, arrived, sequences = Receiver(KeyRing((key.verifying(),)), start_ns=samples.NOW_NS - 1000 * MS), 0, []
    small = {"view": None, "ground": None, "detections": None, "report": None, "tracks": None}
    for k in range(200):
        now_ns = samples.NOW_NS + 100 * MS * k
        car.send(sign_message(samples.message(k, "car1", now_ns, **small), key), now_ns)
        for each in mast.take(now_ns):
            arrived += 1
            receipt = here.receive(each.data, each.at_ns, each.link)
            if receipt.message is not None:
                sequences.append(receipt.message.sequence)
    assert sequences == sorted(set(sequences))
    assert here.taken + here.refused.total() == arrived
    assert set(here.refused) == {Reason.DOUBLED, Reason.LATE}
    assert here.agents["car1"].lost == sequences[-1] + 1 - sequences[0] - len(sequences)
    assert len(sequences) > 130


def free_endpoint() -> str:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{taken.getsockname()[1]}"


def await_messages(end: ZenohTransport, count: int, seconds: float = 10.0) -> list[bytes]:
    found: list[bytes] = []
    until = time.monotonic() + seconds
    while len(found) < count and time.monotonic() < until:
        found += [each.data for each in end.take(0)]
        time.sleep(0.01)
    return found


def reaches(a: ZenohTransport, b: ZenohTransport, data: bytes, seconds: float) -> bool:
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        a.send(data, 0)
        if data in [each.data for each in b.take(0)]:
            return True
        time.sleep(0.05)
    return False


_OTHER = """
import sys, time
from viewshed.agents.transport import ZenohTransport
end = ZenohTransport("other", connect=(sys.argv[1],))
until = time.monotonic() + 20
while time.monotonic() < until:
    for each in end.take(0):
        end.send(b"echo " + each.data, 0)
    time.sleep(0.01)
"""


def test_zenoh_carries_messages_between_two_processes() -> None:
    pytest.importorskip("zenoh", reason="needs eclipse-zenoh")
    endpoint = free_endpoint()
    here = ZenohTransport("here", listen=(endpoint,))
    other = subprocess.Popen([sys.executable, "-c", _OTHER, endpoint])
    try:
        found: list[bytes] = []
        until = time.monotonic() + 15
        while not found and time.monotonic() < until:
            here.send(b"hello", 0)
            found = await_messages(here, 1, 0.2)
        assert set(found) == {b"echo hello"}
        assert not any(each.link for each in here.take(0))
    finally:
        other.kill()
        other.wait()
        here.close()


def test_zenoh_drops_what_is_too_large() -> None:
    pytest.importorskip("zenoh", reason="needs eclipse-zenoh")
    endpoint = free_endpoint()
    a, b = ZenohTransport("a", listen=(endpoint,)), ZenohTransport("b", connect=(endpoint,))
    try:
        assert reaches(a, b, b"before", 15.0)
        assert b.dropped == 0
        until = time.monotonic() + 15.0
        while b.dropped == 0 and time.monotonic() < until:
            a.send(bytes(MAX_BYTES + 1), 0)
            time.sleep(0.05)
        assert b.dropped > 0
        assert reaches(a, b, b"after", 15.0)
        assert a.take(0) == []
    finally:
        a.close()
        b.close()


def test_zenoh_says_what_it_cannot_open() -> None:
    pytest.importorskip("zenoh", reason="needs eclipse-zenoh")
    with pytest.raises(OSError, match="zenoh: "):
        ZenohTransport("a", connect=("smoke/signals",))
    with pytest.raises(ValueError, match="each part of a topic must be 1 to 32 letters"):
        ZenohTransport("a", topic="viewshed/**")


def write_certificates(folder: Path) -> Tls:
    """Write an authority and a certificate by it for 127.0.0.1, both for servers and clients."""
    now = datetime.datetime.now(datetime.UTC)
    authority_key, key = ec.generate_private_key(ec.SECP256R1()), ec.generate_private_key(ec.SECP256R1())
    issuer, subject = (x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)]) for name in ("authority", "car"))

    def certificate(name: x509.Name, public: Any, *extensions: tuple[x509.ExtensionType, bool]) -> bytes:
        builder = x509.CertificateBuilder().subject_name(name).issuer_name(issuer).public_key(public)
        builder = builder.serial_number(x509.random_serial_number())
        builder = builder.not_valid_before(now - datetime.timedelta(days=1))
        builder = builder.not_valid_after(now + datetime.timedelta(days=1))
        for extension, critical in extensions:
            builder = builder.add_extension(extension, critical)
        return builder.sign(authority_key, hashes.SHA256()).public_bytes(Encoding.PEM)

    tls = Tls(folder / "authority.pem", folder / "car.pem", folder / "car.key")
    tls.authority.write_bytes(
        certificate(issuer, authority_key.public_key(), (x509.BasicConstraints(ca=True, path_length=None), True))
    )
    usage = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH])
    address = x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1"))])
    tls.certificate.write_bytes(certificate(subject, key.public_key(), (usage, False), (address, False)))
    tls.key.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    tls.key.chmod(0o600)
    return tls


def test_zenoh_links_by_tls_and_refuses_who_has_no_certificate(tmp_path: Path) -> None:
    pytest.importorskip("zenoh", reason="needs eclipse-zenoh")
    endpoint = free_endpoint().replace("tcp/", "tls/")
    friends, strangers = tmp_path / "friends", tmp_path / "strangers"
    friends.mkdir()
    strangers.mkdir()
    tls = write_certificates(friends)
    here = ZenohTransport("here", listen=(endpoint,), tls=tls)
    friend = ZenohTransport("friend", connect=(endpoint,), tls=tls)
    try:
        assert reaches(friend, here, b"friend", 10.0)
        own = write_certificates(strangers)
        try:
            stranger = ZenohTransport("stranger", connect=(endpoint,), tls=Tls(tls.authority, own.certificate, own.key))
        except OSError:
            return
        assert not reaches(stranger, here, b"stranger", 1.5)
        stranger.close()
    finally:
        friend.close()
        here.close()
