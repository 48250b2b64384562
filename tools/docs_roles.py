"""A griffe extension that prepares docstrings and the comments of class fields for the site.

Roles (``:class:`~a.b.C```) and doctests become code; comments of fields become a section of the class's docstring.
"""

import re
from collections.abc import Iterator
from itertools import takewhile
from typing import Any

import griffe

ROLE = re.compile(r":(?:class|func|meth|data|mod|attr|obj):`(~?)([^`]+)`")
DOCTEST = re.compile(r"^>>> .*?(?=\n\n|\Z)", re.MULTILINE | re.DOTALL)


FIELD = re.compile(r"^\s+\w+: [^#]*  # (?!type:|noqa|fmt:)(.+)$")


class Roles(griffe.Extension):  # type: ignore[misc]  # griffe is not looked at
    """Turns roles into code (shortened to the last name if they begin with ``~``), and doctests into code blocks."""

    def on_object(self, *, obj: Any, **_: Any) -> None:
        """Rewrite the docstring of an object before it is parsed."""
        if not obj.is_alias and obj.docstring:
            text = ROLE.sub(_code, obj.docstring.value)
            obj.docstring.value = DOCTEST.sub(lambda block: f"```pycon\n{block[0]}\n```", text)
            if obj.is_class and (fields := list(_fields(obj))):
                obj.docstring.value += "\n\nAttributes:\n" + "\n".join(f"    {field}" for field in fields)


def _fields(of_class: Any) -> Iterator[str]:
    """Yield "name: comment" for each field with a comment, behind it or in the lines above."""
    if of_class.filepath.suffix != ".py":
        return  # the compiled core has no source lines
    lines = of_class.lines_collection[of_class.filepath]
    for name, member in of_class.members.items():
        if not member.is_alias and member.is_attribute and not name.startswith("_") and member.lineno:
            behind = FIELD.match(lines[member.endlineno - 1])
            before = takewhile(lambda line: line.lstrip().startswith("# "), reversed(lines[: member.lineno - 1]))
            words = behind[1] if behind else " ".join(line.strip()[2:] for line in reversed(list(before)))
            if words:
                yield f"{name}: {ROLE.sub(_code, words).rstrip('.')}."


def _code(role: re.Match[str]) -> str:
    return f"`{role[2].rpartition('.')[2] if role[1] else role[2]}`"
