"""An extension of griffe: roles of docstrings (``:class:`~a.b.C```) are code on the pages of the site."""

import re
from typing import Any

import griffe

ROLE = re.compile(r":(?:class|func|meth|data|mod|attr|obj):`(~?)([^`]+)`")


class Roles(griffe.Extension):
    """Turns roles into code, shortened to the last name where they begin with ``~``."""

    def on_instance(self, *, obj: Any, **_: Any) -> None:
        """Rewrite the docstring of an object, before it is parsed."""
        if obj.docstring:
            obj.docstring.value = ROLE.sub(_code, obj.docstring.value)


def _code(role: re.Match[str]) -> str:
    return f"`{role[2].rpartition('.')[2] if role[1] else role[2]}`"
