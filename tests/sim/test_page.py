"""The simulator's page: its table of materials is the program's, and it names every kind of world."""

import re
from pathlib import Path

import numpy as np

from viewshed._page import table
from viewshed.sim.assets.shapes import MATERIALS
from viewshed.sim.lidar.weather import CONDITIONS
from viewshed.sim.worlds import WORLDS

PAGE = Path(__file__).resolve().parents[2] / "docs" / "simulator.md"


def materials_table() -> str:
    """The table as the page must have it."""
    header = ("material", "reflectivity", "stops per meter", "a beam that crosses 1 m passes")
    rows = [
        (one.name, f"{one.reflectivity:g}", "–" if np.isinf(one.per_m) else f"{one.per_m:g}",
         "never" if np.isinf(one.per_m) else f"{np.exp(-one.per_m):.2g}")
        for one in MATERIALS
    ]  # fmt: skip
    return table(header, rows)


def test_the_table_of_materials_is_that_of_the_program() -> None:
    found = re.search(r"<!-- materials.*?-->\n(.*?)\n<!-- end of materials -->", PAGE.read_text("utf-8"), re.DOTALL)
    assert found is not None
    assert found[1].strip() == materials_table(), "python tests/test_simulator_page.py writes it"


def test_every_world_and_condition_is_named() -> None:
    words = PAGE.read_text("utf-8")
    assert [name for name in WORLDS if f"`{name}`" not in words] == []
    assert [name for name in CONDITIONS if f"`{name}`" not in words] == []


if __name__ == "__main__":
    text = PAGE.read_text("utf-8")
    new = re.sub(r"(<!-- materials.*?-->\n).*?(<!-- end)", rf"\g<1>{materials_table()}\n\g<2>", text, flags=re.DOTALL)
    PAGE.write_text(new, "utf-8")
