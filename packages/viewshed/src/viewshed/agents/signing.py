"""Signed messages: COSE_Sign1 (RFC 9052) with Ed25519 by cwt, and the key ring of trusted agents.

The envelope has one fixed form: tag 18, protected header {1: -8, 4: key id}, empty unprotected header, payload,
signature. It is parsed by hand first, so that cwt gets nothing of an unverified message but the bytes to verify.
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

# Array of four parts with tag COSE_Sign1; protected header of 13 bytes: EdDSA, and a key id of 8 bytes.
_BEFORE_ID = bytes.fromhex("d2844da201270448")
_AFTER_ID = bytes.fromhex("a0")
_BEFORE_SIGNATURE = bytes.fromhex("5840")


_is_strong = lru_cache(maxsize=256)(has_large_order)  # a signing key builds its public key per message


@dataclass(frozen=True)
class VerifyingKey:
    """Public key of one agent.

    Raises:
        ValueError: the key is invalid, anyone can sign for it, or its validity period is empty.
    """

    agent: str  # owner of the key
    public: bytes  # 32 bytes
    from_ns: int = 0  # time of the first message that it may sign, nanoseconds since 1970
    until_ns: int = FOREVER_NS  # time of the last message that it may sign

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
            raise ValueError(
                f"a key must be valid from one time until a later one, got {self.from_ns} to {self.until_ns}"
            )

    @property
    def key_id(self) -> bytes:
        """First 8 bytes of the SHA-256 of the public key."""
        return hashlib.sha256(self.public).digest()[:KEY_ID_BYTES]

    @cached_property
    def cose(self) -> Any:
        """The key as a cwt object."""
        with needed_for("reading signed messages"):
            from cwt import COSEKey
        return COSEKey.new({**_ED25519, -2: self.public, 2: self.key_id})


@dataclass(frozen=True)
class SigningKey:
    """Private key of one agent: 32 bytes, secret to it."""

    agent: str
    private: bytes = field(repr=False)

    @classmethod
    def generate(cls, agent: str) -> SigningKey:
        """Return a new key from the system's random source."""
        with needed_for("making a key"):
            from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
        return cls(agent, Ed25519PrivateKey.generate().private_bytes_raw())

    @cached_property
    def public(self) -> bytes:
        """Public key, 32 bytes."""
        with needed_for("signing messages"):
            from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
        return Ed25519PrivateKey.from_private_bytes(self.private).public_key().public_bytes_raw()

    def verifying(self, from_ns: int = 0, until_ns: int = FOREVER_NS) -> VerifyingKey:
        """Return the public key, to distribute to other agents."""
        return VerifyingKey(self.agent, self.public, from_ns, until_ns)

    @cached_property
    def cose(self) -> Any:
        """The key as a cwt object."""
        with needed_for("signing messages"):
            from cwt import COSEKey
        return COSEKey.new({**_ED25519, -2: self.public, -4: self.private, 2: self.verifying().key_id})


def read_signing_key(agent: str, path: str) -> SigningKey:
    """Read the private key of an agent from a file of 64 hexadecimal digits.

    Raises:
        ValueError: the file has other content, or users other than its owner may read or write it.
        OSError: it cannot be read.
    """
    require_private(path)
    return SigningKey(agent, _key_bytes(path))


def read_verifying_keys(agents: list[str], paths: list[str]) -> tuple[VerifyingKey, ...]:
    """Read the public keys of agents, each from a file of 64 hexadecimal digits.

    Raises:
        ValueError: the number of files differs, or a file has other content or a key that anyone can sign for.
        OSError: one cannot be read.
    """
    if len(agents) != len(paths) or len(set(agents)) != len(agents) or not agents:
        raise ValueError(f"keys must be one file for each agent, got {len(paths)} for {', '.join(agents) or 'none'}")
    return tuple(VerifyingKey(agent, _key_bytes(path)) for agent, path in zip(agents, paths, strict=True))


def require_private(path: str | Path) -> None:
    """Raise ValueError if users other than its owner may read or write the file of a private key."""
    mode = stat.S_IMODE(Path(path).stat().st_mode)
    if os.name == "posix" and mode & 0o077:
        raise ValueError(
            f"a private key must be readable by its owner only, got mode {mode:04o} of {path}; chmod 600 {path}"
        )


def _key_bytes(path: str) -> bytes:
    text = Path(path).read_text(encoding="ascii", errors="replace").strip()
    try:
        key = bytes.fromhex(text)
    except ValueError:
        key = b""
    if len(key) != 32:
        raise ValueError(f"a key must be 64 hexadecimal digits, got {len(text)} characters in {path}")
    return key


class KeyRing:
    """Public keys that a receiver trusts, by key id; an agent may have several, such as the old and the next one."""

    def __init__(self, keys: tuple[VerifyingKey, ...] = ()) -> None:
        self._keys: dict[bytes, VerifyingKey] = {}
        for key in keys:
            self.add(key)

    def __len__(self) -> int:
        """Return the number of keys."""
        return len(self._keys)

    def add(self, key: VerifyingKey) -> None:
        """Trust a key.

        Raises:
            ValueError: the same key already belongs to another agent.
        """
        existing = self._keys.get(key.key_id)
        if existing is not None and existing.agent != key.agent:
            raise ValueError(f"a key must belong to one agent, got that of {existing.agent!r} for {key.agent!r}")
        self._keys[key.key_id] = key

    def remove(self, key: VerifyingKey) -> None:
        """Stop trusting a key."""
        self._keys.pop(key.key_id, None)

    def find(self, key_id: bytes) -> VerifyingKey | None:
        """Return the key with an id, or None."""
        return self._keys.get(key_id)


@dataclass(frozen=True, slots=True)
class Envelope:
    """Parts of a signed message, not verified."""

    key_id: bytes
    payload: bytes
    signature: bytes


@dataclass(frozen=True, slots=True)
class MessageHeading:
    """First fields of a payload, read before its signature is verified."""

    agent: str
    epoch: int
    sequence: int
    t_ns: int


class OtherVersionError(ValueError):
    """The payload has another version of the format."""


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
    """Return the signed envelope of a payload."""
    with needed_for("signing messages"):
        from cwt import COSE
    signed: bytes = COSE.new().encode(payload, key=key.cose, protected={1: -8, 4: key.verifying().key_id})
    return signed


def open_envelope(data: bytes) -> Envelope:
    """Return the parts of an envelope, not verified.

    Raises:
        ValueError: it has another form, or too many bytes.
    """
    if len(data) > MAX_BYTES:
        raise ValueError(f"a signed message must have at most {MAX_BYTES} bytes, got {len(data)}")
    header_end = len(_BEFORE_ID) + KEY_ID_BYTES
    if data[: len(_BEFORE_ID)] != _BEFORE_ID or data[header_end : header_end + 1] != _AFTER_ID:
        raise ValueError("a message must be COSE_Sign1 with EdDSA and a key id of 8 bytes")
    reader = cbor.Reader(data, header_end + 1)
    major, _, length = reader.head()
    end = reader.at + length
    if major != 2 or len(data) != end + 2 + SIGNATURE_BYTES or data[end : end + 2] != _BEFORE_SIGNATURE:
        raise ValueError("a message must be a payload and a signature of 64 bytes")
    return Envelope(data[header_end - KEY_ID_BYTES : header_end], data[reader.at : end], data[end + 2 :])


def read_heading(payload: bytes) -> MessageHeading:
    """Return sender, epoch, sequence number and time of a payload, its first fields.

    Raises:
        OtherVersionError: the payload has another version.
        ValueError: it does not begin like a payload.
    """
    reader = cbor.Reader(payload)
    major, _, _ = reader.head()
    values: list[Any] = []
    for expected_key in range(4):
        key_major, _, key = reader.head()
        if major != 5 or (key_major, key) != (0, expected_key):
            raise ValueError("a payload must begin with version, agent, number and t_ns")
        values.append(reader.value(1))
        if expected_key == 0 and type(values[0]) is int and values[0] != VERSION:
            raise OtherVersionError(
                f"the version of a payload must be {VERSION}, got {values[0]}; install the same release on agent and"
                " receiver"
            )
    version, agent, number, t_ns = values
    if type(version) is not int or type(agent) is not str or type(t_ns) is not int:
        raise ValueError("a payload must begin with its version, a name, a number and a time")
    if type(number) is not list or [type(each) for each in number] != [int, int]:
        raise ValueError("the number of a payload must be an epoch and a sequence number")
    require_name("agent", agent)
    epoch, sequence = number
    return MessageHeading(agent, epoch, sequence, t_ns)


def is_signed_by(data: bytes, key: VerifyingKey) -> bool:
    """Return whether a key has signed an envelope whose form :func:`open_envelope` has checked."""
    with needed_for("reading signed messages"):
        from cwt import COSE, VerifyError
    try:
        COSE.new().decode(data, keys=key.cose)
    except VerifyError:
        return False
    return True
