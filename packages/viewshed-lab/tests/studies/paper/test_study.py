"""The whole study on one domain of rooms: every step leaves what the next one needs, and nothing is done twice."""

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from tests.studies.by_hand import stored

from viewshed.grid import BevGrid
from viewshed.networks.architecture import UNetShape
from viewshed.networks.card import NetworkCard
from viewshed.networks.runtime import OnnxRunner
from viewshed.networks.weights import manifest
from viewshed_lab._results import page_files
from viewshed_lab.studies.cases import TOUCHING
from viewshed_lab.studies.formatting import format_rate
from viewshed_lab.studies.paper import tables
from viewshed_lab.studies.paper.data import evaluation_of, held_out, open_archive
from viewshed_lab.studies.paper.jobs import ATTACKED, Scope, do_job, missing_models, run_study, tampered_of
from viewshed_lab.studies.paper.models import NetworkAlone, config_of, fold_scores
from viewshed_lab.studies.paper.page import files_of
from viewshed_lab.studies.paper.plan import PaperPlan
from viewshed_lab.studies.paper.protocols import setting_of
from viewshed_lab.studies.paper.published import OTHERS, SUB_TABLES, PaperResults
from viewshed_lab.studies.records import BENIGN, Series
from viewshed_lab.studies.runner import Job
from viewshed_lab.studies.store import JOBS, ResultStore
from viewshed_lab.training import calibrate_int8

pytestmark = pytest.mark.slow

PLAN = replace(
    PaperPlan.load("tiny"), domains=("ugv",), train_scenes=(4,), train_times=(2,), test_scenes=(9,), test_times=(5,),
    interval_s=(0.5,), strict_frames=1, strengths=False, trade_widths=(4,), frames_per_epoch=4, epochs=1,
    pair_frames=(3,), crossval_frames=4,
)  # fmt: skip
Steps = list[tuple[str, int, int]]


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[ResultStore[PaperPlan], Steps]]:
    """A study that has been run from start to end."""
    before, seen = os.environ.get("OMP_NUM_THREADS"), Steps()
    os.environ["OMP_NUM_THREADS"] = "1"
    store = ResultStore.open(tmp_path_factory.mktemp("study"), PLAN)
    assert list(run_study(store, Scope(workers=1), lambda *step: seen.append(step))) == []
    yield store, seen
    if before is None:
        del os.environ["OMP_NUM_THREADS"]


def test_every_job_is_there_and_none_is_done_twice(study: tuple[ResultStore[PaperPlan], Steps]) -> None:
    store, seen = study
    assert store.keys() == set(PLAN.job_keys())
    assert [step for step in seen if step[0] == "models"][-1] == ("models", 8, 8)
    assert [step for step in seen if step[0] == "crossval"][-1] == ("crossval", 4, 4)
    before = {path: path.stat().st_mtime_ns for path in (store.folder / JOBS).iterdir()}
    assert list(run_study(store, Scope(workers=1))) == []
    assert {path: path.stat().st_mtime_ns for path in (store.folder / JOBS).iterdir()} == before


_KILLED = """
import os
import signal
import sys
from pathlib import Path
from tests.studies.paper.test_study import PLAN, SOME
from viewshed_lab.studies.paper.jobs import run_study
from viewshed_lab.studies.store import ResultStore
from viewshed_lab.training import fit

def save_and_die(path, content):
    save(path, content)
    if path.name == "last.ckpt" and path.parent.name == "fold-1":
        os.kill(os.getpid(), signal.SIGKILL)

save, fit.save = fit.save, save_and_die
list(run_study(ResultStore.open(Path(sys.argv[1]), PLAN), SOME))
"""

SOME = Scope(steps=("data", "crossval"), protocols=("paper",), workers=1)


def test_a_killed_run_goes_on_and_ends_the_same(study: tuple[ResultStore[PaperPlan], Steps], tmp_path: Path) -> None:
    store, _ = study
    run = subprocess.run([sys.executable, "-c", _KILLED, tmp_path], cwd=Path(__file__).parents[3], check=False)
    assert run.returncode == -signal.SIGKILL
    again = ResultStore.open(tmp_path, PLAN)
    done = again.keys()
    left = [key for step in SOME.steps for key in PLAN.job_keys_of(step, SOME.protocols) if key not in done]
    assert left
    assert list(run_study(again, SOME)) == []
    assert fold_scores(PLAN, tmp_path) == fold_scores(PLAN, store.folder)


def test_models_are_trained_with_what_cross_validation_chose(study: tuple[ResultStore[PaperPlan], Steps]) -> None:
    store, _ = study
    scores = fold_scores(PLAN, store.folder)
    assert {(one.dropout, one.learning_rate) for one in scores} == {(0.1, 0.001), (0.1, 0.01)}
    assert {len(folds) for folds in scores.values()} == {PLAN.crossval_folds}
    best = max(scores, key=lambda one: np.mean([fold.f1 for fold in scores[one]]))
    config = config_of(PLAN, store.folder, PLAN.models(["paper"])[0])
    assert np.mean([fold.f1 for fold in scores[best]]) == np.mean(
        [fold.f1 for one in scores if one.learning_rate == config.learning_rate for fold in scores[one]]
    )
    assert not missing_models(PLAN, PLAN.models()[0].key, store.keys())
    assert missing_models(PLAN, PLAN.models()[0].key, set()) == "not all folds are done"


def test_scores_of_a_job_are_the_same_when_it_is_done_again(
    study: tuple[ResultStore[PaperPlan], Steps], tmp_path: Path
) -> None:
    store, _ = study
    key = ("pairs", "strict", "mcd-adversarial-ugv", "ugv", "0")
    again = ResultStore.open(tmp_path, PLAN)
    again.append(key, do_job(Job(PLAN, store.folder, key)))
    assert stored(again)[key][0] == stored(store)[key][0]  # the other part says how long it took


def test_pages_hold_targets_facts_and_figures(
    study: tuple[ResultStore[PaperPlan], Steps], monkeypatch: pytest.MonkeyPatch
) -> None:
    store, _ = study
    monkeypatch.setattr(tables, "OBJECT_SCENES", 1)
    results = PaperResults.read(store)
    for protocol in ("paper", "strict"):
        files = files_of(results, protocol)
        page = files[{"paper": "paper.md", "strict": "paper_strict.md"}[protocol]].decode()
        assert all(f"]({name})" in page for name in files if name.endswith(".png"))
        assert all(content.startswith(b"\x89PNG") for name, content in files.items() if name.endswith(".png"))
        assert "Not finished" not in page
        assert "Monte Carlo dropout is scored on one of every 2 of these sweeps." in page
        assert f"seeds: {PLAN.seed} trained, {PLAN.test_seed} tested" in page
    published = page_files("paper", files_of(results, "paper")["paper.md"].decode())["paper.md"]
    headings = [block.lstrip("# ") for block in published.split("\n\n") if block.startswith("#")]
    assert {table.title for table in (*SUB_TABLES, *OTHERS)} | {"Cross-validation", "Trainings"} <= set(headings)
    assert published.count("| AUPRC, tested on") == len((*SUB_TABLES, *OTHERS))
    assert {
        "paper_trade.png", "paper_spread.png", "paper_folds.png", "paper_crossval.png", "paper_resolutions.png"
    } <= set(files_of(results, "paper"))  # fmt: skip


def test_networks_are_shipped_in_bytes_with_a_page_and_those_that_would_lose_too_much_in_float32(
    study: tuple[ResultStore[PaperPlan], Steps], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (store, _), tool = study, import_module("ship_study")
    monkeypatch.setattr(calibrate_int8, "MAX_F1_LOSS", 1.0)
    tool.ship_study(store, 1, tmp_path, tmp_path / "models.md")
    page, lines = (tmp_path / "models.md").read_text("utf-8"), manifest(tmp_path)
    assert set(lines) == {f"paper-{model.name}" for model in PLAN.models(["paper"])}
    results = PaperResults.read(store)
    for name, line in lines.items():
        card = OnnxRunner(tmp_path / line.file, 1).card
        assert (card.precision, card.truth, card.grid, line.methods) == ("int8", "paper_label", BevGrid(32, 18.0), ())
        assert f"`{line.sha256[:12]}…` | 32 × 32, ±18 m" in page
        mixture = name.split("-")[2]
        case = BENIGN if mixture == "benign" else ATTACKED
        f1 = results.pairs.counts(Series("ugv", name.removeprefix("paper-"), case, protocol="paper")).f1
        assert re.search(rf"\| `{name}` \| ugv, {mixture} \|.* {format_rate(f1)} \| – \|", page)
    monkeypatch.setattr(calibrate_int8, "MAX_F1_LOSS", -1.0)
    tool.ship_study(store, 1, tmp_path / "whole", tmp_path / "models.md")
    whole = manifest(tmp_path / "whole")
    assert {OnnxRunner(tmp_path / "whole" / line.file, 1).card.precision for line in whole.values()} == {"f32"}
    assert list(whole) == list(lines)
    assert (tmp_path / "models.md").read_text("utf-8").count("| in float32 |") == len(whole)


def test_pages_say_what_is_missing(study: tuple[ResultStore[PaperPlan], Steps], tmp_path: Path) -> None:
    store, _ = study
    part = ResultStore.open(tmp_path, PLAN)
    for key in PLAN.job_keys_of("pairs", ["paper"]):
        shutil.copy(store.path_of(key), part.path_of(key))
    page = files_of(PaperResults.read(part), "paper")["paper.md"].decode()
    assert "**Not finished:** crossval 0 of 4, models 0 of 4, trade 0 of 1." in page
    with pytest.raises(ValueError, match="must hold pairs of the strict protocol, got none; run step pairs"):
        files_of(PaperResults.read(part), "strict")


def test_what_waits_for_a_model_is_told_and_left(tmp_path: Path) -> None:
    store = ResultStore.open(tmp_path, PLAN)
    with pytest.raises(ValueError, match="the other steps need the step data"):
        list(run_study(store, Scope(steps=("monitor",))))
    assert list(run_study(store, Scope(steps=("data",), workers=1))) == []
    problems = list(run_study(store, Scope(steps=("monitor",), workers=1)))
    assert problems == [
        f"monitor {mixture}: not all of its models are trained" for mixture in ("benign", "adversarial")
    ]


def test_data_of_another_seed_are_refused(tmp_path: Path) -> None:
    store = ResultStore.open(tmp_path, replace(PLAN, seed=PLAN.seed + 7))
    assert list(run_study(store, Scope(steps=("data",), workers=1))) == []
    other = ResultStore(tmp_path, PLAN)
    with pytest.raises(ValueError, match="ugv-train must be made as the plan tiny says, got sweeps of another recipe"):
        list(run_study(other, Scope(steps=("monitor",))))


def test_held_out_sweeps_are_of_other_scenes_and_have_a_past(study: tuple[ResultStore[PaperPlan], Steps]) -> None:
    store, _ = study
    train, test = (open_archive(store.folder, "ugv", split) for split in ("train", "test"))
    assert (len(train), len(test)) == (8, 45)
    samples = [held_out(PLAN, store.folder, "ugv", number) for number in range(12)]
    assert len({one.sample.scene for one in samples[:9]}) == 9
    assert samples[9].sample.scene == samples[0].sample.scene
    assert not np.array_equal(samples[9].sweep.points[:50], samples[0].sweep.points[:50])
    now, before = samples[0].sweep.t_ns, [sweep.t_ns for sweep in samples[0].earlier]
    assert now is not None
    assert [now - then for then in before if then is not None] == [2_000_000_000, 500_000_000]
    trained = {train[k].sweep.points.tobytes() for k in range(8)}
    assert not trained & {test[k].sweep.points.tobytes() for k in range(45)}


def test_attacks_of_the_strict_pairs_take_turns_and_the_truth_is_the_clean_one(
    study: tuple[ResultStore[PaperPlan], Steps],
) -> None:
    store, _ = study
    setting = setting_of(PLAN, "strict", "ugv")
    assert [setting.attack(number).name for number in range(3)] == list(TOUCHING[:3])
    for number in range(3):
        evaluation = evaluation_of(PLAN, store.folder, setting, setting.suite({}), number)
        tampered = tampered_of(evaluation, setting.attack(number), PLAN.test_seed)
        sample = held_out(PLAN, store.folder, "ugv", number)
        assert np.array_equal(evaluation.reference.visible, sample.truth.visible())
        assert tampered.added.any() or tampered.removed.any()


class _Echo:
    """Answers with its input, and with the sum of its masks in one corner."""

    def __init__(self) -> None:
        self.card = NetworkCard("echo", UNetShape(4, 2))

    def run(self, inputs: np.ndarray, masks: np.ndarray | None = None) -> np.ndarray:
        masks = np.ones((len(inputs), 1), np.float32) if masks is None else masks
        found = np.repeat(inputs[:, 0], len(masks), axis=0).astype(np.float32) / 255
        found[:, 0, 0] = masks.mean(axis=1) / 2
        return found

    def single_threaded(self) -> None:
        return


def test_a_network_is_tried_on_the_grid_of_where_it_is_tried(study: tuple[ResultStore[PaperPlan], Steps]) -> None:
    store, _ = study
    sweep = held_out(PLAN, store.folder, "ugv", 0).sweep
    setting, echo = setting_of(PLAN, "paper", "ugv"), _Echo()
    once = NetworkAlone(echo, setting.card(echo.card), 1, 0).estimate(sweep)
    assert np.isnan(np.asarray(once.std)).all()
    assert once.visible_prob[0, 0] == 0.5  # masks of ones
    counted = setting.grid.count(sweep.points, max_range_m=20.0)
    assert once.visible_prob.shape == counted.shape
    assert np.corrcoef(once.visible_prob[1:].ravel(), np.minimum(counted, 255)[1:].ravel())[0, 1] > 0.9
    several = NetworkAlone(echo, setting.card(echo.card), 5, 0)
    std = np.asarray(several.estimate(sweep).std)
    assert std[0, 0] > 0
    assert std[5, 5] == 0
    assert np.array_equal(several.estimate(sweep).visible_prob, several.estimate(sweep).visible_prob)
