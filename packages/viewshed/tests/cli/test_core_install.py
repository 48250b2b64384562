"""What works without any extra: estimates, comparisons, pictures, exports; bags with the extra ``recordings`` alone."""

import json
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from viewshed._extras import EXTRAS
from viewshed.io.samples import junction_path

recordings: Any = import_module("recording_files")

OF_BAGS = {package for package, install in EXTRAS.items() if install == "viewshed[recordings]"}

LABORATORY = (
    "viewshed_lab.sim",
    "viewshed_lab.threats",
    "viewshed_lab.studies",
    "viewshed_lab.training",
    "viewshed_lab.data.labeling",
)
"""Rooms that no robot needs: their loops are compiled by numba."""

RUN = """
import json, sys
for package in json.loads(sys.argv[1]):
    sys.modules[package] = None
from viewshed.cli import main
for words in json.loads(sys.argv[2]):
    try:
        main(words)
    except SystemExit as stopped:
        if stopped.code:
            raise
print(json.dumps(sorted(sys.modules)))
"""


def _run(commands: list[list[str]], installed: set[str], folder: Path) -> set[str]:
    """Run commands in a process that has no package of an extra but ``installed``, and return what was imported."""
    blocked = json.dumps(sorted({*EXTRAS, "mcap"} - installed))
    done = subprocess.run(
        [sys.executable, "-c", RUN, blocked, json.dumps(commands)],
        check=False, capture_output=True, text=True, cwd=folder,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return set(json.loads(done.stdout.splitlines()[-1]))


def test_sweeps_are_read_estimated_compared_and_exported_by_the_core_install(tmp_path: Path) -> None:
    sweep = str(junction_path())
    loaded = _run(
        [
            ["info", sweep],
            ["estimate", sweep, "--out", "out"],
            ["compare", sweep, "--methods", "all"],
            ["export", sweep, "--to", "cpm"],
            ["view", sweep, "--html", "run.html"],
            ["replay", sweep],
            ["demo"],
        ],
        set(), tmp_path,
    )  # fmt: skip
    assert {path.suffix for path in (tmp_path / "out").iterdir()} == {".png", ".geojson", ".npz"}
    for picture in ("compare.png", "demo/demo.png", "demo/demo_truth.png"):
        assert (tmp_path / picture).read_bytes()[:4] == b"\x89PNG"
    assert (tmp_path / "run.html").read_text("utf-8").startswith("<!DOCTYPE html>")
    assert not [name for name in loaded if name.startswith(LABORATORY)]
    assert not {"onnxruntime", "viewshed_lab.data"} & loaded


def test_networks_run_by_the_core_install(tmp_path: Path) -> None:
    loaded = _run([["estimate", str(junction_path()), "--method", "unet", "--results", "npz"]], set(), tmp_path)
    assert "onnxruntime" in loaded


def test_bags_are_read_with_the_extra_recordings_alone(tmp_path: Path) -> None:
    for packing in ("ZSTD", "LZ4"):
        (tmp_path / f"{packing}.mcap").write_bytes(recordings.mcap(packing))
    (tmp_path / "b.bag").write_bytes(recordings.ros1_bag("lz4"))
    loaded = _run([["info", name] for name in ("ZSTD.mcap", "LZ4.mcap", "b.bag")], OF_BAGS, tmp_path)
    assert not [name for name in loaded if name.startswith(LABORATORY)]
