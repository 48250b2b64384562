"""Reports of monitors: verdicts, sectors and cells."""

import json
from math import isnan

import numpy as np
import pytest
from tests.monitor.by_hand import GRID

from viewshed import BevGrid
from viewshed.grid import polar_of_cells
from viewshed.monitor import IntegrityReport
from viewshed.monitor.evidence import SECTORS
from viewshed.monitor.report import cells_of_sectors, sectors_of_cells, suspects_geojson


def test_inconsistent_above_the_threshold_only() -> None:
    assert not IntegrityReport("by hand", 1.0, 1.0).inconsistent
    report = IntegrityReport("by hand", 1.5, 1.0, p_value=0.01, degraded=True)
    assert report.inconsistent
    assert report.alarm
    assert not IntegrityReport("by hand", 0.0, 1.0, degraded=True).alarm
    assert isnan(report.suspect_m2)
    assert report.suspect.shape == (SECTORS,)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"score": np.nan}, "score and threshold must be numbers, got nan"),
        ({"p_value": 0.0}, r"p_value must lie in \(0, 1\] or be NaN, got 0.0"),
        ({"degraded_p_value": 1.5}, "degraded_p_value must lie in"),
        ({"suspect": np.zeros(71, bool)}, r"suspect must be bool \(72,\), got bool \(71,\)"),
        ({"suspect": np.zeros(SECTORS)}, r"suspect must be bool \(72,\), got float64"),
        ({"suspect_cells": np.zeros(GRID.shape, bool)}, r"suspect_cells must be bool \(0, 0\)"),
        ({"grid": GRID}, r"suspect_cells must be bool \(8, 8\), got bool \(0, 0\)"),
    ],
)
def test_what_a_report_may_not_be(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        IntegrityReport("by hand", **({"score": 1.0, "threshold": 1.0} | wrong))  # type: ignore[arg-type]


def test_sectors_painted_on_a_grid_lie_where_they_say_and_come_back() -> None:
    grid, sectors = BevGrid(80, 40.0, (5.0, 0.0)), np.zeros(SECTORS, np.bool_)
    sectors[54:56] = True  # 90° to 100°: to the left
    cells = cells_of_sectors(sectors, grid)
    degrees = np.degrees(polar_of_cells(grid)[1])
    assert np.array_equal(cells, (degrees >= 90) & (degrees < 100))
    assert np.array_equal(sectors_of_cells(cells, grid), sectors)


def test_geojson_of_a_report_has_verdicts_and_reasons() -> None:
    cells = np.zeros(GRID.shape, np.bool_)
    cells[2, 3] = True
    report = IntegrityReport("by hand", 2.0, 1.0, 0.01, True, grid=GRID, suspect_cells=cells, reasons=("for a reason",))
    made = json.loads(suspects_geojson(report))
    assert made["crs"]["properties"]["name"].startswith('LOCAL_CS["level frame')
    found = made["properties"]
    assert found["alarm"]
    assert found["degraded"]
    assert found["p_value"] == 0.01
    assert found["reasons"] == ["for a reason"]
    with pytest.raises(ValueError, match="report must be on a grid, got none"):
        suspects_geojson(IntegrityReport("by hand", 2.0, 1.0))
