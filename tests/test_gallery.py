"""The gallery shows ten real situations, and none whose license forbids to publish what is made of it."""

import json
from pathlib import Path

import gallery

from viewshed import CellState

DOCS = Path(__file__).parents[1] / "docs"


def test_ten_situations_each_with_a_picture_and_a_license() -> None:
    shown = gallery.situations()
    page = (DOCS / "gallery.md").read_text(encoding="utf-8")
    assert len({one.name for one in shown}) == 10
    for one in shown:
        assert (DOCS / "assets" / "gallery" / f"{one.name}.png").stat().st_size > 20_000
        assert f"*{one.source}.*" in page
        assert one.source.rpartition(", ")[2] in {"CC BY 4.0", "BSD-3-Clause", "Apache-2.0", "MIT"}


def test_licenses_are_those_of_the_index(real_data: Path) -> None:
    for folder in ("data", "recordings"):
        place = real_data.parent / folder / "index.json"
        if not place.exists():
            continue
        licenses = {entry["file"]: entry["licence"] for entry in json.loads(place.read_text(encoding="utf-8"))}
        for one in gallery.situations():
            if one.folder == folder:
                assert one.source.rpartition(", ")[2] in licenses[one.file], one.name
                assert "NC" not in licenses[one.file], one.name


def test_a_situation_is_estimated_from_its_file(real_data: Path) -> None:
    office = next(one for one in gallery.situations() if one.name == "office")
    leveled, estimate = gallery.estimate_of(office, real_data.parent)
    assert (estimate.target.name, estimate.grid.half_extent_m) == ("pedestrian", 16.0)
    assert estimate.basis is not None
    assert estimate.basis.height_source == "assumed"
    # Within the room alone: what lies behind its walls is hidden.
    assert 0.05 < estimate.share(CellState.FREE) < 0.2
    assert estimate.share(CellState.HIDDEN) > 0.7
    assert len(leveled.points) > 10_000
