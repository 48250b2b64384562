"""The faults that ``tools/planted_faults.py`` plants must still fit the code."""

import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FAULTS = tomllib.loads((ROOT / "tools" / "planted_faults.toml").read_text(encoding="utf-8"))["fault"]


@pytest.mark.parametrize("fault", FAULTS, ids=[fault["what"] for fault in FAULTS])
def test_a_fault_fits_in_one_place(fault: dict[str, object]) -> None:
    source = (ROOT / "src" / "viewshed" / str(fault["file"])).read_text(encoding="utf-8")
    assert source.count(str(fault["find"])) == 1
    assert fault["find"] != fault["replace"]
