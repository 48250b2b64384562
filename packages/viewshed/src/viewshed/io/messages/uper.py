"""Unaligned packed encoding (UPER, ITU-T X.691) of the few ASN.1 types that a Collective Perception Message needs.

A value is what JSON has: a sequence is a dictionary, a choice a dictionary of one item, a list a list. Members of a
sequence that a later version added are skipped; such alternatives of a choice, and longer lists, are refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

_MOST_OPEN_BYTES = 16_383


@dataclass(frozen=True, slots=True)
class Whole:
    """A number from ``low`` to ``high``; an enumeration by its numbers, a string of bits as one number."""

    low: int
    high: int


@dataclass(frozen=True, slots=True)
class Flag:
    """True or False."""


@dataclass(frozen=True, slots=True)
class Record:
    """A sequence of named members; those whose name ends with ``?`` may be absent."""

    members: Mapping[str, Type]
    extensible: bool = False


@dataclass(frozen=True, slots=True)
class Several:
    """A list of ``least`` to ``most`` values of one type."""

    of: Type
    least: int
    most: int
    extensible: bool = True


@dataclass(frozen=True, slots=True)
class Choice:
    """One of several types, by name."""

    of: Mapping[str, Type]
    extensible: bool = True


@dataclass(frozen=True, slots=True)
class Numbered:
    """A number from ``low`` to ``high`` and, packed by itself, a value of the type that it stands for.

    A value of another number is skipped when it is read: ``{}`` stands for it.
    """

    low: int
    high: int
    of: Mapping[int, tuple[str, Type]] = field(default_factory=dict)


Type = Whole | Flag | Record | Several | Choice | Numbered


def encode(kind: Type, value: Any, name: str) -> bytes:
    """Return a value as bytes, at least one; ``name`` stands for it in messages.

    Raises:
        ValueError: it does not fit its type; the message names the member.
    """
    bits = "".join(_written(kind, value, name)) or "0"
    return int(bits.ljust(-(-len(bits) // 8) * 8, "0"), 2).to_bytes(-(-len(bits) // 8), "big")


def decode(kind: Type, content: bytes) -> Any:
    """Return the value that bytes begin with.

    Raises:
        ValueError: they end early, hold a number out of bounds, or something of a later version that cannot be skipped.
    """
    return _read(kind, _Bits(int.from_bytes(content, "big"), 8 * len(content)))


def _number(value: object, low: int, high: int, name: str) -> str:
    """Return the bits of a number that is at least ``low`` and at most ``high``."""
    if not isinstance(value, int) or not low <= value <= high:
        raise ValueError(f"{name} must be a whole number in [{low}, {high}], got {value!r:.80}")
    size = (high - low).bit_length()
    return f"{value - low:0{size}b}" if size else ""


def _chosen(value: object, names: Mapping[str, Any], name: str) -> tuple[str, Any]:
    """Return the one item of a choice."""
    if not isinstance(value, Mapping) or len(value) != 1 or not set(value) <= set(names):
        raise ValueError(f"{name} must be one of {', '.join(names)}, got {value!r:.80}")
    return next(iter(value.items()))


def _written(kind: Type, value: Any, name: str) -> list[str]:
    """Return the bits of a value in parts, as text of zeros and ones."""
    extension = ["0"] if getattr(kind, "extensible", False) else []
    match kind:
        case Whole(low, high):
            return [_number(value, low, high, name)]
        case Flag():
            return [_number(int(value) if isinstance(value, bool) else value, 0, 1, name)]
        case Record(members):
            known = {member.rstrip("?"): member for member in members}
            needed = {member for member in members if not member.endswith("?")}
            if not isinstance(value, Mapping) or not needed <= set(value) <= set(known):
                raise ValueError(f"{name} must have the members {', '.join(members)}, got {value!r:.80}")
            there = [str(int(member in value)) for member, marked in known.items() if marked.endswith("?")]
            parts = (_written(members[known[m]], value[m], f"{name}.{m}") for m in known if m in value)
            return [*extension, *there, *(bits for part in parts for bits in part)]
        case Several(of, least, most):
            count = _number(len(value) if isinstance(value, list) else value, least, most, f"length of {name}")
            parts = (_written(of, each, f"{name}[{number}]") for number, each in enumerate(value))
            return [*extension, count, *(bits for part in parts for bits in part)]
        case Choice(alternatives):
            chosen, inner = _chosen(value, alternatives, name)
            which = _number(list(alternatives).index(chosen), 0, len(alternatives) - 1, name)
            return [*extension, which, *_written(alternatives[chosen], inner, f"{name}.{chosen}")]
        case Numbered(low, high, numbered):
            names = {of: (number, inner) for number, (of, inner) in numbered.items()}
            chosen, inner = _chosen(value, names, name)
            content = encode(names[chosen][1], inner, chosen)
            if len(content) > _MOST_OPEN_BYTES:
                raise ValueError(f"{chosen} must need at most {_MOST_OPEN_BYTES} bytes, got {len(content)}; send less")
            size = f"{len(content):08b}" if len(content) < 0x80 else f"10{len(content):014b}"
            bits = f"{int.from_bytes(content, 'big'):0{8 * len(content)}b}"
            return [_number(names[chosen][0], low, high, name), size, bits]


@dataclass(slots=True)
class _Bits:
    """What is left of a message: the last ``left`` bits of a number."""

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

    def packed(self) -> bytes:
        """Return the bytes of a value that is packed by itself, behind their number."""
        count = self.take(8)
        if count >= 0xC0:
            raise ValueError(f"must have parts of at most {_MOST_OPEN_BYTES} bytes each")
        count = (count & 0x3F) << 8 | self.take(8) if count >= 0x80 else count
        return self.take(8 * count).to_bytes(count, "big")


def _read(kind: Type, bits: _Bits) -> Any:
    """Return the next value."""
    is_extended = getattr(kind, "extensible", False) and bits.take(1) == 1
    if is_extended and not isinstance(kind, Record):
        raise ValueError("must have no alternatives and no longer lists than this version knows")
    match kind:
        case Whole(low, high):
            return bits.number(low, high)
        case Flag():
            return bits.take(1) == 1
        case Record(members):
            there = [not member.endswith("?") or bits.take(1) == 1 for member in members]
            present = (item for item, is_there in zip(members.items(), there, strict=True) if is_there)
            value = {member.rstrip("?"): _read(of, bits) for member, of in present}
            if is_extended:
                # How many members a later version has, which of them are there, and each one's bytes.
                if bits.take(1):
                    raise ValueError("must have at most 64 members that this version does not know")
                for _ in range(sum([bits.take(1) for _ in range(bits.take(6) + 1)])):
                    bits.packed()
            return value
        case Several(of, least, most):
            return [_read(of, bits) for _ in range(bits.number(least, most))]
        case Choice(alternatives):
            chosen = list(alternatives)[bits.number(0, len(alternatives) - 1)]
            return {chosen: _read(alternatives[chosen], bits)}
        case Numbered(low, high, numbered):
            number, content = bits.number(low, high), bits.packed()
            return {numbered[number][0]: decode(numbered[number][1], content)} if number in numbered else {}
