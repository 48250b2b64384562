"""The page on corruptions: its table of severities is the program's."""

import re
from dataclasses import fields, is_dataclass
from pathlib import Path

from viewshed._page import table
from viewshed.threats.corruptions import SEVERITIES, Corruption, Weather

PAGE = Path(__file__).resolve().parents[3] / "docs" / "corruptions.md"
WEATHER = ("extinction_per_m", "particles_per_m", "particle_reach", "wet", "noise")


def _value(corruption: Corruption, name: str) -> str:
    return f"{getattr(corruption.conditions if isinstance(corruption, Weather) else corruption, name):g}"


def _parameters(corruption: Corruption) -> list[str]:
    if isinstance(corruption, Weather):
        return list(WEATHER)
    assert is_dataclass(corruption)
    return [field.name for field in fields(corruption)]


def severities_table() -> str:
    """The table as the page must have it."""
    rows = [
        [f"`{name}`", f"`{parameter}`", *(_value(step, parameter) for step in steps)]
        for name, steps in SEVERITIES.items()
        for parameter in _parameters(steps[0])
    ]
    return table(["name", "parameter", "1", "2", "3", "4", "5"], rows)


def test_the_table_of_severities_is_that_of_the_program() -> None:
    found = re.search(r"<!-- severities.*?-->\n(.*?)\n<!-- end of severities -->", PAGE.read_text("utf-8"), re.DOTALL)
    assert found is not None
    assert found[1].strip() == severities_table(), "python tests/corruptions/test_page.py writes it"


if __name__ == "__main__":
    text = PAGE.read_text("utf-8")
    new = re.sub(r"(<!-- severities.*?-->\n).*?(<!-- end)", rf"\g<1>{severities_table()}\n\g<2>", text, flags=re.DOTALL)
    PAGE.write_text(new, "utf-8")
