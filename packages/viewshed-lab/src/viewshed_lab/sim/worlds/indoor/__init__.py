"""The worlds inside buildings."""

from __future__ import annotations

__all__ = ["atrium", "corridors", "hall", "loft", "rooms", "tunnel", "warehouse"]
