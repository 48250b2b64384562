"""Packages that only some commands need: they are imported where they are used, and one line names what is missing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

EXTRAS = {
    "numba": "sim", "scipy": "sim", "matplotlib": "sim",
    "pyarrow": "data",
    "torch": "train", "lightning": "train", "onnx": "train", "optuna": "train",
    "rosbags": "bags", "lz4": "bags", "zstandard": "bags",
    "rasterio": "geo",
    "foxglove": "foxglove", "rerun": "view",
    "velodyne_decoder": "packets",
    "cbor2": "agents", "cwt": "agents", "cryptography": "agents", "zenoh": "agents",
    "openvino": "openvino", "ray": "ray", "yaml": "opv2v",
}  # fmt: skip
"""The extra that installs a package, by the name under which Python imports it."""

_DISTRIBUTIONS = {
    "foxglove": "foxglove-sdk", "rerun": "rerun-sdk", "zenoh": "eclipse-zenoh",
    "velodyne_decoder": "velodyne-decoder", "yaml": "pyyaml",
}  # fmt: skip
"""What is installed, where that is not the name of the import."""


@contextmanager
def needed_for(task: str, extra: str | None = None) -> Iterator[None]:
    """Import packages of an extra inside; one that is not installed is an error that names it and the extra.

    Args:
        task: what needs them, the beginning of the message: ``reading bags``.
        extra: the one to name; None is the package's in :data:`EXTRAS`.

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
        install = f"pip install 'viewshed[{extra or EXTRAS[package]}]'"
        raise ImportError(f"{task} needs {_DISTRIBUTIONS.get(package, package)}: {install}", name=package) from error
