"""Attacks on a sweep."""

from viewshed.attacks.tampering import Attack, Tampered, Wedge

__all__ = ["Attack", "Tampered", "Wedge"]
