"""YAML of unknown origin: the values of PyYAML's own loader, within bounds."""

from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from viewshed.recordings.read import _yaml

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**17), 10**17) | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text() | st.integers(0, 99), inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=30)
@given(value=VALUES, flow=st.booleans())
def test_values_are_those_of_pyyaml(value: Any, flow: bool, tmp_path_factory: pytest.TempPathFactory) -> None:
    place = tmp_path_factory.getbasetemp() / "a.yaml"
    text = yaml.safe_dump(value, default_flow_style=flow, allow_unicode=True)
    place.write_text(text, encoding="utf-8", newline="")
    if not text.startswith("%"):
        assert _yaml.read_yaml(place) == yaml.safe_load(text)


def put(folder: Path, text: str) -> Path:
    (folder / "a.yaml").write_text(text, encoding="utf-8")
    return folder / "a.yaml"


def test_aliases_share_values_and_merges_do_not_replace(tmp_path: Path) -> None:
    text = "base: &b {x: 1, y: 2}\nown: {<<: *b, y: 3}\nboth: {<<: [*b, {z: 4}]}\nlist: [*b, *b]\n"
    value = _yaml.read_yaml(put(tmp_path, text))
    assert value == yaml.safe_load(text)
    assert value["list"][0] is value["list"][1]


def test_what_looks_like_a_number_stays_text_unless_it_is_one(tmp_path: Path) -> None:
    value = _yaml.read_yaml(put(tmp_path, f"[1:30:00, {'9' * 19}, {'9' * 65}, 0x1F, 1_000, 1e5, -.inf, !!int 7, '9']"))
    assert value == ["1:30:00", 1e19, "9" * 65, "0x1F", "1_000", 1e5, float("-inf"), None, "9"]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("x: " + "[" * 51, "at most 50 levels deep"),
        ("x:\n" + "".join(f"{' ' * k}- - a:\n" for k in range(0, 200, 4)), "at most 50 levels deep"),
        ("a: &a [1]\nb: [*a, *c]", "alias 'c' stands for nothing before it"),
        ("a: &a [*a]", "alias 'a' stands for nothing before it"),
        ("%YAML 1.1\n---\nx: 1", "without directives"),
        ("? [1, 2]\n: 3", "is not YAML: .* found unhashable key"),
        ("<<: 5", "is not YAML: .* expected a mapping or list of mappings for merging"),
        ("x: [1,", "is not YAML"),
        ("x: [" + "1," * 200_000 + "]", "at most 200000 nodes"),
        ("a: &a [" + "1," * 1_000 + "]\nb: [" + "*a," * 200 + "]", "at most 200000 nodes"),
        ("x: " + "y" * 4_000_000, "at most 4000000 bytes"),
    ],
)
def test_what_is_no_plain_yaml_is_one_line(text: str, problem: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=problem) as caught:
        _yaml.read_yaml(put(tmp_path, text))
    assert str(caught.value).startswith(f"{tmp_path / 'a.yaml'}: ")
    assert "\n" not in str(caught.value)
