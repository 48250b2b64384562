"""Rows of JSON lists: those of the json library, whatever the blocks are."""

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from viewshed.io import _json
from viewshed.io._input import open_input


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
