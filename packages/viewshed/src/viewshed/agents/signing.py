"""Signed messages: COSE_Sign1 (RFC 9052) with Ed25519, by cwt; and the keys of the agents that one believes.

The envelope has one form: tag 18, protected header {1: -8, 4: key id}, no unprotected header, payload, signature. It is
taken apart by hand before cwt sees it, so that nothing but the bytes to be verified is read of what nobody has signed.
"""

from __future__ import annotations

import hashlib
import os
import stat
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from viewshed._extras import needed_for
from viewshed.agents import cbor
from viewshed.agents.ed25519_points import has_large_order
from viewshed.agents.view_message import MAX_BYTES, VERSION, ViewMessage, encode_message, require_name

KEY_ID_BYTES = 8
SIGNATURE_BYTES = 64

FOREVER_NS = 2**63 - 1

_ED25519 = {1: 1, 3: -8, -1: 6}  # key type OKP, algorithm EdDSA, curve Ed25519

# COSE_Sign1 of four parts; a protected header of 13 bytes: EdDSA, and a key id of 8 bytes.
_BEFORE_ID = bytes.fromhex("d2844da201270448")
_AFTER_ID = bytes.fromhex("a0")
_BEFORE_SIGNATURE = bytes.fromhex("5840")


_is_strong = lru_cache(maxsize=256)(has_large_order)  # a key is made again with each message that it signs


@dataclass(frozen=True)
class VerifyingKey:
    """The public key of one agent.

    Raises:
        ValueError: the key is none, or one that anybody can sign for; or it is valid at no time.
    """

    agent: str  # whose key it is
    public: bytes  # 32 bytes
    from_ns: int = 0  # time of the first message that it may sign, nanoseconds since 1970
    until_ns: int = FOREVER_NS  # time of the last

    def __post_init__(self) -> None:
        require_name("agent", self.agent)
        if len(self.public) != 32:
            raise ValueError(f"a public key must have 32 bytes, got {len(self.public)}")
        if not _is_strong(self.public):
            raise ValueError(
                "a public key must be the encoding of a point of Ed25519 of large order, "
                f"got {self.public.hex()} of agent {self.agent!r}; make a new key"
            )
        if not 0 <= self.from_ns <= self.until_ns:
            raise ValueError(f"a key must be valid from some time until later, got {self.from_ns} to {self.until_ns}")

    @property
    def key_id(self) -> bytes:
        """The first bytes of the SHA-256 of the public key."""
        return hashlib.sha256(self.public).digest()[:KEY_ID_BYTES]

    @cached_property
    def cose(self) -> Any:
        """The key as cwt takes it."""
        with needed_for("reading signed messages"):
            from cwt import COSEKey
        return COSEKey.new({**_ED25519, -2: self.public, 2: self.key_id})


@dataclass(frozen=True)
class SigningKey:
    """The private key of one agent: 32 bytes that only it has."""

    agent: str
    private: bytes = field(repr=False)

    @classmethod
    def generate(cls, agent: str) -> SigningKey:
        """Return a new key from the system's source of randomness."""
        with needed_for("making a key"):
            from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
        return cls(agent, Ed25519PrivateKey.generate().private_bytes_raw())

    @cached_property
    def public(self) -> bytes:
        """The public key, 32 bytes."""
        with needed_for("signing messages"):
            from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
        return Ed25519PrivateKey.from_private_bytes(self.private).public_key().public_bytes_raw()

    def verifying(self, from_ns: int = 0, until_ns: int = FOREVER_NS) -> VerifyingKey:
        """Return the public key, to be given to others."""
        return VerifyingKey(self.agent, self.public, from_ns, until_ns)

    @cached_property
    def cose(self) -> Any:
        """The key as cwt takes it."""
        with needed_for("signing messages"):
            from cwt import COSEKey
        return COSEKey.new({**_ED25519, -2: self.public, -4: self.private, 2: self.verifying().key_id})


def read_signing_key(agent: str, path: str) -> SigningKey:
    """Return the private key of an agent in a file: 64 hexadecimal digits.

    Raises:
        ValueError: the file holds something else, or others than its owner may read or write it.
        OSError: it cannot be read.
    """
    require_private(path)
    return SigningKey(agent, _key_bytes(path))


def read_verifying_keys(agents: list[str], paths: list[str]) -> tuple[VerifyingKey, ...]:
    """Return the public keys of agents, a file of 64 hexadecimal digits each.

    Raises:
        ValueError: there is another number of files, or one holds something else or a key that anybody can sign for.
        OSError: one cannot be read.
    """
    if len(agents) != len(paths) or len(set(agents)) != len(agents) or not agents:
        raise ValueError(f"keys must be one file for each agent, got {len(paths)} for {', '.join(agents) or 'none'}")
    return tuple(VerifyingKey(agent, _key_bytes(path)) for agent, path in zip(agents, paths, strict=True))


def require_private(path: str | Path) -> None:
    """Raise ValueError where others than its owner may read or write the file of a private key."""
    mode = stat.S_IMODE(Path(path).stat().st_mode)
    if os.name == "posix" and mode & 0o077:
        raise ValueError(f"a private key must be its owner's alone, got mode {mode:04o} of {path}; chmod 600 {path}")


def _key_bytes(path: str) -> bytes:
    text = Path(path).read_text(encoding="ascii", errors="replace").strip()
    try:
        found = bytes.fromhex(text)
    except ValueError:
        found = b""
    if len(found) != 32:
        raise ValueError(f"a key must be 64 hexadecimal digits, got {len(text)} characters in {path}")
    return found


class KeyRing:
    """The public keys that a receiver believes, by their ids. An agent may have several: the old one and the next."""

    def __init__(self, keys: tuple[VerifyingKey, ...] = ()) -> None:
        self._keys: dict[bytes, VerifyingKey] = {}
        for key in keys:
            self.add(key)

    def __len__(self) -> int:
        """Return the number of keys."""
        return len(self._keys)

    def add(self, key: VerifyingKey) -> None:
        """Believe a key.

        Raises:
            ValueError: the same key belongs to another agent already.
        """
        known = self._keys.get(key.key_id)
        if known is not None and known.agent != key.agent:
            raise ValueError(f"a key must belong to one agent, got that of {known.agent!r} for {key.agent!r}")
        self._keys[key.key_id] = key

    def remove(self, key: VerifyingKey) -> None:
        """Believe a key no longer."""
        self._keys.pop(key.key_id, None)

    def find(self, key_id: bytes) -> VerifyingKey | None:
        """Return the key of an id, or None."""
        return self._keys.get(key_id)


@dataclass(frozen=True, slots=True)
class Envelope:
    """A signed message taken apart; nothing of it is verified."""

    key_id: bytes
    payload: bytes
    signature: bytes


@dataclass(frozen=True, slots=True)
class MessageHeading:
    """What is read of a payload before its signature is verified."""

    agent: str
    epoch: int
    sequence: int
    t_ns: int


class OtherVersionError(ValueError):
    """A payload has another version of the format."""


def sign_message(message: ViewMessage, key: SigningKey) -> bytes:
    """Return the signed bytes of a message.

    Raises:
        ImportError: cbor2 or cwt is not installed.
        ValueError: the key is another agent's, or the message is too large.
    """
    if message.agent != key.agent:
        raise ValueError(f"a message must be signed by its agent {message.agent!r}, got the key of {key.agent!r}")
    signed = sign(encode_message(message), key)
    if len(signed) > MAX_BYTES:
        raise ValueError(f"a signed message must have at most {MAX_BYTES} bytes, got {len(signed)}; send less")
    return signed


def sign(payload: bytes, key: SigningKey) -> bytes:
    """Return the envelope of a payload."""
    with needed_for("signing messages"):
        from cwt import COSE
    signed: bytes = COSE.new().encode(payload, key=key.cose, protected={1: -8, 4: key.verifying().key_id})
    return signed


def open_envelope(data: bytes) -> Envelope:
    """Return the parts of an envelope, unverified.

    Raises:
        ValueError: it has another form, or too many bytes.
    """
    if len(data) > MAX_BYTES:
        raise ValueError(f"a signed message must have at most {MAX_BYTES} bytes, got {len(data)}")
    begin = len(_BEFORE_ID) + KEY_ID_BYTES
    if data[: len(_BEFORE_ID)] != _BEFORE_ID or data[begin : begin + 1] != _AFTER_ID:
        raise ValueError("a message must be COSE_Sign1 with EdDSA and a key id of 8 bytes")
    reader = cbor.Reader(data, begin + 1)
    major, _, length = reader.head()
    end = reader.at + length
    if major != 2 or len(data) != end + 2 + SIGNATURE_BYTES or data[end : end + 2] != _BEFORE_SIGNATURE:
        raise ValueError("a message must be a payload and a signature of 64 bytes")
    return Envelope(data[begin - KEY_ID_BYTES : begin], data[reader.at : end], data[end + 2 :])


def read_heading(payload: bytes) -> MessageHeading:
    """Return sender, epoch, sequence number and time of a payload; they come first.

    Raises:
        OtherVersionError: it begins as a payload of another version.
        ValueError: it does not begin as a payload.
    """
    reader = cbor.Reader(payload)
    major, _, _ = reader.head()
    found: list[Any] = []
    for expected in range(4):
        key_major, _, key = reader.head()
        if major != 5 or (key_major, key) != (0, expected):
            raise ValueError("a payload must begin with version, agent, number and t_ns")
        found.append(reader.value(1))
        if expected == 0 and type(found[0]) is int and found[0] != VERSION:
            raise OtherVersionError(
                f"the version of a payload must be {VERSION}, got {found[0]}; bring agent and receiver to one release"
            )
    version, agent, number, t_ns = found
    if type(version) is not int or type(agent) is not str or type(t_ns) is not int:
        raise ValueError("a payload must begin with its version, a name, a number and a time")
    if type(number) is not list or [type(each) for each in number] != [int, int]:
        raise ValueError("the number of a payload must be an epoch and a sequence number")
    require_name("agent", agent)
    epoch, sequence = number
    return MessageHeading(agent, epoch, sequence, t_ns)


def is_signed_by(data: bytes, key: VerifyingKey) -> bool:
    """Return whether an envelope, of which :func:`open_envelope` found the form, is signed by a key."""
    with needed_for("reading signed messages"):
        from cwt import COSE, VerifyError
    try:
        COSE.new().decode(data, keys=key.cose)
    except VerifyError:
        return False
    return True
