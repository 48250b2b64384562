"""The page on defenses: it names every one of them, and its table of parameters is the program's."""

import re
from dataclasses import fields, is_dataclass
from pathlib import Path

from viewshed._page import table
from viewshed.threats.defenses import DEFENSES

PAGE = Path(__file__).resolve().parents[3] / "docs" / "defenses.md"


def parameters_table() -> str:
    """The table as the page must have it."""
    rows: list[list[str]] = []
    for name, make in DEFENSES.items():
        defense = make()
        assert is_dataclass(defense)
        values = {field.name: getattr(defense, field.name) for field in fields(defense) if field.init}
        rows += [
            [f"`{name}`", f"`{key}`", f"{value:g}"] for key, value in values.items() if isinstance(value, int | float)
        ]
    return table(["name", "parameter", "default"], rows)


def test_the_table_of_parameters_is_that_of_the_program() -> None:
    found = re.search(r"<!-- parameters.*?-->\n(.*?)\n<!-- end of parameters -->", PAGE.read_text("utf-8"), re.DOTALL)
    assert found is not None
    assert found[1].strip() == parameters_table(), "python tests/defenses/test_page.py writes it"


def test_every_defense_is_named() -> None:
    words = PAGE.read_text("utf-8")
    assert [name for name in DEFENSES if f"| `{name}` |" not in words] == []


if __name__ == "__main__":
    text = PAGE.read_text("utf-8")
    new = re.sub(r"(<!-- parameters.*?-->\n).*?(<!-- end)", rf"\g<1>{parameters_table()}\n\g<2>", text, flags=re.DOTALL)
    PAGE.write_text(new, "utf-8")
