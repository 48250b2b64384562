from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from viewshed import BevGrid, CellState, FovEstimate
from viewshed.fov.estimate import Basis

GRID = BevGrid(4, 4.0)  # cells of 2 m


def _estimate(**changes: object) -> FovEstimate:
    prob = np.zeros((4, 4), np.float32)
    prob[3, 0] = 0.5
    prob[2, 1] = 0.4
    state = np.full((4, 4), CellState.UNKNOWN, np.uint8)
    state[3, 0] = CellState.FREE
    values = {"grid": GRID, "visible_prob": prob, "state": state} | changes
    return FovEstimate(**values)  # type: ignore[arg-type]


def test_visible_is_the_probability_from_the_threshold_on() -> None:
    estimate = _estimate()
    assert np.argwhere(estimate.visible()).tolist() == [[3, 0]]
    assert np.argwhere(estimate.visible(0.4)).tolist() == [[2, 1], [3, 0]]
    assert estimate.area_m2() == estimate.polygon().area == estimate.inner_polygon(4).area == 4.0
    assert estimate.polygon(0.4).area == estimate.inner_polygon(8, 0.4).area == 8.0
    assert estimate.share(CellState.FREE) == 1 / 16
    assert "a car is visible on 4 m² of 8 × 8 m; 0% hidden, 0% surface, 6% free, 94% unknown" in repr(estimate)
    with pytest.raises(ValueError, match=r"threshold must lie in \(0, 1\], got 1.1"):
        estimate.visible(1.1)


def test_a_picture_is_titled_by_method_and_target_and_shown_everywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    estimate, opened = _estimate(method="by hand"), list[str]()
    picture = estimate.plot()
    assert picture.startswith(b"\x89PNG")
    assert picture == estimate.plot(title="by hand, car") != estimate.plot(title="another")
    monkeypatch.setattr("webbrowser.open", opened.append)
    assert estimate.show().read_bytes() == estimate._repr_png_() == picture
    assert opened[0].endswith("/by%20hand.png")


def test_numbers_of_numpy_are_saved_as_any_others(tmp_path: Path) -> None:
    estimate = _estimate(t_ns=np.int64(5), threshold=np.float32(0.5))
    for name in ("a.npz", "a.geojson", "a.osi.json", "a.grid_map.json"):
        assert estimate.save(tmp_path / name).exists()


def test_at_looks_up_and_is_nan_outside() -> None:
    found = _estimate().at(np.array([[3.0, -3.0], [-3.0, 3.0], [4.0, 0.0]]))
    assert found.dtype == np.float32
    assert found[:2].tolist() == [0.5, 0.0]
    assert np.isnan(found[2])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"visible_prob": np.full((4, 4), 1.5)}, r"visible_prob must lie in \[0, 1\]"),
        ({"visible_prob": np.full((4, 4), np.nan)}, r"visible_prob must lie in \[0, 1\]"),
        ({"visible_prob": np.zeros((3, 4))}, r"grid's shape \(4, 4\), got \(3, 4\)"),
        ({"std": np.full((4, 4), -0.1)}, "std must not be negative"),
        *(({"state": np.full((4, 4), odd)}, rf"state must lie in \[0, 3\], got {odd}") for odd in (9, 257, -255)),
        ({"t_ns": 1.5}, "t_ns must be a whole number, got 1.5"),
    ],
)
def test_bad_values_are_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        _estimate(**changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"height_source": "guessed"}, "height_source must be one of given, estimated, held, assumed, got 'guessed'"),
        ({"ground_support": 1.5}, r"ground_support must lie in \[0, 1\], got 1.5"),
        ({"inferred_share": float("nan")}, r"inferred_share must lie in \[0, 1\], got nan"),
        ({"sensor_height_m": float("inf")}, "sensor_height_m must be finite"),
        ({"reach_m": -1.0}, "reach_m not negative"),
    ],
)
def test_a_basis_refuses_what_cannot_be(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(Basis(1.84, "estimated", 0.63, 0.04, 0.07, 80.0), **changes)


def test_a_height_that_no_ground_gave_is_called_so() -> None:
    assumed = Basis(1.8, "assumed", 0.0, 1.0, 0.0, 20.0)
    assert assumed.height_line == "ground not seen, sensor taken to be 1.80 m above it, reach 20 m"
    assert replace(assumed, height_source="given").height_line == "sensor 1.80 m above the ground (given), reach 20 m"
