"""How suspicious agents are by reports and views: on the scale of honest agents of their kind."""

from __future__ import annotations

import numpy as np
import pytest

from viewshed.agents.suspicion import Suspicion, Tail, suspicion_in_box

ELEVATED = np.array([False, False, True])


def fitted() -> Suspicion:
    """Return what 80 scenes of two low sensors and a mast say, whose evidence is three times as large."""
    rng = np.random.default_rng(5)
    evidence = rng.normal(size=(80, 4, 3)) * np.where(ELEVATED, 3.0, 1.0)
    return Suspicion.fit(evidence, rng.random((80, 4, 3, 2)), ELEVATED)


def test_a_tail_counts_and_goes_on_in_units_of_the_scenes() -> None:
    values = np.linspace(0.0, 1.0, 500).reshape(100, 5)
    tail = Tail.fit(values)
    half, tenth = tail(np.array([0.5, 0.9]))
    assert half == pytest.approx(-np.log10(0.5), abs=0.01)
    assert tail.begin + tail.unit == pytest.approx(np.quantile(values.max(axis=1), 0.9))
    assert tail(np.array([tail.begin + 5 * tail.unit]))[0] == pytest.approx(6.0, abs=0.01)
    assert tenth > half


def test_each_kind_of_sensor_is_judged_by_its_own() -> None:
    nothing = np.full((3, 2), np.nan)
    found = fitted()(np.array([6.0, 0.0, 6.0]), nothing, ELEVATED)
    assert found[0] > found[2] > found[1]


def test_reports_or_views_alone_make_suspicious() -> None:
    suspicion, usual = fitted(), np.full((3, 2), 0.5)
    odd = usual.copy()
    odd[1] = 3.0
    calm = suspicion(np.zeros(3), usual, ELEVATED)
    assert suspicion(np.zeros(3), odd, ELEVATED)[1] > calm[1] + 1.0
    assert suspicion(np.array([9.0, 0.0, 0.0]), usual, ELEVATED)[0] > calm[0] + 1.0
    assert suspicion(np.zeros(3), np.full((3, 2), np.nan), ELEVATED)[1] <= calm[1]


def test_it_is_kept_as_text_as_it_was() -> None:
    suspicion = fitted()
    again = Suspicion.from_json(suspicion.to_json())
    rng = np.random.default_rng(6)
    evidence, checks = rng.normal(size=(20, 3)), rng.random((20, 3, 2))
    assert again(evidence, checks, ELEVATED) == pytest.approx(suspicion(evidence, checks, ELEVATED), abs=0.02)


def test_the_one_in_the_box_knows_all_checks() -> None:
    from viewshed.agents.view_checks import VIEW_CHECKS

    found = suspicion_in_box()(np.zeros(3), np.full((3, len(VIEW_CHECKS)), np.nan), ELEVATED)
    assert np.isfinite(found).all()
    assert len(suspicion_in_box().views.low.values) == len(VIEW_CHECKS)
