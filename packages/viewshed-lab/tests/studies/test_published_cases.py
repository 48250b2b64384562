"""The four cases of the publication: small, each with the published method beside ours."""

from __future__ import annotations

import numpy as np
import pytest
from tests.agents.test_many import GRID

from viewshed.fov.estimate import CellState
from viewshed.fov.truth import Truth
from viewshed.geometry import Rigid
from viewshed_lab.studies import published_cases
from viewshed_lab.studies.published_cases import ATTACKS, CASES, _as_view, cases_page, mast_beside_a_car


def test_exact_truth_as_a_view_claims_what_is_seen_and_known() -> None:
    returns = np.zeros(GRID.shape, np.uint8)
    returns[:, :32] = 200
    truth = Truth(GRID, {"car": returns}, {"car": np.zeros(GRID.shape, np.uint8)})
    known = np.ones(GRID.shape, bool)
    known[:4] = False
    tilted = Rigid(Rigid.from_yaw(0.4).rotation, np.array([3.0, 4.0, 20.0]))
    made = _as_view(truth, known, tilted, "mast")
    assert (made.state[4:, :32] == CellState.FREE).all()
    assert (made.state[4:, 32:] == CellState.HIDDEN).all()
    assert (made.state[:4] == CellState.UNKNOWN).all()
    assert made.world_from_level is not None
    assert made.world_from_level.yaw == pytest.approx(0.4)


def test_agents_are_attacked_as_in_the_four_published_cases() -> None:
    """Static false positives on one agent, moving ones on two, translation on the infrastructure, on a vehicle."""
    attacks = [(attack, on) for attack, _, on in ATTACKS.values()]
    published = [
        ("fabricate_static", "car"), ("fabricate_markov", "cars"), ("translate_static", "mast"),
        ("translate_static", "car"),
    ]  # fmt: skip
    assert attacks == published


@pytest.mark.slow
def test_a_mast_adds_to_what_a_car_sees() -> None:
    _, rows = mast_beside_a_car(1)
    car, mast, both = (float(row[1]) for row in rows)
    assert max(car, mast) < both <= car + mast + 1
    assert all(0.5 < float(row[-1]) <= 1.0 for row in rows)


def test_the_page_has_a_table_for_each_case(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        published_cases, "CASES", {title: (lambda n: (("a", "b"), [["1", str(n)]]), "about") for title in CASES}
    )
    said = list[str]()
    text = cases_page(3, said.append)
    assert said == list(CASES)
    assert text.count("| 1 | 3 |") == len(CASES) == 4
    assert f"\n- seconds: {'; '.join(f'{title} 0' for title in CASES)}\n" in text
    assert all("The publication reports no" in about for _, about in list(CASES.values())[1:])
