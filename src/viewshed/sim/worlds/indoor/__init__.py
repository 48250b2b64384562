"""The worlds inside buildings."""

from __future__ import annotations

__all__ = ["corridors", "hall", "rooms", "warehouse"]
