"""The benchmark of stability: its measure by hand, and what it changes about a sweep."""

import json
from pathlib import Path

import numpy as np
import pytest
from benchmarks import stability

from viewshed import BevGrid, CellState, FovEstimate, write_sweep
from viewshed.sensors import lidar_model
from viewshed_lab.sim import cast, junction

STREET = cast(lidar_model("vlp16"), junction(), 1.8)


def test_iou_is_what_both_see_of_what_either_sees() -> None:
    def view(*probs: float) -> FovEstimate:
        return FovEstimate(
            BevGrid(2, 1.0), np.array(probs, np.float32).reshape(2, 2), np.full((2, 2), CellState.UNKNOWN, np.uint8)
        )

    assert stability.iou(view(1, 1, 1, 0), view(0, 1, 1, 0)) == pytest.approx(2 / 3)
    assert np.isnan(stability.iou(view(0, 0, 0, 0), view(0, 0, 0, 0)))


def test_noise_moves_returns_along_their_beams() -> None:
    moved = stability.noisy(STREET, np.random.default_rng(0)).points
    was_m, is_m = np.linalg.norm(STREET.points, axis=1), np.linalg.norm(moved, axis=1)
    assert np.std(is_m - was_m) == pytest.approx(0.02, rel=0.05)
    assert np.allclose(moved / is_m[:, None], STREET.points / was_m[:, None], atol=1e-5)


def test_the_table_has_a_line_for_each_change(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_sweep(STREET, tmp_path / "a.npz")
    entry = {"file": "a.npz", "sensor": "VLP-16", "stats": {"points": len(STREET)}}
    (tmp_path / "index.json").write_text(json.dumps([entry]), "utf-8")
    stability.main([str(tmp_path / "index.json"), str(tmp_path / "a.npz")])
    rows = [line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines()[2:]]
    assert [row[1] for row in rows] == ["1", "1", "0", "0"]  # no two sweeps at rest
    assert 0.5 < float(rows[0][2]) < float(rows[1][2]) <= 1.0
