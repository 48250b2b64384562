"""An extension of griffe: roles (``:class:`~a.b.C```) and doctests of docstrings are code on the pages of the site."""

import re
from typing import Any

import griffe

ROLE = re.compile(r":(?:class|func|meth|data|mod|attr|obj):`(~?)([^`]+)`")
DOCTEST = re.compile(r"^>>> .*?(?=\n\n|\Z)", re.MULTILINE | re.DOTALL)


class Roles(griffe.Extension):  # type: ignore[misc]  # griffe is not looked at
    """Turns roles into code, shortened to the last name where they begin with ``~``, and doctests into blocks."""

    def on_object(self, *, obj: Any, **_: Any) -> None:
        """Rewrite the docstring of an object, before it is parsed."""
        if not obj.is_alias and obj.docstring:
            text = ROLE.sub(_code, obj.docstring.value)
            obj.docstring.value = DOCTEST.sub(lambda block: f"```pycon\n{block[0]}\n```", text)


def _code(role: re.Match[str]) -> str:
    return f"`{role[2].rpartition('.')[2] if role[1] else role[2]}`"
