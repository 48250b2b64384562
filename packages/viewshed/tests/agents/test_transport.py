"""Messages on the way by zenoh: between processes, bounded, and over TLS."""

import datetime
import ipaddress
import socket
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from viewshed.agents.transport import Tls, ZenohTransport
from viewshed.agents.view_message import MAX_BYTES

pytest.importorskip("zenoh", reason="needs eclipse-zenoh")


def free_endpoint() -> str:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{taken.getsockname()[1]}"


def heard(a: ZenohTransport, b: ZenohTransport, data: bytes, seconds: float, awaited: bytes = b"") -> set[bytes]:
    """Return what one end hears while the other sends, until it is what is awaited: what was sent, or another."""
    found, until = set[bytes](), time.monotonic() + seconds
    while (awaited or data) not in found and time.monotonic() < until:
        a.send(data, 0)
        time.sleep(0.05)
        found |= {each.data for each in b.take(0)}
    return found


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
    endpoint = free_endpoint()
    with closing(ZenohTransport("here", listen=(endpoint,))) as here:
        other = subprocess.Popen([sys.executable, "-c", _OTHER, endpoint])
        try:
            assert heard(here, here, b"hello", 15.0, b"echo hello") == {b"echo hello"}
            assert not any(each.link for each in here.take(0))
        finally:
            other.kill()
            other.wait()


def test_zenoh_drops_what_is_too_large() -> None:
    endpoint = free_endpoint()
    with (
        closing(ZenohTransport("a", listen=(endpoint,))) as a,
        closing(ZenohTransport("b", connect=(endpoint,))) as b,
    ):
        assert b"before" in heard(a, b, b"before", 15.0)
        assert b.dropped == 0
        until = time.monotonic() + 15.0
        while b.dropped == 0 and time.monotonic() < until:
            a.send(bytes(MAX_BYTES + 1), 0)
            time.sleep(0.05)
        assert b.dropped > 0
        assert b"after" in heard(a, b, b"after", 15.0)
        assert a.take(0) == []


def test_zenoh_says_what_it_cannot_open() -> None:
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
    endpoint = free_endpoint().replace("tcp/", "tls/")
    friends, strangers = tmp_path / "friends", tmp_path / "strangers"
    friends.mkdir()
    strangers.mkdir()
    tls = write_certificates(friends)
    with (
        closing(ZenohTransport("here", listen=(endpoint,), tls=tls)) as here,
        closing(ZenohTransport("friend", connect=(endpoint,), tls=tls)) as friend,
    ):
        assert b"friend" in heard(friend, here, b"friend", 10.0)
        own = write_certificates(strangers)
        try:
            stranger = ZenohTransport("stranger", connect=(endpoint,), tls=Tls(tls.authority, own.certificate, own.key))
        except OSError:
            return
        assert b"stranger" not in heard(stranger, here, b"stranger", 1.5)
        stranger.close()
