"""Check Ed25519 public keys (RFC 8032, section 5.1) for points for which only the key's owner can sign.

For a point of small order anyone can forge a signature that libraries accept. Python integers are fast enough, because
a key is checked once, when it is loaded.
"""

from __future__ import annotations

_PRIME = 2**255 - 19
_D = -121665 * pow(121666, -1, _PRIME) % _PRIME
_ROOT_OF_MINUS_1 = pow(2, (_PRIME - 1) // 4, _PRIME)


def has_large_order(public: bytes) -> bool:
    """Return whether 32 bytes are the canonical encoding of a point whose order does not divide 8."""
    point = _decode(public)
    for _ in range(3):
        point = None if point is None else _double(*point)
    return point is not None and point != (0, 1)


def _decode(public: bytes) -> tuple[int, int] | None:
    """Return x and y of an encoded point (section 5.1.3), or None if it is invalid."""
    number = int.from_bytes(public, "little")
    y, sign = number & (2**255 - 1), number >> 255
    if y >= _PRIME:
        return None
    # x² = (y² - 1) / (d y² + 1). Its power (p + 3) / 8 is a square root of it, or of it times -1.
    square = (y * y - 1) * pow(_D * y * y + 1, -1, _PRIME) % _PRIME
    x = pow(square, (_PRIME + 3) // 8, _PRIME)
    if (x * x - square) % _PRIME:
        x = x * _ROOT_OF_MINUS_1 % _PRIME
    if (x * x - square) % _PRIME or (x == 0 and sign):
        return None
    return (x if x & 1 == sign else _PRIME - x), y


def _double(x: int, y: int) -> tuple[int, int]:
    """Return a point added to itself; the denominators are never zero on this curve."""
    product = _D * x * x * y * y % _PRIME
    twice_x = 2 * x * y * pow(1 + product, -1, _PRIME) % _PRIME
    return twice_x, (y * y + x * x) * pow(1 - product, -1, _PRIME) % _PRIME
