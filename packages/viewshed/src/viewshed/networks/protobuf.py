"""Minimal reader and writer of protocol buffers, for ONNX files.

A message is a sequence of fields; a field is the varint ``number · 8 + wire type``, then a varint or bytes. The bytes
may be a nested message.
"""

from __future__ import annotations

from collections.abc import Iterator

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5


def fields(message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Yield number and value of each field of a message: an int for a varint, else bytes.

    Raises:
        ValueError: the message is damaged.
        IndexError: the message is truncated.
    """
    offset = 0
    while offset < len(message):
        key, offset = _varint(message, offset)
        number, kind = key >> 3, key & 7
        if kind == _VARINT:
            value, offset = _varint(message, offset)
            yield number, value
            continue
        length, offset = {_FIXED64: (8, offset), _FIXED32: (4, offset)}.get(kind) or _length(message, offset, kind)
        if length > len(message) - offset:
            raise ValueError(f"a field of {length} bytes where {len(message) - offset} are left")
        yield number, message[offset : offset + length]
        offset += length


def encode(number: int, value: int | memoryview | bytes) -> bytes:
    """Return an encoded field: an int as a varint, bytes with their length.

    >>> list(encode(1, 300)), list(encode(2, b"Mul"))
    ([8, 172, 2], [18, 3, 77, 117, 108])
    """
    if isinstance(value, int):
        return _encode_varint(number << 3 | _VARINT) + _encode_varint(value)
    return b"".join((_encode_varint(number << 3 | _BYTES), _encode_varint(len(value)), value))


def as_message(value: int | memoryview) -> memoryview:
    """Return the value of a field of type message; raise ValueError for a number."""
    if isinstance(value, int):
        raise ValueError("a number where a message must be")
    return value


def as_text(value: int | memoryview) -> str:
    """Return the value of a field of type string."""
    return bytes(as_message(value)).decode("utf-8")


def as_ints(value: int | memoryview) -> tuple[int, ...]:
    """Return the values of a field of repeated int64, packed or a single element."""
    if isinstance(value, int):
        return (signed(value),)
    numbers, offset = [], 0
    while offset < len(value):
        number, offset = _varint(value, offset)
        numbers.append(signed(number))
    return tuple(numbers)


def signed(value: int) -> int:
    """Return the int64 of an unsigned two's complement number."""
    return value - (1 << 64) if value >> 63 else value


def _length(message: memoryview, offset: int, kind: int) -> tuple[int, int]:
    if kind != _BYTES:
        raise ValueError(f"wire type {kind}")
    return _varint(message, offset)


def _varint(message: memoryview, offset: int) -> tuple[int, int]:
    """Return a varint (7 bits per byte, least significant first) and the offset behind it."""
    value = 0
    for shift in range(0, 70, 7):
        byte = message[offset]
        offset += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, offset
    raise ValueError("a number of more than 64 bits")


def _encode_varint(value: int) -> bytes:
    encoded = bytearray()
    while value >= 0x80:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    encoded.append(value)
    return bytes(encoded)
