"""A short shard of each preset holds, column by column, what it held before."""

from pathlib import Path

import pytest
from tests.golden import parts, recorder


@pytest.mark.parametrize("preset", recorder.PRESETS)
def test_frames_of_a_preset_are_stored_as_before(preset: str, tmp_path: Path) -> None:
    assert parts.shard_differences(preset, tmp_path) == []


def test_every_preset_is_recorded() -> None:
    assert set(parts.read_json(parts.SHARDS)["presets"]) == set(recorder.PRESETS)


def test_another_frame_is_told_column_by_column(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The check can fail: one column of one frame was another one."""
    wanted = parts.read_json(parts.SHARDS)["presets"]["ugv"]
    changed = {**wanted, "1": {**wanted["1"], "steps": "0" * 16}}
    monkeypatch.setattr(recorder, "shard_digests", lambda *_: changed)
    assert parts.shard_differences("ugv", tmp_path) == ["ugv, frame 1: steps differs"]
