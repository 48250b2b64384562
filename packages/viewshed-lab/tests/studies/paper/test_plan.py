"""What the study runs: plans, models, settings, and the names of its jobs."""

from viewshed_lab.studies.paper.jobs import needed
from viewshed_lab.studies.paper.plan import PROTOCOLS, PaperPlan
from viewshed_lab.studies.paper.protocols import setting_of

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
