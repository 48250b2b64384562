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
SOURCE = """\
namespace house {
constexpr float LOW_M = 1.0f, HIGH_M = 2.0f;
constexpr int TABLE[] = {
    1,
    2,
};
struct Wall {
    int width;
};

INLINE bool is_low(float z,
                   int i) {
    return place(
        z,
        i,  \n    ) < LOW_M;
}

void declared(int i);

float same(float z) {
    return is_low(z, 1) ? z : 0.0f;
}
}  // namespace house
"""


@pytest.fixture
def core(tmp_path: Path) -> Path:
    (tmp_path / "walls.cpp").write_text(SOURCE)
    return tmp_path


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


def test_functions_constants_and_classes_are_found() -> None:
    found = set(tool.definitions(SOURCE.splitlines()))
    assert found == {
        ("LOW_M", 2, 2),
        ("HIGH_M", 2, 2),
        ("TABLE", 3, 6),
        ("Wall", 7, 9),
        ("is_low", 11, 17),
        ("same", 21, 23),
    }


def test_a_fault_is_planted_in_its_symbol_alone(core: Path) -> None:
    path, faulty = tool.plant(tool.Fault("x", "core.walls:is_low", "place(z, i)", "place(i, z)", ()), core)
    assert path == core / "walls.cpp"
    assert "    return place(i, z) < LOW_M;\n}\n\nvoid declared(int i);" in faulty
    assert faulty.replace("place(i, z)", "place(\n        z,\n        i,  \n    )") == SOURCE


@pytest.mark.parametrize(
    ("symbol", "find", "message"),
    [
        ("core.walls:is_lo", "z", "must be one place of the core, 'core.walls:is_lo' is 0"),
        ("core.bath:same", "z", "is 0"),
        ("core.walls:same", "place", "must occur once in core.walls:same, found 0 times"),
        ("core.walls:same", "z", "found 3 times"),
        ("core.walls:same", "retur", "found 0 times"),
    ],
)
def test_a_fault_that_does_not_fit_is_refused(core: Path, symbol: str, find: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        tool.plant(tool.Fault("x", symbol, find, "k", ()), core)
