"""YAML of unknown origin as plain values: bytes, depth and aliases are bounded, nothing is built by tags."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from viewshed._extras import needed_for
from viewshed.io._input import open_input

_BYTES_MAX = 4_000_000
_DEPTH_MAX = 50
_NODES_MAX = 200_000
_NUMBER_LETTERS = 64
_DIRECTIVE = re.compile(r"(?:^|[\r\n\x85\u2028\u2029])%")
_PYTHON = "tag:yaml.org,2002:python/"
_TEXT = "tag:yaml.org,2002:str"
_INT = re.compile(r"[-+]?[0-9]{1,18}")
_FLOAT = re.compile(
    r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]{1,3})?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)"
)

_WORDS: dict[str, bool | None] = {
    "": None, "~": None, "null": None, "Null": None, "NULL": None,
    "true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False,
}  # fmt: skip


def read_yaml(path: Path) -> Any:
    """Return what a YAML file says, as dicts, lists, text, numbers, booleans and None.

    The parser's composer recurses in C and dies of deep nesting, and its constructor follows merges and base-60
    integers for minutes. So only its events are used, which come one by one, and values are built here: aliases share
    one value and count as what they stand for, whole numbers of more than 18 digits are floats, and objects of Python
    are None.

    Raises:
        ValueError: it is no YAML, is too large or too deep, or refers to itself.
        ImportError: the extra ``opv2v`` is not installed.
        OSError: it cannot be read.
    """
    yaml = load_pyyaml()
    with open_input(path) as source:
        text = source.content(_BYTES_MAX).decode("utf-8-sig")
        if _DIRECTIVE.search(text):
            raise ValueError("must be YAML without directives (lines that begin with %)")
        try:
            return _build(yaml, yaml.parse(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader)))
        except yaml.YAMLError as error:
            raise ValueError(f"is not YAML: {error}") from error


def load_pyyaml() -> Any:
    """Return PyYAML; an ImportError where the extra ``opv2v`` is not installed."""
    with needed_for("reading OPV2V"):
        import yaml
    return yaml


@dataclass(slots=True)
class _Container:
    """A mapping or list that is not complete: what it holds, how many nodes these are, and a key without its value."""

    value: dict[Any, Any] | list[Any]
    anchor: str | None
    dropped: bool
    nodes: int = 1
    key: list[Any] = field(default_factory=list)
    merged: list[Any] = field(default_factory=list)

    def add(self, value: Any, nodes: int) -> None:
        self.nodes += nodes
        if isinstance(self.value, list):
            self.value.append(value)
        elif not self.key:
            if isinstance(value, dict | list):
                raise ValueError("a key of a mapping must be text or a number")
            self.key.append(value)
        elif (key := self.key.pop()) == "<<":
            self.merged += value if isinstance(value, list) else [value]
        else:
            self.value[key] = value

    def complete(self) -> Any:
        """Return the value; what is merged in does not replace what is there."""
        for other in self.merged:
            if not isinstance(other, dict) or not isinstance(self.value, dict):
                raise ValueError("what is merged into a mapping must be a mapping")
            self.value = other | self.value
        return None if self.dropped else self.value


def _build(yaml: Any, events: Iterable[Any]) -> Any:
    """Return the value of the first document of an event stream."""
    anchors: dict[str, tuple[Any, int]] = {}
    stack: list[_Container] = []
    total = 0
    for event in events:
        match event:
            case yaml.MappingStartEvent() | yaml.SequenceStartEvent():
                if len(stack) >= _DEPTH_MAX:
                    raise ValueError(f"YAML must be at most {_DEPTH_MAX} levels deep")
                value: Any = {} if isinstance(event, yaml.MappingStartEvent) else []
                stack.append(_Container(value, event.anchor, str(event.tag).startswith(_PYTHON)))
                continue
            case yaml.MappingEndEvent() | yaml.SequenceEndEvent():
                done = stack.pop()
                value, nodes, anchor = done.complete(), done.nodes, done.anchor
                total += 1
            case yaml.ScalarEvent():
                value, nodes, anchor = _scalar(event), 1, event.anchor
                total += 1
            case yaml.AliasEvent():
                if event.anchor not in anchors:
                    raise ValueError(f"YAML alias {event.anchor!r} stands for nothing before it")
                (value, nodes), anchor = anchors[event.anchor], None
                total += nodes
            case _:
                continue
        if total > _NODES_MAX:
            raise ValueError(f"YAML must have at most {_NODES_MAX} nodes, aliases counted as what they stand for")
        if anchor is not None:
            anchors[anchor] = (value, nodes)
        if not stack:
            return value
        stack[-1].add(value, nodes)
    return None


def _scalar(event: Any) -> Any:
    text: str = event.value
    if event.tag is not None and event.tag not in {_TEXT, "!"}:
        return None
    if event.tag is not None or not event.implicit[0]:
        return text
    if text in _WORDS:
        return _WORDS[text]
    if _INT.fullmatch(text):
        return int(text)
    if len(text) <= _NUMBER_LETTERS and _FLOAT.fullmatch(text):
        return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
    return text
