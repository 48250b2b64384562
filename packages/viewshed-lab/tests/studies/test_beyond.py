"""Claims beyond the returns: two returns by hand, and a sweep whose street goes on where a beam is lost."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from viewshed import BevGrid, Sweep, write_sweep
from viewshed.cli import main
from viewshed.preprocess.leveling import level
from viewshed.sensors import lidar_model
from viewshed_lab.sim import cast, junction
from viewshed_lab.studies.beyond import beyond_returns

GRID = BevGrid(128, 32.0)


def test_a_cell_is_beyond_where_no_return_near_its_azimuth_is_as_far() -> None:
    leveled = replace(
        level(Sweep(np.zeros((0, 3), np.float32)), GRID),
        azimuth=np.deg2rad(np.array([0.0, 179.0, 1.0], np.float32)),
        range_m=np.array([10.0, 20.0, 4.0], np.float32),
    )
    beyond = beyond_returns(leveled, GRID)

    def at(azimuth_deg: float, range_m: float) -> bool:
        xy = range_m * np.array([np.cos(np.deg2rad(azimuth_deg)), np.sin(np.deg2rad(azimuth_deg))])
        row, column = np.floor((xy - GRID.origin_m) / GRID.cell_m).astype(int)
        return bool(beyond[row, column])

    assert not at(1.5, 9.0)
    assert at(1.5, 12.0)
    assert at(9.0, 9.0)  # more than 3° aside there is no return
    assert not at(-179.5, 18.0)  # across the seam
    assert at(-179.5, 23.0)
    assert at(90.0, 1.0)


def test_the_command_tells_both_grids_of_each_sweep(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    street = cast(lidar_model("vlp16"), junction(), 1.8)
    write_sweep(street, tmp_path / "street.npz")
    (tmp_path / "broken.bin").write_bytes(b"1")
    with pytest.raises(SystemExit) as end:
        main(["evaluate", "beyond", str(tmp_path / "street.npz"), str(tmp_path / "broken.bin")])
    printed = capsys.readouterr()
    assert end.value.code == 2
    assert "broken.bin" in printed.err
    rows = [line.strip("| ").split(" | ") for line in printed.out.splitlines() if line.startswith("| street")]
    assert [row[1] for row in rows] == ["road, car", "indoor, pedestrian"]
    for *_, height, area_m2, share, alone in rows:
        assert height.startswith("1.80 m")
        assert float(area_m2) > 100
        assert 0.0 <= float(alone) <= float(share) < 0.6
