"""The study in the wild: what is counted by hand, records that come back, the sealed set's log, the page."""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from tests.studies.by_hand import stored

from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.fov.height_map import HeightMap
from viewshed.fov.visibility import CAR
from viewshed.geometry import Rigid
from viewshed.metrics import ConfusionCounts
from viewshed.networks.weights import shipped_content
from viewshed.preprocess.leveling import level
from viewshed_lab._jobs import LocalEngine
from viewshed_lab.data.wild import WildObservation, wild_scenes
from viewshed_lab.sim.lidar.optics import optics_of
from viewshed_lab.studies.records import Row
from viewshed_lab.studies.store import ResultStore
from viewshed_lab.studies.wild.evaluate import LADDER, ground_error_m, row_of
from viewshed_lab.studies.wild.jobs import run_study
from viewshed_lab.studies.wild.openings import SetOpening
from viewshed_lab.studies.wild.page import files_of
from viewshed_lab.studies.wild.plan import WildPlan
from viewshed_lab.studies.wild.pool import FINE_BINS, Pool

TINY = WildPlan.load("tiny")
FAST = replace(TINY, scenes=1, methods=("first_blocker", "shadow_map"), told=("rings",), worst=0)


@pytest.fixture(scope="module")
def seen() -> WildObservation:
    """Return a sweep of the development set whose points lie in the sensor's frame."""
    return next(scene for scene in wild_scenes("development", "road") if scene.mounting == "dev_roof").observe(0)


def perfect(seen: WildObservation) -> FovEstimate:
    """Return an estimate that says the truth."""
    truth = seen.truth
    return FovEstimate(truth.grid, truth.visible(CAR).astype(np.float32), truth.state["car"], method="perfect")


def row(seen: WildObservation, estimate: FovEstimate) -> Row:
    """Return what is counted of an estimate."""
    sample = seen.sample("rings")
    return row_of(seen, sample, estimate, level(sample.sweep, seen.truth.grid), "hand")


def pool_of(*rows: Row) -> Pool:
    """Return rows together, with the columns that there must be."""
    return Pool(pd.DataFrame(list(rows), columns=None if rows else list(_blank())))


def within_reach(seen: WildObservation) -> NDArray[np.bool_]:
    """Cells of known truth as far as the sensor sees a dark target."""
    range_m = np.hypot(*np.moveaxis(seen.truth.grid.centers, -1, 0))
    reach: NDArray[np.bool_] = seen.known & (range_m <= optics_of(seen.sensor.model).reach_m)
    return reach


def test_the_truth_itself_makes_no_mistake(seen: WildObservation) -> None:
    found = row(seen, perfect(seen))
    assert (found["over"], found["under"]) == (0, 0)
    assert found["both"] + found["neither"] == within_reach(seen).sum()
    assert (found["beyond_m2"], found["unaimed_hidden"]) == (0.0, 0.0)
    assert pool_of(found).ece() == 0.0
    assert np.isnan(found["auroc"])


def test_everything_claimed_counts_as_beyond_off_and_wrong(seen: WildObservation) -> None:
    """By hand: the cells of the grid out of range, times the area of one; all claims are sure."""
    truth, grid = seen.truth, seen.truth.grid
    ones = np.ones(grid.shape, np.float32)
    found = row(seen, FovEstimate(grid, ones, np.full(grid.shape, CellState.FREE, np.uint8)))
    range_m = np.hypot(*np.moveaxis(grid.centers, -1, 0))
    beyond = seen.known & (range_m > seen.sensor.model.max_range_m + grid.cell_m)
    assert found["beyond_m2"] == pytest.approx(beyond.sum() * grid.cell_area_m2)
    assert found["claimed_m2"] == pytest.approx(seen.known.sum() * grid.cell_area_m2)
    assert found["off_m2"] == found["off_sure_m2"]
    within = within_reach(seen)
    assert found["over"] == (within & ~truth.visible(CAR)).sum()
    share = truth.visible(CAR)[within].mean()
    assert pool_of(found).ece() == pytest.approx(1 - share)


def test_hidden_where_no_beam_aims_is_counted(seen: WildObservation) -> None:
    grid, unaimed = seen.truth.grid, within_reach(seen) & (seen.truth.state["car"] == CellState.UNKNOWN)
    all_hidden = FovEstimate(grid, np.zeros(grid.shape, np.float32), np.full(grid.shape, CellState.HIDDEN, np.uint8))
    found = row(seen, all_hidden)
    assert found["unaimed_hidden"] == found["unaimed"] == unaimed.sum() > 0
    assert pool_of(found).share("unaimed_hidden", "unaimed") == 1.0


def test_doubt_that_knows_its_errors_has_an_auroc_of_about_one(seen: WildObservation) -> None:
    grid, true = seen.truth.grid, seen.truth.visible(CAR)
    prob = np.where(true, 0.95, 0.05).astype(np.float32)
    prob[100:110] = np.where(true[100:110], 0.4, 0.6)
    std = np.where(np.abs(prob - 0.5) < 0.2, 0.3, 0.01).astype(np.float32)
    estimate = FovEstimate(grid, prob, np.zeros(grid.shape, np.uint8), std)
    found = row(seen, estimate)
    # Cells beside an edge of the view are in some doubt as well.
    assert found["auroc"] > 0.99
    assert found["auroc_std"] == 1.0
    worse = row(seen, FovEstimate(grid, prob, np.zeros(grid.shape, np.uint8), 0.31 - std))
    assert worse["auroc_std"] == 0.0


def test_ground_that_follows_the_returns_is_right_whatever_the_attitude(seen: WildObservation) -> None:
    """By hand: a plane tilted by 4° with the frame is the level plane; raised by 2 m it is 2 m too high."""
    grid, half = seen.truth.grid, np.deg2rad(2.0)
    flat = replace(seen.sample("nothing"), ground_m=np.zeros(grid.shape, np.float32), origin_height_m=2.0,
                   attitude=np.array([np.cos(half), 0.0, np.sin(half), 0.0]))  # fmt: skip
    leveled = level(seen.given("nothing"), grid)
    steps = (np.arange(64) + 0.5) * 2 - 64.0
    tilted = np.broadcast_to(steps[:, None] * np.tan(np.deg2rad(4.0)), (64, 64)) - 2.0 / np.cos(np.deg2rad(4.0))
    as_given = Rigid(np.eye(3), np.array([0.0, 0.0, 2.0]))
    for raised in (0.0, 2.0):
        ground = HeightMap((tilted + 2.0 + raised).astype(np.float32), 64.0, np.ones((64, 64), bool))
        error = ground_error_m(replace(leveled, ground=ground, level_from_sensor=as_given), flat)
        assert error[4:-4, 4:-4] == pytest.approx(raised * np.cos(np.deg2rad(4.0)), abs=0.01)


def _blank() -> Row:
    keys = ("set_name", "domain", "scene", "style", "sensor", "mounting", "told", "target", "method")
    bins = np.zeros(3 * FINE_BINS)
    return (
        {"bins": bins, "clear_both": 0.0, "clear_over": 0.0, "clear_under": 0.0}
        | dict.fromkeys(keys, "x")
        | asdict(ConfusionCounts(1, 1, 1, 1, 1.0))
    )


def test_recall_at_a_precision_and_clear_cells_by_hand() -> None:
    """Of 10 sure cells 9 are visible, of 10 doubtful ones 5: precision .9 allows the sure ones alone, .7 all."""
    bins = np.zeros((FINE_BINS, 3))
    bins[140], bins[90] = (10, 9, 8.0), (10, 5, 6.0)
    numbers = {"clear_both": 3.0, "clear_over": 1.0, "clear_under": 1.0}
    pool = pool_of(_blank() | {"bins": bins.ravel()} | numbers)
    assert (pool.recall_at(0.9), pool.recall_at(0.7), pool.recall_at(0.95)) == (9 / 14, 1.0, 0.0)
    assert pool.clear_f1() == 0.75
    assert pool.ece() == pytest.approx(0.1)  # one of ten too few, one of ten too many
    assert np.isnan(pool_of().recall_at(0.5))


def test_means_are_over_scenes_and_shares_over_cells() -> None:
    numbers = [("a", 1.0, 1.0, 10.0), ("a", 0.0, 1.0, 10.0), ("b", 1.0, 8.0, 20.0), ("c", float("nan"), 0.0, 0.0)]
    pool = pool_of(*(_blank() | {"scene": s, "x": x, "part": p, "whole": w} for s, x, p, w in numbers))
    assert pool.mean("x") == 0.75
    assert pool.share("part", "whole") == 0.25
    assert pool.counts.samples == 4
    assert pool.mean_f1() == 0.5
    assert np.isnan(pool_of().mean_f1())
    assert pool.names("scene") == ["a", "b", "c"]


def test_the_files_of_a_run_that_was_stopped_goes_on(tmp_path: Path) -> None:
    store = ResultStore.open(tmp_path, FAST)
    with pytest.raises(ValueError, match="must hold results"):
        files_of(store)
    assert list(run_study(store, LocalEngine(1))) == []
    before, last = stored(store), FAST.job_keys()[-1]
    others = {key: store.path_of(key).read_bytes() for key in FAST.job_keys() if key[0] != "own"}
    for key in others:
        store.path_of(key).unlink()
    assert "own: F1" in files_of(store)["wild.md"].decode()  # before it has come to other worlds
    for key, content in others.items():
        store.path_of(key).write_bytes(content)
    store.path_of(last).unlink()
    again = ResultStore.open(tmp_path, FAST)
    assert list(run_study(again, LocalEngine(1))) == []
    assert stored(again) == before
    page = files_of(again)["wild.md"].decode()
    for word in ("own: F1", "other: F1", "shadow_map", *LADDER, "cutting"):
        assert word in page


def test_a_network_of_ones_own_stands_in_the_tables_by_its_files_name(tmp_path: Path) -> None:
    file = tmp_path / "mine.onnx"
    file.write_bytes(shipped_content("road_int8"))
    plan = replace(FAST, methods=("shadow_map",), ladder=False, sets=("development",), networks=(str(file),))
    store = ResultStore.open(tmp_path / "study", plan)
    assert list(run_study(store, LocalEngine(1))) == []
    assert "| mine |" in files_of(store)["wild.md"].decode()
    with pytest.raises(ValueError, match="networks must have distinct file names"):
        replace(plan, networks=(str(file), "elsewhere/mine.onnx"))


def test_the_sealed_set_is_run_with_a_logged_reason_only(tmp_path: Path) -> None:
    sealed = WildPlan.load("sealed")
    assert sealed.opens_sealed
    assert not WildPlan.load("small").opens_sealed
    with pytest.raises(ValueError, match="opens the sealed set"):
        run_study(ResultStore.open(tmp_path / "x", sealed), LocalEngine(1))
    log = tmp_path / "log.md"
    SetOpening("final table", ("shadow_map", "majority_vote")).log(log)
    SetOpening("once more", ("shadow_map",)).log(log)
    lines = [line for line in log.read_text(encoding="utf-8").splitlines() if line.startswith("| 2")]
    assert [line.split(" | ")[2:] for line in lines] == [
        ["final table", "shadow_map, majority_vote |"], ["once more", "shadow_map |"],
    ]  # fmt: skip
    assert log.read_text(encoding="utf-8").count("# Openings") == 1
    with pytest.raises(ValueError, match="must lie in a checkout"):
        SetOpening("a", ()).log(tmp_path / "none" / "log.md")
    with pytest.raises(ValueError, match="one line of text"):
        SetOpening(" ", ())
