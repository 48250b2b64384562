"""The one way to call an estimator, over the whole table: classical ones and networks alike."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.estimators.test_contracts import same
from tests.networks.made import card, nearby

import viewshed
from viewshed import GRIDS, PEDESTRIAN, BevGrid, Sweep, Target
from viewshed.estimators import (
    CLASSICAL,
    DEFAULT_ESTIMATOR,
    ESTIMATORS,
    FORMER_NAMES,
    LEARNED,
    Estimator,
    load_estimator,
)
from viewshed.estimators.unet import UnetEstimator
from viewshed.geometry import Rigid
from viewshed.networks.architecture import UNetShape
from viewshed.preprocess.leveling import level
from viewshed_lab.training.onnx_export import export_onnx

ROAD, ROOM = GRIDS["road"], GRIDS["indoor"]


@pytest.fixture(scope="module", params=list(ESTIMATORS))
def estimator(request: pytest.FixtureRequest) -> Estimator:
    made = ESTIMATORS[request.param](ROAD)
    return UnetEstimator(made.runner, 2) if isinstance(made, UnetEstimator) and made.passes > 1 else made


def _at(sweep: Sweep, x_m: float, seconds: float) -> Sweep:
    return sweep.replace(t_ns=int(1e9 * seconds), world_from_sensor=Rigid(np.eye(3), np.array([x_m, 0.0, 1.8])))


def test_the_table_holds_classical_and_learned_estimators_under_their_own_names(estimator: Estimator) -> None:
    assert set(ESTIMATORS) == set(CLASSICAL) | set(LEARNED)
    assert ESTIMATORS[estimator.name](ROAD).name == estimator.name
    assert (estimator.grid, estimator.target.name) == (ROAD, "car")
    assert 0.0 < estimator.threshold < 1.0


def test_a_sweep_and_the_leveled_sweep_give_one_estimate(estimator: Estimator, street: Sweep) -> None:
    estimate = estimator.estimate(street)
    assert same(estimate, estimator.estimate(level(street, ROAD)))
    assert (estimate.method, estimate.threshold) == (estimator.name, estimator.threshold)
    assert np.array_equal(estimate.visible(), estimate.visible_prob >= np.float32(estimator.threshold))


def test_a_sweep_leveled_for_a_smaller_grid_is_refused(estimator: Estimator, street: Sweep) -> None:
    with pytest.raises(ValueError, match=r"must have ground out to 64 m for this grid, got 16 m; level it on"):
        estimator.estimate(level(street, BevGrid(64, 16.0)))


def test_an_array_is_no_sweep(estimator: Estimator, street: Sweep) -> None:
    with pytest.raises(TypeError, match=r"must be a Sweep or a LeveledSweep, got ndarray; make one with viewshed\.Sw"):
        estimator.estimate(street.points)  # type: ignore[arg-type]


def test_history_changes_estimates_where_it_is_used_and_is_refused_elsewhere(
    estimator: Estimator, street: Sweep, cast: Callable[..., Sweep]
) -> None:
    earlier = [_at(street, -1.0, 0.0), _at(street, -0.5, 1.0)]
    now = _at(cast([(3.0, 5.0, 6.5, 8.5, 1.5)]), 0.0, 2.0)  # the wall ahead is gone, and one looks past it
    assert same(estimator.estimate(now), estimator.estimate(now, []))
    if estimator.uses_history:
        assert estimator.estimate(now, earlier).visible().sum() < estimator.estimate(now).visible().sum()
        with pytest.raises(ValueError, match="pose"):
            estimator.estimate(now, [earlier[0].replace(world_from_sensor=None)])
    else:
        with pytest.raises(ValueError, match=f"history must be left out for {estimator.name}, which uses one sweep"):
            estimator.estimate(now, earlier)
        with pytest.raises(ValueError, match=f"history is for shadow_map, got {estimator.name}"):
            estimator.stream([now], history=2)


def test_probabilities_abstain_and_masks_cannot(estimator: Estimator, street: Sweep) -> None:
    if estimator.name in LEARNED or estimator.name == "shadow_map":
        sure = estimator.with_abstention(0.9)
        assert (sure.name, sure.grid, sure.threshold) == (estimator.name, ROAD, 0.9)
        before, found = estimator.estimate(street), sure.estimate(street)
        prob = before.visible_prob
        kept = (prob >= np.float32(0.9)) | (prob <= np.float32(1 - 0.9))
        assert (before.state[~kept] != viewshed.CellState.UNKNOWN).any()
        assert (found.state[~kept] == viewshed.CellState.UNKNOWN).all()
        assert np.array_equal(found.state[kept], before.state[kept])
        assert found.threshold == 0.9
        assert same(estimator.with_abstention(0.5).estimate(street), before)
    else:
        with pytest.raises(ValueError, match=f"estimator of probabilities, got 0.9 for {estimator.name}, whose masks"):
            estimator.with_abstention(0.9)


def test_a_stream_gives_an_estimate_for_each_sweep_as_it_is_read(estimator: Estimator, street: Sweep) -> None:
    read = 0

    def sweeps() -> Iterator[Sweep]:
        nonlocal read
        for number in range(3):
            read += 1
            yield _at(street, float(number), float(number))

    estimates = estimator.stream(sweeps())
    assert next(estimates).t_ns == 0
    assert read == 1
    assert [estimate.t_ns for estimate in estimates] == [10**9, 2 * 10**9]


def test_load_estimator_takes_names_and_values() -> None:
    by_name = load_estimator("shadow_map", grid="indoor", target="pedestrian")
    by_value = load_estimator("shadow_map", grid=ROOM, target=PEDESTRIAN)
    assert by_name == by_value
    own = Target("pallet", 1.2, 0.8, 0.3, 4)
    assert load_estimator("first_blocker", target=own).target is own
    for former in ("vote", "polygon_fit", "mcd"):
        assert load_estimator(former).name == FORMER_NAMES[former]
    assert load_estimator("paper_polygon_fit").name == "paper_delaunay"


def test_the_default_is_the_same_on_every_grid_and_target() -> None:
    for grid in (ROAD, ROOM, BevGrid(64, 16.0)):
        for target in (viewshed.CAR, PEDESTRIAN):
            assert load_estimator(grid=grid, target=target).name == DEFAULT_ESTIMATOR
    assert viewshed.estimate(Sweep(np.zeros((0, 3), np.float32))).method == DEFAULT_ESTIMATOR


def test_weights_alone_say_which_network_they_are() -> None:
    assert load_estimator(weights="road").name == "unet"
    with pytest.raises(ValueError, match=r"weights must be a file .* or one of road, indoor, .*, got 'viewnet_road'"):
        load_estimator(weights="viewnet_road")


def test_the_network_that_is_gone_is_the_default_with_one_warning(street: Sweep) -> None:
    assert "viewnet" not in ESTIMATORS
    with pytest.warns(FutureWarning, match="method viewnet was removed, and shadow_map") as seen:
        found = load_estimator("viewnet", target=PEDESTRIAN, abstain_below=0.8)
    assert len(seen) == 1
    assert seen[0].filename == __file__
    assert found == load_estimator("shadow_map", target=PEDESTRIAN, abstain_below=0.8)
    with pytest.warns(FutureWarning):
        assert same(viewshed.estimate(street, method="viewnet"), viewshed.estimate(street))


def test_a_file_of_weights_is_an_estimator(tmp_path: Path, street: Sweep) -> None:
    grid, shape, path = BevGrid(64, 16.0), UNetShape(4, 2, 0.3), tmp_path / "net.onnx"
    export_onnx(path, card(shape, grid), nearby(shape))
    assert load_estimator(path, grid=grid).name == "unet"
    assert viewshed.estimate(street, method=path, grid=grid).visible().any()
    with pytest.raises(ValueError, match="weights must be left out where a file is named"):
        load_estimator(path, grid=grid, weights="road")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"name": "oracle"}, "method must be one of continuous, .*, mc_dropout, got 'oracle'"),
        ({"name": "unet", "seed": 3}, "seed must be left out for unet, which samples no masks, got 3; use mc_dropout"),
        ({"name": "unet", "abstain_below": 0.2}, r"abstain_below must lie in \[0.5, 1\], got 0.2"),
        ({"name": "shadow_map", "abstain_below": 1.2}, r"abstain_below must lie in \[0.5, 1\], got 1.2"),
    ],
)
def test_options_that_do_not_fit_are_named(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        load_estimator(**options)  # type: ignore[arg-type]


def test_a_saved_estimate_keeps_its_threshold(street: Sweep, tmp_path: Path) -> None:
    from viewshed.io.export import read_npz

    estimate = replace(viewshed.estimate(street, method="shadow_map", target=PEDESTRIAN), threshold=0.9)
    found = read_npz(estimate.save(tmp_path / "fov.npz"))
    assert (found.method, found.target, found.threshold) == ("shadow_map", PEDESTRIAN, 0.9)
    assert np.array_equal(found.visible(), estimate.visible_prob >= np.float32(0.9))
    assert estimate.save(str(tmp_path / "fov.geojson")).stat().st_size > 1000
    assert estimate.save(tmp_path / "fov.png").read_bytes() == estimate.plot()
    with pytest.raises(ValueError, match=r"must end in .geojson, .*, or .png for a picture; the suffix chooses"):
        estimate.save(tmp_path / "fov.tiff")
