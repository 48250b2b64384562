"""What the study runs: plans, models, settings, and the names of its jobs."""

from pathlib import Path

import pytest

from viewshed_lab.studies.paper.jobs import needed
from viewshed_lab.studies.paper.models import config_of, trade_config
from viewshed_lab.studies.paper.plan import PROTOCOLS, Model, PaperPlan
from viewshed_lab.studies.paper.protocols import setting_of
from viewshed_lab.threats.attacks import ATTACKS, FAMILY

TINY = PaperPlan.load("tiny")


def test_there_are_72_pairs_of_12_models_in_each_protocol() -> None:
    for protocol in PROTOCOLS:
        models = TINY.models([protocol])
        assert len(models) == len({model.name for model in models}) == 12
        keys = [key for key in TINY.job_keys_of("pairs", [protocol]) if key[2] != "classical"]
        assert 2 * len({key[:4] for key in keys}) == 72
    assert len(TINY.job_keys_of("models")) == 24


def test_a_pair_waits_for_its_model_and_nothing_else() -> None:
    def wait(*key: str) -> list[tuple[str, ...]]:
        return needed(TINY, key)

    assert wait("pairs", "paper", "mcd-benign-ugv", "carla", "0") == [("models", "paper", "mcd-benign-ugv")]
    assert wait("pairs", "paper", "classical", "carla", "0") == []
    assert {name for _, protocol, name in wait("strict", "carla", "0") if protocol == "strict"} == {
        "mle-benign-carla", "mle-adversarial-carla", "mcd-benign-carla", "mcd-adversarial-carla"
    }  # fmt: skip
    assert wait("monitor", "adversarial") == [("models", "strict", "mcd-adversarial-ugv")]


def test_settings_of_the_paper_are_its_own() -> None:
    """The figures are those of design 03: ±80 m and 100 m, indoors ±18 m and 20 m, threshold .7."""
    road, room = setting_of(TINY, "paper", "carla"), setting_of(TINY, "paper", "ugv")
    assert (road.grid.half_extent_m, road.max_range_m, road.heights_m, road.threshold) == (
        80.0,
        100.0,
        (-3.0, 3.0),
        0.7,
    )
    assert (room.grid.half_extent_m, room.max_range_m, room.truth) == (18.0, 20.0, "paper_label")
    strict = setting_of(TINY, "strict", "ugv")
    assert (strict.grid.half_extent_m, strict.grid.cells, strict.truth, strict.threshold) == (16.0, 32, "probe", 0.5)
    assert "paper_label" not in road.classical()
    assert {"paper_quantized", "majority_vote"} <= set(road.classical())
    assert "paper_quantized" not in strict.classical()


def test_models_differ_in_what_their_names_say(tmp_path: Path) -> None:
    configs = {model: config_of(TINY, tmp_path, model) for model in TINY.models()}
    for model, config in configs.items():
        assert config.variant == model.variant
        assert config.data[0].endswith(f"{model.domain}-train")
        assert (config.attacks == ()) == (model.mixture == "benign")
    assert configs[Model("paper", "mle", "adversarial", "ugv")].attacks == ("paper",)
    assert configs[Model("strict", "mle", "adversarial", "ugv")].attacks == TINY.trained_attacks
    assert len({config.seed for config in configs.values()}) == 1
    assert trade_config(TINY, tmp_path, (8, 2, 32)).width == 8


@pytest.mark.parametrize("name", ["small", "medium", "paper"])
def test_most_families_are_never_trained_on(name: str) -> None:
    trained = {FAMILY[attack] for attack in PaperPlan.load(name).trained_attacks}
    assert len({FAMILY[attack] for attack in ATTACKS} - trained) == 11
