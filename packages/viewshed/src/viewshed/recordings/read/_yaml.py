"""YAML of unknown origin as plain values: bytes, depth and aliases are bounded, nothing is built by tags."""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

from viewshed._extras import needed_for
from viewshed.io._input import open_input

_BYTES_MAX = 4_000_000
_DEPTH_MAX = 50
_NODES_MAX = 200_000
_DIRECTIVE = re.compile(r"(?:^|[\r\n\x85\u2028\u2029])%")

_PLAIN = {
    "float": r"(?=.{1,64}\Z)(?:[-+]?(?:[0-9]+\.[0-9]*|\.[0-9]+|[0-9]{19,}|[0-9]+(?=[eE]))(?:[eE][-+]?[0-9]{1,3})?"
    r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))",
    "int": r"[-+]?[0-9]{1,18}",
    "bool": r"true|True|TRUE|false|False|FALSE",
    "null": r"~|null|Null|NULL|",
    "tag:yaml.org,2002:merge": r"<<",
}
"""Text without quotes that is a value, by tag: own ones, so that no tag of a file needs what is not checked here.

Integers to base 60 take minutes: they stay text."""


def read_yaml(path: Path) -> Any:
    """Return the first document of a YAML file as dicts, lists, text, numbers, booleans and None.

    Whole numbers of more than 18 digits are floats; objects of Python and of other unknown tags are None.
    """
    yaml = load_pyyaml()
    with open_input(path) as source:
        text = source.content(_BYTES_MAX).decode("utf-8-sig")
        if _DIRECTIVE.search(text):
            raise ValueError("must be YAML without directives (lines that begin with %)")
        loader = _loader()
        try:
            _check_bounds(yaml, yaml.parse(text, loader))
            return next(yaml.load_all(text, loader), None)
        except yaml.YAMLError as error:
            raise ValueError(f"is not YAML: {error}") from error


def load_pyyaml() -> Any:
    """Return PyYAML; an ImportError where the extra ``opv2v`` is not installed."""
    with needed_for("reading OPV2V"):
        import yaml
    return yaml


def _check_bounds(yaml: Any, events: Iterable[Any]) -> None:
    """Check depth and nodes of the first document, for the parser's composer recurses in C without a bound."""
    starts, ends = (yaml.MappingStartEvent, yaml.SequenceStartEvent), (yaml.MappingEndEvent, yaml.SequenceEndEvent)
    containers: list[tuple[str | None, int]] = []
    nodes_of: dict[str | None, int] = {}
    nodes = 0
    for event in events:
        if isinstance(event, yaml.ScalarEvent):
            nodes_of[event.anchor] = 1
            nodes += 1
        elif isinstance(event, starts):
            containers.append((event.anchor, nodes))
            nodes += 1
            if len(containers) > _DEPTH_MAX:
                raise ValueError(f"YAML must be at most {_DEPTH_MAX} levels deep")
        elif isinstance(event, ends):
            anchor, before = containers.pop()
            nodes_of[anchor] = nodes - before
        elif isinstance(event, yaml.AliasEvent):
            if event.anchor not in nodes_of:  # nor does what it is in stand before it
                raise ValueError(f"YAML alias {event.anchor!r} stands for nothing before it")
            nodes += nodes_of[event.anchor]
        elif isinstance(event, yaml.DocumentEndEvent):
            return
        if nodes > _NODES_MAX:
            raise ValueError(f"YAML must have at most {_NODES_MAX} nodes, aliases counted as what they stand for")


@cache
def _loader() -> Any:
    """Return PyYAML's safe loader that knows the values of ``_PLAIN`` and no tags."""
    base: Any = load_pyyaml().CSafeLoader
    own = "tag:yaml.org,2002:"

    class Loader(base):  # type: ignore[misc]
        yaml_implicit_resolvers: ClassVar[Any] = {
            None: [(tag, re.compile(f"(?:{form})\\Z")) for tag, form in _PLAIN.items()]
        }
        yaml_constructors: ClassVar[Any] = {
            **{own + name: base.yaml_constructors[own + name] for name in ("str", "seq", "map")},
            "bool": base.yaml_constructors[own + "bool"],
            "int": lambda _, node: int(node.value),
            "float": lambda _, node: float(node.value.lower().replace(".inf", "inf").replace(".nan", "nan")),
            None: lambda _, node: None,
        }

    return Loader
