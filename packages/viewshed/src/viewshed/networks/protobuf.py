"""Protocol buffers as far as ONNX files need them: a message is a sequence of fields (number, value); messages nest.

On the wire a field is (number · 8 + wire type) and its value: a number, or the bytes of anything longer.
"""

from __future__ import annotations

from collections.abc import Iterator

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5


def fields(message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Yield number and value of each field of a message: an int, or the bytes of anything longer.

    Raises:
        ValueError: the message is damaged.
        IndexError: it is cut short.
    """
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        number, kind = key >> 3, key & 7
        if kind == _VARINT:
            value, at = _varint(message, at)
            yield number, value
            continue
        length, at = {_FIXED64: (8, at), _FIXED32: (4, at)}.get(kind) or _length(message, at, kind)
        if length > len(message) - at:
            raise ValueError(f"a field of {length} bytes where {len(message) - at} are left")
        yield number, message[at : at + length]
        at += length


def encode(number: int, value: int | memoryview | bytes) -> bytes:
    """Return a field as bytes: an int as a number, anything else by its length.

    >>> list(encode(1, 300)), list(encode(2, b"Mul"))
    ([8, 172, 2], [18, 3, 77, 117, 108])
    """
    if isinstance(value, int):
        return _encoded_varint(number << 3 | _VARINT) + _encoded_varint(value)
    return b"".join((_encoded_varint(number << 3 | _BYTES), _encoded_varint(len(value)), value))


def as_message(value: int | memoryview) -> memoryview:
    """Return the value of a field that holds a message."""
    if isinstance(value, int):
        raise ValueError("a number where a message must be")
    return value


def as_text(value: int | memoryview) -> str:
    """Return the value of a field that holds a text."""
    return bytes(as_message(value)).decode("utf-8")


def as_ints(value: int | memoryview) -> tuple[int, ...]:
    """Return the value of a field of repeated int64, one by one or packed."""
    if isinstance(value, int):
        return (signed(value),)
    found, at = [], 0
    while at < len(value):
        number, at = _varint(value, at)
        found.append(signed(number))
    return tuple(found)


def signed(value: int) -> int:
    """Return an int64 of its two's complement, as negative numbers are written."""
    return value - (1 << 64) if value >> 63 else value


def _length(message: memoryview, at: int, kind: int) -> tuple[int, int]:
    if kind != _BYTES:
        raise ValueError(f"wire type {kind}")
    return _varint(message, at)


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    """Return a number of seven bits a byte, the lowest first, and where it ends."""
    value = 0
    for shift in range(0, 70, 7):
        byte = message[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise ValueError("a number of more than 64 bits")


def _encoded_varint(value: int) -> bytes:
    found = bytearray()
    while value >= 0x80:
        found.append(value & 0x7F | 0x80)
        value >>= 7
    found.append(value)
    return bytes(found)
