"""Unaligned packed encoding (UPER, ITU-T X.691) of the few ASN.1 types that a Collective Perception Message needs.

Values are those of JSON: a SEQUENCE is a dictionary, a CHOICE a dictionary with one item, a SEQUENCE OF a list. The
decoder skips extension members of a SEQUENCE; it refuses extension alternatives of a CHOICE and extended list lengths.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

_MAX_OPEN_BYTES = 16_383


@dataclass(frozen=True, slots=True)
class Integer:
    """INTEGER from ``low`` to ``high``; also ENUMERATED by its numbers, and BIT STRING as one number."""

    low: int
    high: int


@dataclass(frozen=True, slots=True)
class Boolean:
    """BOOLEAN."""


@dataclass(frozen=True, slots=True)
class Record:
    """SEQUENCE of named members; a name that ends with ``?`` is OPTIONAL."""

    members: Mapping[str, Type]
    extensible: bool = False


@dataclass(frozen=True, slots=True)
class SequenceOf:
    """SEQUENCE OF ``min_size`` to ``max_size`` values of one type."""

    of: Type
    min_size: int
    max_size: int
    extensible: bool = True


@dataclass(frozen=True, slots=True)
class Choice:
    """CHOICE of alternatives, by name."""

    of: Mapping[str, Type]
    extensible: bool = True


@dataclass(frozen=True, slots=True)
class OpenType:
    """Open type: an INTEGER from ``low`` to ``high`` that selects a type, and a value of that type in its own bytes.

    A value of an unknown number is skipped by the decoder and returned as ``{}``.
    """

    low: int
    high: int
    of: Mapping[int, tuple[str, Type]] = field(default_factory=dict)


Type = Integer | Boolean | Record | SequenceOf | Choice | OpenType


def encode(kind: Type, value: Any, name: str) -> bytes:
    """Encode a value as bytes, at least one; ``name`` denotes it in error messages.

    Raises:
        ValueError: the value does not match its type; the message names the member.
    """
    bits = "".join(_encode_bits(kind, value, name)) or "0"
    return int(bits.ljust(-(-len(bits) // 8) * 8, "0"), 2).to_bytes(-(-len(bits) // 8), "big")


def decode(kind: Type, content: bytes) -> Any:
    """Decode the value at the beginning of ``content``.

    Raises:
        ValueError: the content is cut off, a number is out of bounds, or an extension cannot be skipped.
    """
    return _decode_bits(kind, _Bits(int.from_bytes(content, "big"), 8 * len(content)))


def _number(value: object, low: int, high: int, name: str) -> str:
    """Return the bits of an integer in [low, high]."""
    if not isinstance(value, int) or not low <= value <= high:
        raise ValueError(f"{name} must be a whole number in [{low}, {high}], got {value!r:.80}")
    size = (high - low).bit_length()
    return f"{value - low:0{size}b}" if size else ""


def _choice(value: object, names: Mapping[str, Any], name: str) -> tuple[str, Any]:
    """Return name and value of a choice."""
    if not isinstance(value, Mapping) or len(value) != 1 or not set(value) <= set(names):
        raise ValueError(f"{name} must be one of {', '.join(names)}, got {value!r:.80}")
    return next(iter(value.items()))


def _encode_bits(kind: Type, value: Any, name: str) -> list[str]:
    """Encode a value as a list of strings of 0 and 1."""
    extension = ["0"] if getattr(kind, "extensible", False) else []
    match kind:
        case Integer(low, high):
            return [_number(value, low, high, name)]
        case Boolean():
            return [_number(int(value) if isinstance(value, bool) else value, 0, 1, name)]
        case Record(members):
            known = {member.rstrip("?"): member for member in members}
            required = {member for member in members if not member.endswith("?")}
            if not isinstance(value, Mapping) or not required <= set(value) <= set(known):
                raise ValueError(f"{name} must have the members {', '.join(members)}, got {value!r:.80}")
            presence = [str(int(member in value)) for member, marked in known.items() if marked.endswith("?")]
            parts = (_encode_bits(members[known[m]], value[m], f"{name}.{m}") for m in known if m in value)
            return [*extension, *presence, *(bits for part in parts for bits in part)]
        case SequenceOf(of, min_size, max_size):
            count = _number(len(value) if isinstance(value, list) else value, min_size, max_size, f"length of {name}")
            parts = (_encode_bits(of, item, f"{name}[{index}]") for index, item in enumerate(value))
            return [*extension, count, *(bits for part in parts for bits in part)]
        case Choice(alternatives):
            selected, inner = _choice(value, alternatives, name)
            which = _number(list(alternatives).index(selected), 0, len(alternatives) - 1, name)
            return [*extension, which, *_encode_bits(alternatives[selected], inner, f"{name}.{selected}")]
        case OpenType(low, high, numbered):
            names = {of: (number, inner) for number, (of, inner) in numbered.items()}
            selected, inner = _choice(value, names, name)
            content = encode(names[selected][1], inner, selected)
            if len(content) > _MAX_OPEN_BYTES:
                raise ValueError(f"{selected} must need at most {_MAX_OPEN_BYTES} bytes, got {len(content)}; send less")
            size = f"{len(content):08b}" if len(content) < 0x80 else f"10{len(content):014b}"
            bits = f"{int.from_bytes(content, 'big'):0{8 * len(content)}b}"
            return [_number(names[selected][0], low, high, name), size, bits]


@dataclass(slots=True)
class _Bits:
    """Bit reader: ``left`` low bits of ``value`` are still unread."""

    value: int
    left: int

    def take(self, count: int) -> int:
        if count > self.left:
            raise ValueError(f"must not end here: {count - self.left} bits are missing")
        self.left -= count
        return self.value >> self.left & (1 << count) - 1

    def number(self, low: int, high: int) -> int:
        value = low + self.take((high - low).bit_length())
        if value > high:
            raise ValueError(f"must hold a number in [{low}, {high}], got {value}")
        return value

    def open_type_bytes(self) -> bytes:
        """Read an open type: the number of its bytes, then these bytes."""
        count = self.take(8)
        if count >= 0xC0:
            raise ValueError(f"must have parts of at most {_MAX_OPEN_BYTES} bytes each")
        count = (count & 0x3F) << 8 | self.take(8) if count >= 0x80 else count
        return self.take(8 * count).to_bytes(count, "big")


def _decode_bits(kind: Type, bits: _Bits) -> Any:
    """Decode the next value."""
    is_extended = getattr(kind, "extensible", False) and bits.take(1) == 1
    if is_extended and not isinstance(kind, Record):
        raise ValueError("must have no alternatives and no longer lists than this version knows")
    match kind:
        case Integer(low, high):
            return bits.number(low, high)
        case Boolean():
            return bits.take(1) == 1
        case Record(members):
            presence = [not member.endswith("?") or bits.take(1) == 1 for member in members]
            present = (item for item, is_present in zip(members.items(), presence, strict=True) if is_present)
            value = {member.rstrip("?"): _decode_bits(of, bits) for member, of in present}
            if is_extended:
                # Skip the extension: its number of members, their presence bits, and an open type for each.
                if bits.take(1):
                    raise ValueError("must have at most 64 members that this version does not know")
                for _ in range(sum([bits.take(1) for _ in range(bits.take(6) + 1)])):
                    bits.open_type_bytes()
            return value
        case SequenceOf(of, min_size, max_size):
            return [_decode_bits(of, bits) for _ in range(bits.number(min_size, max_size))]
        case Choice(alternatives):
            selected = list(alternatives)[bits.number(0, len(alternatives) - 1)]
            return {selected: _decode_bits(alternatives[selected], bits)}
        case OpenType(low, high, numbered):
            number, content = bits.number(low, high), bits.open_type_bytes()
            return {numbered[number][0]: decode(numbered[number][1], content)} if number in numbered else {}
