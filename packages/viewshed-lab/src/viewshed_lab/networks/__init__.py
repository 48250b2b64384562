"""Networks of the published study, in int8 where that costs little, with checksums; viewshed loads them by name."""

from pathlib import Path

WEIGHTS = Path(__file__).parent
"""Folder of the network files; ``tools/ship_study.py`` writes them."""
