"""Deterministic CBOR of messages (RFC 8949, section 4.2.1): written by cbor2, read by a strict and bounded reader.

The reader accepts only what messages use: integers, byte and text strings, arrays, maps with ascending unsigned keys,
floats, booleans, and typed arrays of numbers (RFC 8746). Lengths are definite and numbers use the shortest encoding, so
that equal content has equal bytes. Sizes are checked first.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed._extras import needed_for

MAX_ITEMS = 512
"""Maximum number of items in a payload, including those in arrays and maps."""

MAX_DEPTH = 4
"""Maximum nesting depth of arrays and maps."""

_DTYPES: dict[int, np.dtype[Any]] = {
    64: np.dtype("u1"), 78: np.dtype("<i4"), 85: np.dtype("<f4"), 86: np.dtype("<f8"),
}  # fmt: skip
_TAGS = {dtype: tag for tag, dtype in _DTYPES.items()}

_FLOATS = {25: ">e", 26: ">f", 27: ">d"}


def dumps(value: Any) -> bytes:
    """Return plain values and one-dimensional numeric arrays as deterministic CBOR.

    Raises:
        ImportError: cbor2 is not installed.

    >>> dumps({0: 1, 1: [True, 0.5]}).hex()
    'a200010182f5f93800'
    """
    with needed_for("writing messages"):
        import cbor2

    def with_tags(item: Any) -> Any:
        if isinstance(item, np.ndarray):
            little = np.ascontiguousarray(item, item.dtype.newbyteorder("<"))
            return cbor2.CBORTag(_TAGS[little.dtype], little.tobytes())
        if isinstance(item, Mapping):
            return {key: with_tags(each) for key, each in item.items()}
        return [with_tags(each) for each in item] if isinstance(item, list | tuple) else item

    packed: bytes = cbor2.dumps(with_tags(value), canonical=True)
    return packed


def loads(data: bytes) -> Any:
    """Return the value of deterministic CBOR; typed arrays are read-only views of ``data``.

    Raises:
        ValueError: the bytes are not deterministic CBOR of supported values, or are too short or too long.

    >>> loads(bytes.fromhex("a200010182f5f93800"))
    {0: 1, 1: [True, 0.5]}
    """
    reader = Reader(data)
    value = reader.value()
    if reader.at != len(data):
        raise ValueError(f"a payload must end with its last item, got {len(data) - reader.at} more bytes")
    return value


class Reader:
    """Reads items of deterministic CBOR in sequence; ``at`` is the offset of the next one."""

    __slots__ = ("at", "data", "items")

    def __init__(self, data: bytes, at: int = 0) -> None:
        self.data = data
        self.at = at
        self.items = 0

    def head(self) -> tuple[int, int, int]:
        """Return major type, additional information and argument of the next item; the argument of a float is 0."""
        data, at = self.data, self.at
        if at >= len(data):
            raise ValueError("a payload must not end within an item")
        self.items += 1
        if self.items > MAX_ITEMS:
            raise ValueError(f"a payload must have at most {MAX_ITEMS} items")
        major, extra = data[at] >> 5, data[at] & 31
        if extra < 24:
            self.at = at + 1
            return major, extra, extra
        if extra > 27:
            raise ValueError("lengths in a payload must be given, got an indefinite or reserved one")
        size = 1 << (extra - 24)
        end = at + 1 + size
        if end > len(data):
            raise ValueError("a payload must not end within an item")
        self.at = end
        if major == 7:
            return major, extra, 0
        argument = int.from_bytes(data[at + 1 : end], "big")
        if argument < (24 if extra == 24 else 1 << (4 * size)):
            raise ValueError("numbers in a payload must have the shortest encoding")
        return major, extra, argument

    def value(self, depth: int = 0) -> Any:
        """Return the next item."""
        major, extra, argument = self.head()
        if major == 0:
            return argument
        if major == 1:
            return -1 - argument
        if major in (2, 3):
            return self._string(major, argument)
        if major in (4, 5):
            return self._collection(major, argument, depth)
        if major == 6:
            return self._typed_array(argument)
        if extra in (20, 21):
            return extra == 21
        if extra in _FLOATS:
            return self._float(extra)
        raise ValueError(f"simple values in a payload must be false, true or a float, got {extra}")

    def _string(self, major: int, length: int) -> bytes | str:
        end = self.at + length
        if end > len(self.data):
            raise ValueError("a payload must not end within a string")
        raw = self.data[self.at : end]
        self.at = end
        if major == 2:
            return raw
        try:
            return raw.decode("utf-8")
        except UnicodeDecodeError as error:
            raise ValueError("text in a payload must be UTF-8") from error

    def _collection(self, major: int, length: int, depth: int) -> Any:
        if depth >= MAX_DEPTH:
            raise ValueError(f"a payload must be at most {MAX_DEPTH} arrays and maps deep")
        if length > MAX_ITEMS:
            raise ValueError(f"a payload must have at most {MAX_ITEMS} items")
        if major == 4:
            return [self.value(depth + 1) for _ in range(length)]
        items: dict[int, Any] = {}
        last = -1
        for _ in range(length):
            key_major, _, key = self.head()
            if key_major != 0 or key <= last:
                raise ValueError("keys in a payload must be unsigned and ascend")
            items[key] = self.value(depth + 1)
            last = key
        return items

    def _typed_array(self, tag: int) -> NDArray[Any]:
        dtype = _DTYPES.get(tag)
        if dtype is None:
            raise ValueError(f"tags in a payload must be those of typed arrays, got {tag}")
        major, _, length = self.head()
        if major != 2 or length % dtype.itemsize or self.at + length > len(self.data):
            raise ValueError("a typed array must be a byte string of whole numbers of its type")
        array: NDArray[Any] = np.frombuffer(self.data, dtype, length // dtype.itemsize, self.at)
        self.at += length
        return array

    def _float(self, extra: int) -> float:
        size = 1 << (extra - 24)
        raw = self.data[self.at - size : self.at]
        value = float(struct.unpack(_FLOATS[extra], raw)[0])
        if math.isnan(value):
            if raw != b"\x7e\x00":
                raise ValueError("NaN in a payload must be the half-precision one")
        elif extra > 25 and _fits(value, _FLOATS[extra - 1]):
            raise ValueError("floats in a payload must have the shortest encoding")
        return value


def _fits(value: float, shorter: str) -> bool:
    try:
        return bool(struct.unpack(shorter, struct.pack(shorter, value))[0] == value)
    except OverflowError:
        return False
