"""Optional dependencies (pip extras) and plugins (entry points of other packages).

Packages of an extra are imported on first use; if one is missing, the error names the ``pip install`` command. Other
packages, such as the laboratory ``viewshed-lab``, add commands, estimators, formats, sensors and more by entry points:
docs/architecture.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import EntryPoint, entry_points
from typing import Any

LABORATORY = "viewshed-lab"

_RECORDINGS = ("rosbags", "mcap", "lz4", "zstandard", "velodyne_decoder", "yaml", "pyarrow", "foxglove", "laspy")

EXTRAS = {
    **dict.fromkeys(("numba", "matplotlib", "pebble"), LABORATORY),
    **dict.fromkeys(("torch", "lightning", "onnx", "optuna"), "viewshed-lab[train]"),
    "ray": "viewshed-lab[ray]", "stonesoup": "viewshed-lab[test]",
    **dict.fromkeys(_RECORDINGS, "viewshed[recordings]"),
    **dict.fromkeys(("scipy", "cbor2", "cwt", "cryptography", "zenoh"), "viewshed[agents]"),
    "rasterio": "viewshed[geo]", "rerun": "viewshed[view]",
}  # fmt: skip
"""Import name of a package → what to install."""

_DISTRIBUTIONS = {
    "foxglove": "foxglove-sdk", "rerun": "rerun-sdk", "zenoh": "eclipse-zenoh",
    "velodyne_decoder": "velodyne-decoder", "yaml": "pyyaml",
}  # fmt: skip
"""Import name of a package → its distribution name, where they differ."""


@contextmanager
def needed_for(task: str, install: str | None = None) -> Iterator[None]:
    """Turn a failed import of an optional package within the block into an error that names the install command.

    Args:
        task: what needs the package; the message begins with it: ``reading bags``.
        install: what to install; None takes the package's entry of :data:`EXTRAS`.

    Raises:
        ImportError: a package is not installed.

    >>> with needed_for("painting"):
    ...     import numpy
    """
    try:
        yield
    except ModuleNotFoundError as error:
        package = str(error.name).partition(".")[0]
        if package not in EXTRAS:
            raise
        # pip keeps the installed viewshed (release or checkout) and adds the packages of the extra.
        command = f"pip install '{install or EXTRAS[package]}'"
        raise ImportError(f"{task} needs {_DISTRIBUTIONS.get(package, package)}: {command}", name=package) from error


def plugins(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of installed packages in the group ``viewshed.GROUP``, by name."""
    return {point.name: point for point in entry_points(group=f"viewshed.{group}")}


def load(point: EntryPoint, fits: Callable[[Any], bool] | None = None, kind: str = "") -> Any:
    """Return the object of an entry point.

    Args:
        point: entry point of an installed package.
        fits: returns whether the loaded object is valid; None accepts any object.
        kind: expected kind of object, for the message: ``"a function"``.

    Raises:
        ImportError: the object cannot be loaded, or ``fits`` rejects it.
    """
    try:
        loaded = point.load()
        if fits is not None and not fits(loaded):
            raise TypeError(f"it must name {kind}, got {loaded!r}")
    except Exception as error:  # code of another package may raise any exception
        if isinstance(error, ModuleNotFoundError) and str(error.name).partition(".")[0] in EXTRAS:
            raise  # needed_for adds the install command
        package = point.dist.name if point.dist is not None else "the package"
        problem = " ".join(str(error).split()) or type(error).__name__
        raise ImportError(
            f"entry point {point.group} {point.name!r} of {package} cannot be loaded: {problem};"
            f" uninstall or update {package}"
        ) from error
    return loaded


def needs_laboratory(task: str) -> ImportError:
    """Return the ImportError for a task that needs the laboratory, which is not installed."""
    install = f"pip install {LABORATORY} (in a checkout: pip install packages/{LABORATORY})"
    return ImportError(f"{task} needs {LABORATORY}: {install}", name="viewshed_lab")


def plugin(group: str, name: str, task: str) -> Any:
    """Return the object that an installed package adds to a group under a name.

    Args:
        group: commands, recordings, adversaries, drives or names.
        name: name of the entry point in the group.
        task: what needs the object; the message begins with it: ``--attack``.

    Raises:
        ImportError: no installed package adds it, or it cannot be loaded.
    """
    point = plugins(group).get(name)
    if point is None:
        raise needs_laboratory(task)
    return load(point)
