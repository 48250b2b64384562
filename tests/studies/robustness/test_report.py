"""What the report says: verdicts by hand, tables from known results, one HTML file that fetches nothing."""

import io
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread

from viewshed import BevGrid
from viewshed._page import Heading, Picture, Table, Text, to_html, to_markdown
from viewshed._page import PageBlock as Block
from viewshed.studies.cases import Case
from viewshed.studies.figures import (
    AGREE,
    HIDDEN,
    OUTSIDE,
    OVER,
    UNDER,
    Curves,
    Scene,
    Violins,
    compared,
    curve_figure,
    scene_figure,
    violin_figure,
)
from viewshed.studies.robustness import tables
from viewshed.studies.robustness import tables as tables_adaptive
from viewshed.studies.robustness import tables as tables_short
from viewshed.studies.robustness.page import blocks_of, details_of, told
from viewshed.studies.robustness.plan import study_named as named
from viewshed.studies.robustness.results import Results, Verdict, adaptive_verdict, verdict_of
from viewshed.studies.robustness.store import ResultStore

BENIGN = [80, 20, 20, 80]
"""Both, over, under, neither: precision, recall and F1 of .8."""
WEDGE = [8, 2, 2, 8]


def _scores(view: list[int], wedge: list[int]) -> dict[str, list[float]]:
    return {"majority_vote": [*view, *wedge, 0.75], "quantized": [*BENIGN, *(WEDGE if any(wedge) else wedge), 0.5]}


def _results(tmp_path: Path, worst: list[int], wedge: list[int]) -> Results:
    """Two samples: vote is given scores under a full ghost wall, quantized never changes."""
    study = replace(named("tiny"), attacks=("uniform", "ghost_wall"), budgets=("0", "150", "full"))
    store = ResultStore.open(tmp_path, study)
    calm = _scores(BENIGN, [0] * 4)
    cases: list[dict[str, Any]] = [
        {"case": ["benign", "", "", ""], "scores": calm},
        {"case": ["attack", "uniform", "0", ""], "scores": calm},
        {"case": ["attack", "uniform", "150", ""], "scores": _scores([80, 60, 20, 40], [0] * 4)},
        {"case": ["attack", "ghost_wall", "0", ""], "scores": _scores(BENIGN, WEDGE)},
        {"case": ["attack", "ghost_wall", "150", ""], "scores": _scores(BENIGN, WEDGE)},
        {"case": ["attack", "ghost_wall", "full", ""], "scores": _scores(worst, wedge)},
        {"case": ["attack", "replay", "full", ""], "refused": "replay needs an earlier sweep"},
    ]
    paper = [{"case": ["benign", "", "", ""], "scores": {"paper_quantized": [80, 20, 20, 80, 0, 0, 0, 0, 0.8]}},
             {"case": ["paper", "uniform", "150", ""],
              "scores": {"paper_quantized": [60, 40, 20, 80, 0, 0, 0, 0, 0.6]}}]  # fmt: skip
    defended = [{"case": ["benign", "", "", "radius"], "defense": [None, 0, 0, 3, 100], "scores": calm},
                {"case": ["attack", "ghost_wall", "full", "radius"], "defense": [None, 5, 50, 1, 100],
                 "scores": _scores(worst, wedge)},
                {"case": ["attack", "ghost_wall", "full", "empty_sector"], "defense": [1, 0, 50, 0, 100],
                 "scores": _scores(worst, wedge)}]  # fmt: skip
    for number in (0, 1):
        for part, found in (("attacks", cases), ("paper", paper), ("defenses", defended)):
            about = {"scene": "s", "returns": 1, "cell_m2": 0.25}
            store.append({"job": ["ugv", number, part], "about": about, "cases": found})
    return Results.read(store)


def test_who_loses_nothing_withstands(tmp_path: Path) -> None:
    found = _results(tmp_path, BENIGN, WEDGE)
    for estimator in ("majority_vote", "quantized"):
        assert verdict_of(found, "ugv", "ghost_wall", estimator) == Verdict(0.0, 0.0, 0.0)
    assert verdict_of(found, "ugv", "ghost_wall", "majority_vote").words() == "yes"


def test_a_wedge_called_visible_is_found_although_the_view_hardly_changes(tmp_path: Path) -> None:
    """Precision in the wedge falls from 8/10 to 10/20; F1 of the view from .8 to 164/(164+26+18) = .788."""
    found = _results(tmp_path, [82, 26, 18, 74], [10, 10, 0, 0])
    verdict = verdict_of(found, "ugv", "ghost_wall", "majority_vote")
    assert verdict.precision == pytest.approx(0.3)
    assert verdict.recall == 0.0  # it rises at the full budget; at 150 nothing changes
    assert verdict.f1 == pytest.approx(0.8 - 164 / 208)
    assert verdict.words() == "over .30"


def test_without_a_wedge_the_view_counts(tmp_path: Path) -> None:
    found = _results(tmp_path, BENIGN, WEDGE)
    verdict = verdict_of(found, "ugv", "uniform", "majority_vote")
    assert verdict.precision == pytest.approx(80 / 100 - 80 / 140)
    assert verdict.words() == "over .23"


def test_who_claims_nothing_any_more_loses_all_recall(tmp_path: Path) -> None:
    found = _results(tmp_path, [72, 18, 28, 82], [0, 0, 10, 10])
    verdict = verdict_of(found, "ugv", "ghost_wall", "majority_vote")
    assert (verdict.precision, verdict.recall) == pytest.approx((0.0, 0.8))


def test_tables_say_what_was_counted(tmp_path: Path) -> None:
    found = _results(tmp_path, [82, 26, 18, 74], [10, 10, 0, 0])
    clean = tables.benign_table(found, "ugv").rows
    assert clean[1] == ["majority_vote", ".800", ".800", ".800 [.800, .800]", ".667", "5", "5", ".750"]
    means = {row[0]: row[1:] for row in tables.budget_table(found, "ugv").rows}
    assert means["ghost_wall (6)"] == ["**.800 ±.000**", ".794 ±.000"]  # (.800 + .788) / 2
    wedge = tables.wedge_table(found, "ugv").rows
    assert wedge == [["ghost_wall", ".800 / .800", ".500 / 1.000"], ["*untouched*", ".800 / .800", ".800 / .800"]]
    assert tables.area_table(found, "ugv").rows[2] == ["ghost_wall", "+0 / +0", "+2 / -0"]
    assert tables_short.bar_overview(found, "wedge").rows == [["ghost_wall", ".800 [.800, .800] quantized"]]
    assert tables_short.bar_overview(found, "view").rows[1] == ["uniform", ".800 [.800, .800] quantized"]
    assert tables.paper_table(found, "ugv").rows == [["paper_quantized", ".800", ".600 (-25 %)"]]
    assert tables.fall_of(found, "ugv", "paper_quantized", Case("paper", "uniform", "150")) == pytest.approx(0.25)
    caught = {row[0]: row[1:] for row in tables.caught_table(found, "ugv").rows}
    assert caught["ghost_wall"] == [".100 / .010", "alarm 1.00"]
    assert caught["*benign*"] == ["– / .030", "–"]
    assert tables.gain_table(found, "ugv").rows[0] == ["radius", "+.000 / –", "+.000 / –"]
    assert tables.verdict_table(found, "ugv", 200).rows == [
        ["uniform", "yes", "over .23"],
        ["ghost_wall", "yes", "yes"],
    ]


def _asked(tmp_path: Path) -> Results:
    """Three samples, the first of which meets attackers who ask: they open half of the wedge of vote."""
    study = replace(
        named("tiny"), samples=(3,), attacks=("far_wall",), budgets=("0", "150"), defenses=("radius",),
        adaptive=("adaptive_over_claim",), adaptive_defended=("majority_vote",),
    )  # fmt: skip
    store = ResultStore.open(tmp_path, study)
    calm, opened = _scores(BENIGN, WEDGE), _scores([82, 26, 18, 74], [10, 10, 0, 0])
    half, little = _scores([80, 24, 20, 76], [8, 6, 2, 4]), _scores([80, 22, 20, 78], [8, 4, 2, 6])
    fixed: list[dict[str, Any]] = [
        {"case": ["benign", "", "", ""], "scores": _scores(BENIGN, [0] * 4)},
        {"case": ["attack", "far_wall", "0", ""], "scores": calm},
    ]
    asked: list[dict[str, Any]] = [
        {"case": ["adaptive", "adaptive_over_claim", "0", ""], "scores": calm},
        {"case": ["adaptive", "adaptive_over_claim", "150", ""], "scores": opened},
        {
            "case": ["adaptive", "adaptive_over_claim", "0", "radius"],
            "scores": {"majority_vote": calm["majority_vote"]},
        },
        {
            "case": ["unaware", "adaptive_over_claim", "150", "radius"],
            "scores": {"majority_vote": little["majority_vote"]},
        },
        {
            "case": ["adaptive", "adaptive_over_claim", "150", "radius"],
            "scores": {"majority_vote": half["majority_vote"]},
        },
    ]
    about = {"scene": "s", "returns": 1, "cell_m2": 0.25}
    for number in range(3):
        more = little if number == 0 else opened  # samples that nobody who asks meets do not count beside him
        cases = [*fixed, {"case": ["attack", "far_wall", "150", ""], "scores": more}]
        store.append({"job": ["ugv", number, "attacks"], "about": about, "cases": cases})
    store.append({"job": ["ugv", 0, "adaptive"], "about": about, "cases": asked})
    return Results.read(store)


def test_who_asks_is_compared_on_the_samples_that_were_asked_for(tmp_path: Path) -> None:
    """Precision in the wedge: .8 untouched, 8/12 under the far wall, 10/20 under the attacker who asked."""
    found = _asked(tmp_path)
    assert tables_adaptive.adaptive_table(found, "ugv").rows == [
        ["quantized", "far_wall +0 m² (.000)", "far_wall +0 m² (.000)", "+0 m² (.000)"],
        ["majority_vote", "far_wall +0 m² (.133)", "far_wall +0 m² (.000)", "+2 m² (.300)"],
    ]  # over: 22 - 20 and 26 - 20 cells of .25 m²
    verdict = adaptive_verdict(found, "ugv", "adaptive_over_claim", "majority_vote")
    assert (verdict.precision, verdict.recall) == pytest.approx((0.3, -0.2))
    assert verdict.f1 == pytest.approx(0.8 - 164 / 208)
    assert tables_short.summary_table(found, "ugv").rows[1][-1] == "0 of 1"
    assert tables_short.summary_table(found, "ugv").rows[0][-1] == "**1 of 1**"


@pytest.mark.slow
def test_a_defense_stands_with_and_without_being_known(tmp_path: Path) -> None:
    table = tables_adaptive.duel_table(_asked(tmp_path), "ugv", "adaptive_over_claim")
    assert table.header == ["", "vote, untouched", "vote, defense not known", "vote, defense known"]
    assert table.rows == [
        ["*no defense*", ".800 / .800", "–", ".500 / 1.000"],
        ["radius", ".800 / .800", ".667 / .800", ".571 / .800"],
    ]
    words = to_markdown("Report", {}, list(blocks_of(_asked(tmp_path))))
    asking = words.split("## Attackers who ask their victim first")[1].split("## The bar")[0]
    assert "- **quantized** withstands 1 of 1 in every domain: `adaptive_over_claim`." in asking
    assert "- **vote** withstands 0 of 1 in every domain: none." in asking
    assert "at most 8 plans" in " ".join(asking.split())
    assert "Samples: ugv 1." in asking


@pytest.mark.slow
def test_the_report_says_what_is_missing_and_what_was_refused(tmp_path: Path) -> None:
    found = _results(tmp_path, [82, 26, 18, 74], [10, 10, 0, 0])
    blocks = list(blocks_of(found, ["ugv 1 corruptions: no more memory"]))
    words = to_markdown("Report", told(found), blocks)
    assert "**Not finished: 6 of 9 jobs are done; a sample has up to 5.** 1 jobs failed: ugv 1 corruptions" in words
    assert "| ugv | replay | full |  | 2 | replay needs an earlier sweep |" in words
    assert "falls by 25 to 25 % (the paper: 18 to 60 %)" in words
    assert "- **quantized** withstands 2 of 2 in every domain: `uniform`, `ghost_wall`." in words
    assert "- **vote** withstands 1 of 2 in every domain: `ghost_wall`." in words
    assert "- **vote** withstands 0 of 2 in every domain: none." in words.split("### Up to a full wedge")[1]
    assert "Attackers who ask" not in words
    words += to_markdown("Tables", told(found), list(details_of(found)))
    assert re.findall(r"\bnan\b", words) == []


class _Fetches(HTMLParser):
    """Remembers every tag, and every address that a page would fetch."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "data")]


def test_the_html_fetches_nothing_and_hides_nothing() -> None:
    picture = Picture("a.png", b"\x89PNG", 'a "picture" & more')
    blocks: list[Block] = [Heading(2, "A < B"), Text("one `x_y`\nand *two*"), Text("- a\n  b\n- **c**"),
              Table(["n", "*m*"], [["1 & 2", "**3**"]]), picture]  # fmt: skip
    page, read = to_html("T", {"seed": "0"}, blocks), _Fetches()
    read.feed(page)
    assert read.addresses == ["data:image/png;base64,iVBORw=="]
    assert "http" not in page
    assert "url(" not in page
    for part in ("<h2>A &lt; B</h2>", "<p>one <code>x_y</code> and <i>two</i></p>", "<li>a b</li>", "<li><b>c</b></li>",
                 "<td>1 &amp; 2</td><td><b>3</b></td>", 'alt="a &quot;picture&quot; &amp; more"'):  # fmt: skip
        assert part in page
    assert read.tags.count("td") == 2


def test_a_claim_is_painted_by_what_it_gets_right() -> None:
    claimed = np.array([[True, True], [False, False]])
    truth = np.array([[True, False], [True, False]])
    known = np.ones((2, 2), bool)
    assert compared(claimed, truth, known).tolist() == [[list(AGREE), list(OVER)], [list(UNDER), list(HIDDEN)]]
    known[0, 0] = False
    assert compared(claimed, truth, known)[0, 0].tolist() == list(OUTSIDE)


def test_pictures_open_and_show_forward_above_and_left_on_the_left() -> None:
    grid = BevGrid(8, 4.0)
    claimed = np.zeros(grid.shape, bool)
    claimed[6:, 5:] = True  # ahead on the left, and false
    scene = Scene("a", grid, ~np.ones(grid.shape, bool), np.ones(grid.shape, bool), np.ones((2, 2), np.float32),
                  np.array([True, False]), (0.5, 0.4), {"one": claimed})  # fmt: skip
    image = np.asarray(imread(io.BytesIO(scene_figure([scene]))), float)[..., :3]
    rows, columns = np.nonzero(np.abs(image - OVER).max(axis=-1) < 0.04)
    upper = rows < 0.7 * image.shape[0]  # not the legend
    panel = columns[upper] - image.shape[1] / 2
    assert 0 < panel.mean() < image.shape[1] / 4
    assert rows[upper].mean() < image.shape[0] / 2


def test_figures_take_gaps_and_constant_values() -> None:
    values = np.array([0.5, 0.6, np.nan, 0.9])
    violins = violin_figure([Violins("a", {"x": (values, np.full(3, 0.2)), "y": (np.empty(0), values)})], 1, "attacked")
    curves = curve_figure([Curves("a", ["0", "1"], {"x": [0.5, float("nan")], "y": [0.1, 0.2]})], 2, "F1")
    for png in (violins, curves):
        image = np.asarray(imread(io.BytesIO(png)), float)[..., :3]
        assert min(image.shape[:2]) > 100
        assert image.std() > 0.01
