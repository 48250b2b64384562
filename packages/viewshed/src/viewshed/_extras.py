"""What only some commands need: packages of an extra, and what other installed packages add to viewshed.

Packages of an extra are imported where they are used, and one line names what is missing. Another package, such as the
laboratory ``viewshed-lab``, adds commands, estimators, formats, sensors and more by entry points: docs/architecture.md.
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
"""What to install for a package, by the name under which Python imports it."""

_DISTRIBUTIONS = {
    "foxglove": "foxglove-sdk", "rerun": "rerun-sdk", "zenoh": "eclipse-zenoh",
    "velodyne_decoder": "velodyne-decoder", "yaml": "pyyaml",
}  # fmt: skip
"""What is installed, where that is not the name of the import."""


@contextmanager
def needed_for(task: str, install: str | None = None) -> Iterator[None]:
    """Import packages of an extra inside; one that is not installed is an error that names it and what brings it.

    Args:
        task: what needs them, the beginning of the message: ``reading bags``.
        install: what to install; None is what :data:`EXTRAS` says of the package.

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
        # pip takes the viewshed that is there, of a release or a checkout, and adds what the extra names.
        wanted = f"pip install '{install or EXTRAS[package]}'"
        raise ImportError(f"{task} needs {_DISTRIBUTIONS.get(package, package)}: {wanted}", name=package) from error


def plugins(group: str) -> dict[str, EntryPoint]:
    """Return what installed packages add to viewshed in a group of entry points ``viewshed.GROUP``, by name."""
    return {point.name: point for point in entry_points(group=f"viewshed.{group}")}


def load(point: EntryPoint, fits: Callable[[Any], bool] | None = None, kind: str = "") -> Any:
    """Return what an entry point names.

    Args:
        point: of an installed package.
        fits: whether what was loaded can be used; None takes anything.
        kind: what must be named, for the message: ``"a function"``.

    Raises:
        ImportError: it cannot be loaded, or is of another kind.
    """
    try:
        loaded = point.load()
        if fits is not None and not fits(loaded):
            raise TypeError(f"it must name {kind}, got {loaded!r}")
    except Exception as error:  # the code of another package may raise anything
        if isinstance(error, ModuleNotFoundError) and str(error.name).partition(".")[0] in EXTRAS:
            raise  # needed_for names what brings it
        package = point.dist.name if point.dist is not None else "the package"
        problem = " ".join(str(error).split()) or type(error).__name__
        raise ImportError(
            f"entry point {point.group} {point.name!r} of {package} cannot be loaded: {problem};"
            f" uninstall or update {package}"
        ) from error
    return loaded


def needs_laboratory(task: str) -> ImportError:
    """Return the error of a task that needs the laboratory where it is not installed."""
    install = f"pip install {LABORATORY} (in a checkout: pip install packages/{LABORATORY})"
    return ImportError(f"{task} needs {LABORATORY}: {install}", name="viewshed_lab")


def plugin(group: str, name: str, task: str) -> Any:
    """Return what an installed package adds under a name of a group.

    Args:
        group: commands, recordings, adversaries, drives or names.
        name: in the group.
        task: what needs it, the beginning of the message: ``--attack``.

    Raises:
        ImportError: no installed package has it, or it cannot be loaded.
    """
    point = plugins(group).get(name)
    if point is None:
        raise needs_laboratory(task)
    return load(point)
