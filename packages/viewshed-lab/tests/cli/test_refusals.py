"""What commands of the laboratory refuse: one line, exit code 2, and nothing is written."""

import re
from pathlib import Path

import pytest
from tests.cli.commands import run

REFUSED = {
    "attack SET --attack far_wal": "attack must be one of uniform, .*, paper, got 'far_wal'",
    "attack SET --attack uniform --budget full": "budget must be a number for uniform",
    "attack SET --attack relay --budget ten": "budget must be a whole number of returns or full, got 'ten'",
    "attack SET --attack relay --placement best":
        "placement must be one of random, behind_nearest_obstacle, largest",
    "attack SET --attack relay --victim shadow_map": "--victim goes with adaptive_over_claim",
    "attack SET --attack adaptive_over_claim --victim oracle": "method must be one of continuous, .*, got 'oracle'",
    "attack SET --attack adaptive_over_claim_free --budget full": "for free points, got 1000000000",
    "attack SET --attack relay --split val": "split must be one of train, test, got 'val'",
    "attack SET --attack relay --seed -1": "seed must not be negative, got -1",
    "attack nothing.bin --attack relay": "no such file; name one data set, one recording, or files",
    "attack . --attack relay": "no recording found here",
    "label": "viewshed: name either a recording SRC or an --index$",
    "label nowhere": "nowhere: no such file or folder$",
    "label SET --definition best": "definition must be one of probe, farthest, first_blocker, got 'best'",
    "label SET --grid big": "grid must be one of road", "label SET --kind lost": "kind must be auto or one of",
    "label SET --sensor hdl": "sensor must be one of .*, got 'hdl'",
    "simulate kitti": "preset must be one of carla, carla-small, .*, got 'kitti'",
    "simulate ugv --grid 4096x64": "got 4096: a frame would not fit into memory",
    "simulate ugv --sweeps 1": "sweeps must be at least 2, one for each split, got 1",
    "simulate ugv --seed -1": "seed must lie in", "simulate ugv --workers 0": "workers must be at least 1, got 0",
    "evaluate truth nowhere": "nowhere", "evaluate truth nowhere --methods magic": "methods must be among continuous",
    "evaluate crossview nowhere --seed -1": r"seed must lie in \[0, 4294967295\], got -1",
    "study paper --preset huge": "preset must be one of medium, paper, small, tiny, got 'huge'",
    "study paper --only data,magic": "--only must be some of data, crossval, models, .*, got 'magic'",
    "study paper --protocol loose": "protocol must be among paper, strict, got 'loose'",
    "study robustness --preset nonsense": "preset must be one of full, small, tiny, got 'nonsense'",
    "study robustness --preset tiny --no-run": "must hold results, got none; run without --no-run$",
    "study guarantees --preset tiny --no-run": "must hold results, got none; run without --no-run$",
    "dataset wild training road --scenes -1": "--scenes",
    "dataset info .": r"^viewshed: \S+ must be a data set of viewshed, but has no manifest\.json$",
}  # fmt: skip
"""Command line, with SET for a data set → what its line must say."""


@pytest.mark.parametrize("words", REFUSED)
def test_what_cannot_be_done_is_one_line(words: str, made: Path, tmp_path: Path) -> None:
    arguments = [made if word == "SET" else word for word in words.split()]
    out = () if words.startswith("dataset") else ("--out", tmp_path / "none")
    code, said, complaint = run(*arguments, *out, cwd=tmp_path)
    assert (code, said, complaint.count("\n")) == (2, "", 1)
    assert re.search(REFUSED[words], complaint)
    assert not list(tmp_path.iterdir())
