"""The attacks' page: its table is the program's."""

import re
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from viewshed import Sweep
from viewshed._page import table
from viewshed.threats.attacks import ATTACKS, FAMILY, FREE_FORM, INFORMED, Knowledge

PAGE = Path(__file__).resolve().parents[3] / "docs" / "attacks.md"
NOT_TOLD = {"spoofer", "mode", "earlier", "first", "first_ns"}


def attacks_table() -> str:
    """The table as the page must have it."""
    knowledge = Knowledge((Sweep([[1.0, 0.0, 0.0]]),))  # type: ignore[arg-type]
    rows = []
    for name, make in (ATTACKS | INFORMED).items():
        attack: Any = make(None, knowledge)
        told = [f"`{f.name}` {_text(getattr(attack, f.name))}" for f in fields(attack) if f.name not in NOT_TOLD]
        what = str(type(attack).__doc__).splitlines()[0].split(": ")[0].removesuffix(".")
        mode = "free-form" if name in FREE_FORM else "–" if name == "pose_spoof" else "on beams"
        rows.append([str(FAMILY[name]), f"`{name}`", mode, what, ", ".join(told)])
    return table(("family", "name", "mode", "what", "defaults"), rows)


def _text(value: object) -> str:
    if isinstance(value, tuple):
        return "(" + ", ".join(_text(part) for part in value) + ")"
    return f"{value:g}" if isinstance(value, float) else str(value)


def test_the_table_of_attacks_is_that_of_the_program() -> None:
    found = re.search(r"<!-- attacks.*?-->\n(.*?)\n<!-- end of attacks -->", PAGE.read_text("utf-8"), re.DOTALL)
    assert found is not None
    assert found[1].strip() == attacks_table(), "python tests/threats/attacks/test_page.py writes it"


@pytest.mark.slow
def test_the_python_of_the_page_runs() -> None:
    scope: dict[str, object] = {}
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    said = 0
    for line in "".join(blocks).splitlines():
        code, _, expected = line.partition("# →")
        if expected:
            assert str(eval(code, scope)) == expected.strip(), line
            said += 1
        else:
            exec(code, scope)
    assert said == 2


if __name__ == "__main__":
    text = PAGE.read_text("utf-8")
    new = re.sub(r"(<!-- attacks.*?-->\n).*?(<!-- end)", rf"\g<1>{attacks_table()}\n\g<2>", text, flags=re.DOTALL)
    PAGE.write_text(new, "utf-8")
