"""The faults that ``tools/planted_faults.py`` plants fit the native core."""

import re
from collections import Counter
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
tool: Any = import_module("planted_faults")
FAULTS = tool.read_faults(ROOT / "tools" / "planted_faults.toml")


@pytest.mark.parametrize("fault", FAULTS, ids=[fault.what for fault in FAULTS])
def test_a_fault_fits_in_one_place_and_uses_names_of_its_file(fault: Any) -> None:
    path, faulty = tool.plant(fault, ROOT / tool.CORE)
    sound = path.read_text(encoding="utf-8")
    assert faulty != sound
    assert set(re.findall(r"[A-Za-z_]\w*", faulty)) <= set(re.findall(r"[A-Za-z_]\w*", sound)) | {"true", "false"}
    assert fault.tests
    assert all((ROOT / test.partition("::")[0]).exists() for test in fault.tests)


def test_every_fault_is_described_in_its_own_words() -> None:
    assert [what for what, times in Counter(fault.what for fault in FAULTS).items() if times > 1] == []


@pytest.mark.parametrize(("find", "times"), [("lace", 0), ("LOW_M", 2)])
def test_a_text_is_found_whatever_its_white_space_and_must_occur_once(find: str, times: int, tmp_path: Path) -> None:
    source = "float LOW_M;\nreturn place(\n    z,\n    i) < LOW_M;\n"
    (tmp_path / "walls.cpp").write_text(source)
    path, faulty = tool.plant(tool.Fault("x", "walls.cpp", "place(z, i)", "place(i, z)", ()), tmp_path)
    assert (path.name, faulty) == ("walls.cpp", "float LOW_M;\nreturn place(i, z) < LOW_M;\n")
    with pytest.raises(ValueError, match=f"must occur once in walls.cpp, found {times} times"):
        tool.plant(tool.Fault("x", "walls.cpp", find, "k", ()), tmp_path)
