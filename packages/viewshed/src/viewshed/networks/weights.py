"""Weights shipped with a package: a manifest of names, files and checksums.

Other installed packages add folders of weights by entry points of the group ``viewshed.weights``.

The last metadata entry of a network's file is the SHA-256 of all bytes before it. This checksum detects damage, not
forgery: anybody can compute it. :mod:`viewshed.networks.inspection` limits what a file can make an engine do.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path

from viewshed._extras import load, plugins
from viewshed._files import write_atomic
from viewshed.grid import BevGrid

CARD_KEY = "viewshed.card"
"""Metadata key of the card in a file."""

_KEY = b"viewshed.sha256"

_DIGITS = 64

# Encoded metadata entry: field 14 (metadata_props) of onnx.ModelProto, then its key (1) and the head of its value (2).
_HEAD = (
    bytes([14 << 3 | 2, 4 + len(_KEY) + _DIGITS, 1 << 3 | 2, len(_KEY)]) + _KEY + bytes([2 << 3 | 2, _DIGITS])
)  # fmt: skip


def with_checksum(model: bytes) -> bytes:
    """Return a serialized ONNX model with the checksum of its bytes appended as a metadata entry."""
    return model + _HEAD + hashlib.sha256(model).hexdigest().encode()


def verify_checksum(content: bytes, name: str) -> None:
    """Raise ValueError unless ``content`` ends with its own checksum; ``name`` is the file's name in the message.

    >>> verify_checksum(with_checksum(b"model"), "a.onnx")
    >>> verify_checksum(with_checksum(b"model").replace(b"m", b"n", 1), "a.onnx")
    Traceback (most recent call last):
    ...
    ValueError: a.onnx must have the checksum 9372c470ee…, got 6499ba3c93…: it is damaged; copy it again
    """
    model, end = content[: -_DIGITS - len(_HEAD)], content[-_DIGITS - len(_HEAD) :]
    if not end.startswith(_HEAD):
        raise ValueError(
            f"{name} must be a network that viewshed exported, got a file that is cut short or another; copy it again,"
            " or export it with viewshed train"
        )
    actual, expected = hashlib.sha256(model).hexdigest(), end[-_DIGITS:].decode("ascii", "replace")
    if actual != expected:
        raise ValueError(
            f"{name} must have the checksum {expected[:10]}…, got {actual[:10]}…: it is damaged; copy it again"
        )


WEIGHTS = Path(__file__).parent / "weights"
"""Folder of viewshed's own weights."""

_MANIFEST = "manifest.json"


@dataclass(frozen=True, slots=True)
class ShippedWeights:
    """One entry of the manifest."""

    name: str  # name of the weights
    file: str  # file name in the folder
    sha256: str  # checksum of the file
    cells: int  # cells per side of the grid
    half_extent_m: float  # half extent of the grid
    target: str  # name of the target
    # estimators that use it by default: ``unet``, ``mc_dropout``; may be empty
    methods: tuple[str, ...]


def manifest(folder: Path = WEIGHTS) -> dict[str, ShippedWeights]:
    """Return the shipped weights by name; empty if there is no manifest."""
    path = folder / _MANIFEST
    if not path.is_file():
        return {}
    lines = json.loads(path.read_text(encoding="utf-8"))
    return {line["name"]: ShippedWeights(**{**line, "methods": tuple(line["methods"])}) for line in lines}


def _folders() -> dict[Path, str]:
    """Return folder of weights → name of its package, viewshed's own first."""
    added = {
        load(point, lambda folder: isinstance(folder, Path), "a folder"): point.dist.name if point.dist else point.name
        for point in plugins("weights").values()
    }
    return {WEIGHTS: "viewshed"} | added


def shipped_names() -> tuple[str, ...]:
    """Return the names of the weights shipped by viewshed and other installed packages."""
    return tuple(dict.fromkeys(name for folder in _folders() for name in manifest(folder)))


def shipped_content(name: str) -> bytes:
    """Return the bytes of the shipped weights called ``name``.

    Raises:
        ValueError: the file is damaged: it does not have the checksum of the manifest.
    """
    folder, package = next((folder, package) for folder, package in _folders().items() if name in manifest(folder))
    line = manifest(folder)[name]
    content = (folder / line.file).read_bytes()
    actual = hashlib.sha256(content).hexdigest()
    if actual != line.sha256:
        raise ValueError(
            f"{line.file} must have the checksum {line.sha256[:10]}…, got {actual[:10]}…: it is damaged; install"
            f" {package} again"
        )
    return content


def default_name(method: str, grid: BevGrid, target: str, folder: Path = WEIGHTS) -> str:
    """Return the name of viewshed's default weights of ``method`` on ``grid`` for the target of this name.

    Raises:
        ValueError: no such weights are shipped.
    """
    known = manifest(folder)
    for name, line in known.items():
        fits = (line.cells, line.half_extent_m, (0.0, 0.0)) == (grid.cells, grid.half_extent_m, grid.offset_m)
        if fits and line.target == target and method in line.methods:
            return name
    fitting = ", ".join(f"{x.cells}x{x.half_extent_m:g} ({x.target})" for x in known.values() if method in x.methods)
    raise ValueError(
        f"method {method} needs weights, and this version ships none for a {target} on a grid of"
        f" {grid.cells}x{grid.half_extent_m:g}, only for: {fitting or 'nothing'}; give --weights FILE of a network that"
        " viewshed train exported"
    )


def add_shipped(content: bytes, line: ShippedWeights, folder: Path = WEIGHTS) -> None:
    """Write weights and their manifest entry into ``folder``; an existing entry of that name is replaced."""
    folder.mkdir(parents=True, exist_ok=True)
    write_atomic(folder / line.file, content)
    lines = {**manifest(folder), line.name: line}
    text = json.dumps([asdict(entry) for entry in lines.values()], indent=1) + "\n"
    write_atomic(folder / _MANIFEST, text.encode())
