"""Indexes of sweeps, and what they may not do; the rows of JSON lists."""

import json
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from viewshed import Rigid
from viewshed.io import _json, read_index, read_indexed
from viewshed.io._input import open_input

files: Any = import_module("sweep_files")

FRAME = [[0.0, 1.0, 0.0, 0.5], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, -1.0], [0.0, 0.0, 0.0, 1.0]]


def index(folder: Path, *entries: Any) -> Path:
    (folder / "index.json").write_text(json.dumps(list(entries)))
    return folder / "index.json"


def test_entry_and_its_sweep(tmp_path: Path) -> None:
    (tmp_path / "drive").mkdir()
    (tmp_path / "drive/a.bin").write_bytes(files.rows([[2.0, 3.0, 4.0]], [9.0]))
    pose = Rigid.from_yaw(0.3, (1.0, 2.0, 3.0))
    (entry,) = read_index(
        index(
            tmp_path,
            {
                "file": "drive/a.bin", "sensor": "HDL-64E", "sensor_from_file": FRAME, "sensor_height_m": 1.7,
                "world_from_sensor": pose.as_matrix().tolist(), "seq": "one", "t": 12.25, "stats": {"points": 1},
            },
        )
    )  # fmt: skip
    assert entry.file == (tmp_path / "drive/a.bin").resolve()
    assert (entry.sensor, entry.seq, entry.t, entry.points) == ("HDL-64E", "one", 12.25, 1)
    sweep = read_indexed(entry)
    np.testing.assert_allclose(sweep.points, [[3.5, -2.0, 3.0]])
    assert sweep.sensor_height_m == 1.7
    assert sweep.t_ns == 12_250_000_000
    np.testing.assert_allclose(sweep.world_from_sensor.as_matrix(), pose.as_matrix())


@pytest.mark.parametrize("name", ["../a.bin", "/etc/passwd", "in/../../a.bin", "link/a.bin", "link.bin"])
def test_names_and_links_that_leave_the_folder_are_refused(name: str, tmp_path: Path) -> None:
    (tmp_path / "a.bin").write_bytes(b"secret")
    folder = tmp_path / "data"
    (folder / "in").mkdir(parents=True)
    (folder / "link").symlink_to(tmp_path)
    (folder / "link.bin").symlink_to(tmp_path / "a.bin")
    with pytest.raises(ValueError, match=r"index\.json: entry 0: .* leads out of .*; refused"):
        read_index(index(folder, {"file": name, "sensor": "x"}))


def test_links_inside_the_folder_are_followed(tmp_path: Path) -> None:
    (tmp_path / "a.bin").write_bytes(b"x")
    (tmp_path / "b.bin").symlink_to(tmp_path / "a.bin")
    (entry,) = read_index(index(tmp_path, {"file": "b.bin", "sensor": "x"}))
    assert entry.file.name == "a.bin"


@pytest.mark.parametrize(
    ("entry", "pattern"),
    [
        (5, "row 0 must be an object, got int"),
        ({"sensor": "x"}, "entry 0 has no 'file'"),
        ({"file": "a.bin"}, "entry 0 has no 'sensor'"),
        ({"file": "a\0.bin", "sensor": "x"}, "entry 0: "),
        ({"file": "a.bin", "sensor": "x", "t": "late"}, "entry 0: could not convert string to float"),
        ({"file": "a.bin", "sensor": "x", "t": 1.5e18}, r"entry 0: t must be seconds .*, got 1\.5e\+18"),
        ({"file": "a.bin", "sensor": "x", "t": np.nan}, "entry 0: t must be seconds .*, got nan"),
        ({"file": "a.bin", "sensor": "x", "sensor_from_file": [[1]]}, r"entry 0: matrix must have shape \(4, 4\)"),
        ({"file": "a.bin", "sensor": "x", "sensor_from_file": np.diag([1, 1, -1, 1]).tolist()}, "right-handed"),
        ({"file": "a.bin", "sensor": "x", "world_from_sensor": np.diag([2, 2, 2, 1]).tolist()}, "orthonormal"),
    ],
)
def test_bad_entries_are_named(entry: Any, pattern: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=pattern) as caught:
        read_index(index(tmp_path, entry))
    assert "\n" not in str(caught.value)
    assert str(tmp_path) in str(caught.value)


@pytest.mark.parametrize("content", ["{}", "[", "[" * 100_000, "\xff\xfe", '"' + "a" * 500])
def test_files_that_are_no_index_are_refused(content: str, tmp_path: Path) -> None:
    (tmp_path / "i.json").write_bytes(content.encode("latin-1"))
    with pytest.raises(ValueError, match=r"i\.json: "):
        read_index(tmp_path / "i.json")


# Rows of JSON lists: those of the json library, whatever the blocks are.


def rows_of(place: Path) -> list[dict[str, Any]]:
    with open_input(place) as source:
        return list(_json.json_rows(source))


_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=6,
)


@given(
    rows=st.lists(st.dictionaries(st.text(), _VALUES, max_size=4), max_size=8),
    block=st.integers(1, 80),
    indent=st.sampled_from([None, 0, 2]),
    ascii_only=st.booleans(),
)
def test_rows_are_those_of_the_json_library_whatever_the_blocks(
    rows: list[dict[str, Any]],
    block: int,
    indent: int | None,
    ascii_only: bool,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    place = tmp_path_factory.getbasetemp() / "rows.json"
    place.write_text(json.dumps(rows, indent=indent, ensure_ascii=ascii_only), encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_json, "_BLOCK_BYTES", block)
        assert rows_of(place) == rows


@pytest.mark.parametrize("text", ["[,{}]", "[{},,{}]", "[{}", "[{},", "[{}]]", '[{"a": 1} {"b": 2]', "", " "])
@pytest.mark.parametrize("block", [1, 3, 1000])
def test_what_is_no_list_is_refused_whatever_the_blocks(
    text: str, block: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_json, "_BLOCK_BYTES", block)
    (tmp_path / "rows.json").write_text(text)
    with pytest.raises(ValueError, match=r"rows\.json: (must be a JSON list of objects|the file is empty)"):
        rows_of(tmp_path / "rows.json")


def test_rows_longer_than_a_block_are_read_and_far_too_long_ones_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [{"a": [{"b": "ü" * 300}] * 30, "n": number} for number in range(3)]
    (tmp_path / "rows.json").write_text(json.dumps(rows, ensure_ascii=False), encoding="utf-8")
    monkeypatch.setattr(_json, "_BLOCK_BYTES", 64)
    assert rows_of(tmp_path / "rows.json") == rows
    monkeypatch.setattr(_json, "_ROW_MAX", 5_000)
    with pytest.raises(ValueError, match=r"rows\.json: .* a row must have at most 5000 bytes"):
        rows_of(tmp_path / "rows.json")
