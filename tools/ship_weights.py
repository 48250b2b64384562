"""Put a trained network into the package: ``python tools/ship_weights.py network.onnx --name road``.

The file is what ``viewshed train`` exported; its card says grid, target and training. It is run once before it is
written, with its checksum, into the folder of shipped weights.
"""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from viewshed.networks.runtime import OnnxRunner
from viewshed.networks.weights import WEIGHTS, ShippedWeights, add_shipped


def main(words: Sequence[str] | None = None) -> None:
    """Check, copy and list the file that the command line names."""
    parser = argparse.ArgumentParser(prog="ship_weights.py", description=__doc__)
    parser.add_argument("file", type=Path, help="network.onnx of a training")
    parser.add_argument("--name", required=True, help="what users ask for")
    parser.add_argument(
        "--methods", default="unet,mc_dropout", help="estimators that take it where no weights are named; may be none"
    )
    parser.add_argument("--folder", type=Path, default=WEIGHTS)
    arguments = parser.parse_args(words)
    ship(arguments.file, arguments.name, tuple(filter(None, arguments.methods.split(","))), arguments.folder)


def ship(file: Path, name: str, methods: tuple[str, ...], folder: Path) -> ShippedWeights:
    """Check a network's file, copy it to a folder of weights, and return its line of the manifest."""
    content = file.read_bytes()
    card = OnnxRunner.of_content(content, str(file), 1, "onnxruntime").card
    _run_once(content, file)
    digest, grid = hashlib.sha256(content).hexdigest(), card.grid
    if grid.offset_m != (0.0, 0.0):
        raise ValueError(f"shipped weights must have a grid about the sensor, got offset {grid.offset_m}")
    line = ShippedWeights(name, f"{name}.onnx", digest, grid.cells, grid.half_extent_m, card.target, methods)
    add_shipped(content, line, folder)
    print(f"{line.file}: {len(content)} bytes, {digest[:10]}…, for {', '.join(methods) or 'its name alone'}")
    return line


def _run_once(content: bytes, file: Path) -> None:
    runner = OnnxRunner.of_content(content, str(file), 1, "onnxruntime")
    card = runner.card
    empty = card.shown(np.zeros((1, *card.grid.shape), np.uint8))
    prob = runner.run(empty[None])
    if not ((prob >= 0) & (prob <= 1)).all():
        raise ValueError(f"{file} must give probabilities, got values outside [0, 1]; train it again")


if __name__ == "__main__":
    main()
