"""A checksum inside a network's file: its last entry of metadata is the SHA-256 of all bytes before it."""

from __future__ import annotations

import hashlib

CARD_KEY = "viewshed.card"
"""Where in a file's metadata the card is."""
_KEY = b"viewshed.sha256"
_DIGITS = 64
# The entry as protocol buffers encode it: field 14 (metadata_props) of onnx.ModelProto, then key (1) and value (2).
_HEAD = (
    bytes([14 << 3 | 2, 4 + len(_KEY) + _DIGITS, 1 << 3 | 2, len(_KEY)]) + _KEY + bytes([2 << 3 | 2, _DIGITS])
)  # fmt: skip


def sealed(model: bytes) -> bytes:
    """Return a serialized ONNX model with the checksum of its bytes as one more entry of its metadata."""
    return model + _HEAD + hashlib.sha256(model).hexdigest().encode()


def check_seal(content: bytes, name: str) -> None:
    """Raise a ValueError unless ``content`` is what :func:`sealed` returned; ``name`` is the file in the message.

    >>> check_seal(sealed(b"model"), "a.onnx")
    >>> check_seal(sealed(b"model").replace(b"m", b"n", 1), "a.onnx")
    Traceback (most recent call last):
    ...
    ValueError: a.onnx must have the checksum 9372c470ee…, got 6499ba3c93…: it is damaged; copy it again
    """
    model, end = content[: -_DIGITS - len(_HEAD)], content[-_DIGITS - len(_HEAD) :]
    if not end.startswith(_HEAD):
        raise ValueError(
            f"{name} must be a network that viewshed exported, got a file that is cut short or another; copy it again,"
            " or export it with viewshed train"
        )
    found, promised = hashlib.sha256(model).hexdigest(), end[-_DIGITS:].decode("ascii", "replace")
    if found != promised:
        raise ValueError(
            f"{name} must have the checksum {promised[:10]}…, got {found[:10]}…: it is damaged; copy it again"
        )
