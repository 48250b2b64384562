"""Single-agent fusion on tracks made by hand: what is explained, what is accused, and what is left."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.agents.by_hand import CAR, GHOST, HandView, cells, model, tracks, view

from viewshed.monitor.evidence.base import SECTORS
from viewshed.monitor.report import IntegrityReport
from viewshed.objects.cells import SeenCells
from viewshed.objects.evidence import EvidenceModel
from viewshed.objects.explained import FABRICATED, MOVED, REMOVED, Explanation
from viewshed.objects.jumps import EARLIER, LATEST, Sightings
from viewshed.objects.single import SingleFusion

TIMES = np.arange(0.0, 3.0, 0.1)


def test_a_car_that_is_seen_is_seen_and_a_ghost_in_the_open_is_accused_at_once() -> None:
    """The ghost is dropped, the car stays; the sentence says what speaks against the ghost."""
    fusion = SingleFusion(model())
    for t_s in TIMES[:5]:
        explained = fusion.explain(*tracks(t_s, [CAR, GHOST], [True, True]), [view(t_s)])
    assert explained.explanations.tolist() == [Explanation.SEEN, Explanation.SEEN_THROUGH]
    assert explained.accused.tolist() == [False, True]
    assert explained.suspicions[1] == FABRICATED
    assert explained.reasons[1].startswith("beams pass through 100% of its box")
    assert explained.trusted().ids.tolist() == [0]


def test_a_removed_car_is_missed_while_its_surface_stands_and_held_when_the_tracker_gave_it_up() -> None:
    """Detected for a second and more, then never again: accused, kept, less sure from sweep to sweep."""
    fusion = SingleFusion(model())
    for t_s in TIMES[:12]:
        fusion.explain(*tracks(t_s, [CAR], [True]), [view(t_s)])
    for t_s in TIMES[12:15]:
        explained = fusion.explain(*tracks(t_s, [CAR], [False]), [view(t_s)])
    assert explained.explanations.tolist() == [Explanation.MISSED]
    variance = []
    for t_s in TIMES[15:]:
        explained = fusion.explain(*tracks(t_s, [], []), [view(t_s)])
        variance += explained.trusted().covariances[:, 0, 0].tolist()
    assert explained.held.tolist() == [True]
    assert explained.explanations.tolist() == [Explanation.MISSING]
    assert explained.suspicions.tolist() == [REMOVED]
    assert np.allclose(explained.trusted().boxes[:, :2], CAR[:2])
    assert (np.diff(variance) > 0).all()
    assert len(variance) > 3


@pytest.mark.parametrize(("p", "expected"), [(0.05, Explanation.HIDDEN), (0.95, Explanation.MISSED)])
def test_a_car_that_drives_off_or_is_hidden_is_not_accused(p: float, expected: Explanation) -> None:
    """Behind a truck nothing is suspicious; and where its cells are seen free it is simply gone."""
    fusion = SingleFusion(model())
    for t_s in TIMES[:15]:
        fusion.explain(*tracks(t_s, [CAR], [True]), [view(t_s)])
    explained = fusion.explain(*tracks(1.5, [CAR], [False], p=p), [view(1.5, p=p)])
    assert explained.explanations.tolist() == [expected]
    for t_s in TIMES[16:]:
        box = CAR if p < 0.5 else GHOST
        explained = fusion.explain(*tracks(t_s, [box], [False], p=p), [view(t_s, p=p)])
    assert not explained.accused.any()


@pytest.mark.parametrize("was_there", [False, True])
def test_a_ghost_with_a_surface_is_named_by_the_cells_before_it(was_there: bool) -> None:
    """Made in the sweep it has returns and a shadow as a car has; a car that was missed at first had them before."""
    fusion = SingleFusion(model())
    for t_s in TIMES[:12]:
        fusion.explain(*tracks(t_s, [], []), [replace(view(t_s), cells=cells(with_car=was_there))])
    for t_s in TIMES[12:18]:
        explained = fusion.explain(*tracks(t_s, [CAR], [True]), [view(t_s)])
    assert explained.accused.tolist() == [not was_there]
    assert explained.explanations.tolist() == [Explanation.SEEN if was_there else Explanation.NEW_IN_FREE]


def test_a_parked_car_that_jumps_is_moved() -> None:
    """By 2.5 m within a tenth of a second: accused, and put back."""
    fusion, rng = SingleFusion(model()), np.random.default_rng(0)
    accused = []
    for k, t_s in enumerate(TIMES[:20]):
        box = CAR.copy()
        box[:2] += rng.normal(0.0, 0.05, 2)
        box[1] += 2.5 if k >= 15 else 0.0
        explained = fusion.explain(*tracks(t_s, [box], [True]), [view(t_s, with_cells=False)])
        accused.append(bool(explained.accused[0]))
    assert not any(accused[:15])
    assert accused[17]
    assert explained.suspicions[0] == MOVED
    assert np.hypot(*(explained.trusted().boxes[0, :2] - CAR[:2])) < 1.0


def test_under_alarm_the_verdict_abstains() -> None:
    """In a suspect sector nothing is said of the ghost; in the others it is accused as before."""

    def suspected(azimuth: float) -> IntegrityReport:
        sectors = np.zeros(SECTORS, bool)
        middle = int((azimuth + np.pi) / (2 * np.pi) * SECTORS)
        sectors[middle - 3 : middle + 4] = True
        return IntegrityReport("by hand", 2.0, 1.0, suspect=sectors)

    at_ghost = float(np.arctan2(GHOST[1], GHOST[0]))
    for azimuth, expected in ((at_ghost, Explanation.ABSTAINED), (at_ghost + 2.0, Explanation.SEEN_THROUGH)):
        fusion = SingleFusion(model())
        for t_s in TIMES[:5]:
            explained = fusion.explain(*tracks(t_s, [GHOST], [True]), [view(t_s, report=suspected(azimuth))])
        assert explained.explanations.tolist() == [expected]
        assert explained.accused.tolist() == [expected != Explanation.ABSTAINED]


def test_a_second_sensor_helps_where_the_first_says_nothing() -> None:
    """A first sensor that knows no cell accuses nobody; with the second one the ghost is seen through."""
    unknown = cells()
    unknown = SeenCells(unknown.grid, np.zeros_like(unknown.state), unknown.frame_from_level)
    alone, both = SingleFusion(model()), SingleFusion(model())
    for t_s in TIMES[:8]:
        shown, first = tracks(t_s, [GHOST], [True]), replace(view(t_s), cells=unknown)
        one = alone.explain(*shown, [first])
        two = both.explain(*shown, [first, view(t_s, sensor="left")])
    assert one.accused.tolist() == [False]
    assert two.accused.tolist() == [True]


def test_bad_input_is_refused_in_one_line() -> None:
    """No view, two of one name, one of another time, and too many tracks."""
    fusion = SingleFusion(model())
    shown = tracks(1.0, [CAR], [True])
    for views in ([], [view(1.0), view(1.0)]):
        with pytest.raises(ValueError, match="views must be of one sensor at least, each once"):
            fusion.explain(*shown, views)
    with pytest.raises(ValueError, match=r"views must be of the tracks' time 1\.000 s, got 4\.000 s of top"):
        fusion.explain(*shown, [view(4.0)])
    many = tracks(1.0, [CAR] * 2001, [False] * 2001)
    with pytest.raises(ValueError, match="tracks must be at most 2000 in one message, got 2001"):
        fusion.explain(*many, [view(1.0)])


def test_without_poses_less_is_explained_and_it_says_so() -> None:
    """A parked car jumps by 2.5 m: that may be the vehicle's own motion. A ghost is seen through all the same."""
    fusion = SingleFusion(model())
    for k, t_s in enumerate(TIMES[:20]):
        box = CAR.copy()
        box[1] += 2.5 if k >= 15 else 0.0
        shown, found = tracks(t_s, [box, GHOST], [True, True])
        here = replace(view(t_s), view=HandView(t_s, in_world=False))
        explained = fusion.explain(replace(shown, in_world=False), found, [here])
    assert explained.accused.tolist() == [False, True]
    assert explained.notes == (
        "no poses: sudden moves and births are not judged, and tracks that the tracker gave up are not carried over",
    )
    with pytest.raises(ValueError, match="views must be in the tracks' frame, the sensor's level frame, got another"):
        fusion.explain(replace(shown, in_world=False), found, [view(shown.t_s)])


def test_a_flood_of_tracks_is_bounded_work() -> None:
    """As many tracks as are taken, in one place: each is explained, in less than a second of the processor."""
    boxes = [CAR + np.array([0.01 * k, 0, 0, 0, 0, 0, 0]) for k in range(2000)]
    fusion, began = SingleFusion(model()), time.thread_time()
    explained = fusion.explain(*tracks(0.0, boxes, [k % 2 == 0 for k in range(2000)]), [view(0.0)])
    assert len(explained) == len(explained.reasons) == 2000
    assert time.thread_time() - began < 1.0


def test_time_that_goes_back_begins_anew() -> None:
    """Nothing that was held against a track in the first recording is held in the second."""
    fusion = SingleFusion(model())
    for t_s in TIMES[:8]:
        fusion.explain(*tracks(t_s, [GHOST], [True]), [view(t_s)])
    explained = fusion.explain(*tracks(-1.0, [CAR], [True]), [view(-1.0)])
    assert not explained.accused.any()


def test_the_way_of_earlier_places_is_that_of_least_squares() -> None:
    """Against numpy's polynomial, over uneven times and the whole length of the past."""
    rng = np.random.default_rng(3)
    times = np.cumsum(rng.uniform(0.05, 0.2, LATEST + EARLIER))
    places = np.column_stack([5.0 * times, -2.0 * times]) + rng.normal(0.0, 0.2, (len(times), 2))
    _, vectors = Sightings(times[None], places[None]).jumps()
    line = np.polynomial.polynomial.polyfit(times[:EARLIER], places[:EARLIER], 1)
    expected = places[-LATEST:].mean(axis=0) - (line[0] + line[1] * times[-LATEST:].mean())
    np.testing.assert_allclose(vectors[0], expected, atol=1e-9)
    # The latest places took 1.2 s: no sudden change.
    times[-LATEST:] = times[EARLIER - 1] + np.linspace(0.1, 1.3, LATEST)
    assert np.isnan(Sightings(times[None], places[None]).jumps()[0]).all()


def test_a_model_is_the_same_after_it_was_written(tmp_path: Path) -> None:
    """Saved and loaded; a file that holds something else is refused by name."""
    hand, path, other = model(), tmp_path / "model.json", tmp_path / "other.json"
    hand.save(path)
    assert EvidenceModel.load(path) == hand
    other.write_text("{}")
    with pytest.raises(ValueError, match=r"other\.json must hold an evidence model"):
        EvidenceModel.load(other)
