"""Flat tables: frozen dataclasses of plain values from and to JSON and TOML, and the TOML files of the package."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields
from importlib import resources
from typing import Any

ALL = "all"
"""Stands for a whole table of names."""

_TYPES: dict[str, Any] = {"str": str, "int": int, "float": (int, float), "bool": bool}


def from_dict(
    cls: type[Any],
    table: Mapping[str, Any],
    what: str,
    whole: Mapping[str, Iterable[str]] | None = None,
    without: Iterable[str] = (),
) -> dict[str, Any]:
    """Return the fields of the dataclass ``cls`` from plain values: keys as its fields, lists for tuples.

    Args:
        cls: whose fields are str, int, float, bool, or tuples of one of them.
        table: the plain values.
        what: a table of this kind is called in messages.
        whole: by key the names that ``all`` stands for.
        without: fields that are no plain values, which the caller adds.

    Raises:
        ValueError: a key is missing or unknown, or a value is of another type.
    """
    types = {item.name: str(item.type) for item in fields(cls) if item.name not in without}
    if table.keys() != types.keys():
        wrong = ", ".join(sorted(table.keys() ^ types.keys()))
        raise ValueError(f"a {what} must have the keys {', '.join(types)}; missing or unknown: {wrong}")
    names = whole or {}
    return {
        key: tuple(names[key]) if key in names and table[key] == ALL else _typed(key, table[key], kind)
        for key, kind in types.items()
    }


def _typed(key: str, value: Any, kind: str) -> Any:
    if kind.startswith("tuple"):
        item = kind.removeprefix("tuple[").split(",")[0]
        if not isinstance(value, list):
            raise ValueError(f"{key} must be a list, got {value!r}")
        if "..." not in kind and len(value) != 2:
            raise ValueError(f"{key} must be two numbers, got {value}")
        return tuple(_typed(key, one, item) for one in value)
    if not isinstance(value, _TYPES[kind]) or (kind != "bool" and isinstance(value, bool)):
        raise ValueError(f"{key} must be {kind}, got {value!r}")
    return float(value) if kind == "float" else value


def to_dict(flat: Any) -> dict[str, Any]:
    """Return a dataclass of plain values and tuples as what :func:`from_dict` takes."""
    return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(flat).items()}


def preset_names(folder: str) -> tuple[str, ...]:
    """Return the names of the TOML files in a folder of the package, in alphabetical order."""
    entries = resources.files("viewshed_lab").joinpath(folder).iterdir()
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in entries if entry.name.endswith(".toml")))


def load_preset(folder: str, name: str) -> dict[str, Any]:
    """Return one of the TOML files in a folder of the package, its name among its values.

    A file that is ``like`` another has only what differs from that.

    Raises:
        ValueError: there is none of that name; the message lists those that exist.
    """
    names = preset_names(folder)
    if name not in names:
        raise ValueError(f"preset must be one of {', '.join(names)}, got {name!r}")
    raw = resources.files("viewshed_lab").joinpath(folder, f"{name}.toml").read_text(encoding="utf-8")
    own = tomllib.loads(raw)
    like = own.pop("like", "")
    return (load_preset(folder, like) if like else {}) | {"name": name} | own
