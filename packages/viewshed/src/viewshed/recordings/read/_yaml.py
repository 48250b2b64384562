"""Read untrusted YAML as plain values: bytes, depth and aliases are limited, tags are ignored."""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

from viewshed._extras import needed_for
from viewshed.io._input import open_input

_MAX_BYTES = 4_000_000
_MAX_DEPTH = 50
_MAX_NODES = 200_000
_DIRECTIVE = re.compile(r"(?:^|[\r\n\x85\u2028\u2029])%")

_PLAIN = {
    "float": r"(?=.{1,64}\Z)(?:[-+]?(?:[0-9]+\.[0-9]*|\.[0-9]+|[0-9]{19,}|[0-9]+(?=[eE]))(?:[eE][-+]?[0-9]{1,3})?"
    r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))",
    "int": r"[-+]?[0-9]{1,18}",
    "bool": r"true|True|TRUE|false|False|FALSE",
    "null": r"~|null|Null|NULL|",
    "tag:yaml.org,2002:merge": r"<<",
}
"""Tag → pattern of unquoted text; our own patterns, so that every constructor gets only checked text.

Integers to base 60 can take minutes to parse: they stay text."""


def read_yaml(path: Path) -> Any:
    """Read the first document of a YAML file as dicts, lists, text, numbers, booleans and None.

    Integers of more than 18 digits become floats; Python objects and other unknown tags become None.
    """
    yaml = load_pyyaml()
    with open_input(path) as source:
        text = source.content(_MAX_BYTES).decode("utf-8-sig")
        if _DIRECTIVE.search(text):
            raise ValueError("must be YAML without directives (lines that begin with %)")
        loader = _loader()
        try:
            _check_bounds(yaml, yaml.parse(text, loader))
            return next(yaml.load_all(text, loader), None)
        except yaml.YAMLError as error:
            raise ValueError(f"is not YAML: {error}") from error


def load_pyyaml() -> Any:
    """Import PyYAML; raise ImportError if the extra ``opv2v`` is not installed."""
    with needed_for("reading OPV2V"):
        import yaml
    return yaml


def _check_bounds(yaml: Any, events: Iterable[Any]) -> None:
    """Check depth and nodes of the first document: PyYAML's composer recurses in C without a limit."""
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
            if len(containers) > _MAX_DEPTH:
                raise ValueError(f"YAML must be at most {_MAX_DEPTH} levels deep")
        elif isinstance(event, ends):
            anchor, before = containers.pop()
            nodes_of[anchor] = nodes - before
        elif isinstance(event, yaml.AliasEvent):
            if event.anchor not in nodes_of:  # also true for a node inside itself
                raise ValueError(f"YAML alias {event.anchor!r} stands for nothing before it")
            nodes += nodes_of[event.anchor]
        elif isinstance(event, yaml.DocumentEndEvent):
            return
        if nodes > _MAX_NODES:
            raise ValueError(f"YAML must have at most {_MAX_NODES} nodes, aliases counted as what they stand for")


@cache
def _loader() -> Any:
    """Return PyYAML's safe loader, restricted to the values of ``_PLAIN`` and without tags."""
    base: Any = load_pyyaml().CSafeLoader
    prefix = "tag:yaml.org,2002:"

    class Loader(base):  # type: ignore[misc]
        yaml_implicit_resolvers: ClassVar[Any] = {
            None: [(tag, re.compile(f"(?:{form})\\Z")) for tag, form in _PLAIN.items()]
        }
        yaml_constructors: ClassVar[Any] = {
            **{prefix + name: base.yaml_constructors[prefix + name] for name in ("str", "seq", "map")},
            "bool": base.yaml_constructors[prefix + "bool"],
            "int": lambda _, node: int(node.value),
            "float": lambda _, node: float(node.value.lower().replace(".inf", "inf").replace(".nan", "nan")),
            None: lambda _, node: None,
        }

    return Loader
