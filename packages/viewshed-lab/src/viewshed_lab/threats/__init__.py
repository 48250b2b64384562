"""Sweeps as a spoofer, weather or a fault leaves them, and defenses against them."""
