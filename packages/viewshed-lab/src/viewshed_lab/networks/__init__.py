"""Networks of the published study, in bytes, with their checksums; viewshed finds them by their names."""

from pathlib import Path

WEIGHTS = Path(__file__).parent
"""Folder of the networks; ``tools/ship_study.py`` writes it."""
