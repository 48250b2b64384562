"""Pictures of many agents: who contradicts whom, and a page that holds them."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
from PIL import Image
from tests.agents.test_many import AGENTS, CARS, report

from viewshed.agents.rounds import Round, Rounds
from viewshed.show.fused import (
    CONTRADICTION_NATS,
    DISTRUSTED,
    STRIP_SIDE,
    TRUSTED,
    agent_color,
    claimed_free,
    contradictions,
    fused_page,
    fused_picture,
    fused_strip,
)

GHOST = np.array([[6.0, -6.0, 0.8, 4.2, 1.8, 1.5, 0.0], [14.0, -12.0, 0.8, 4.2, 1.8, 1.5, 0.0]])


def rounds(lies: bool) -> list[Round]:
    """Return rounds of three agents, of which the last one reports two objects that are not there."""
    gathered, said = Rounds(), np.concatenate([CARS, GHOST]) if lies else CARS
    done = [
        gathered.together(0.5 * time, [report(AGENTS[0], CARS), report(AGENTS[1], CARS), report(AGENTS[2], said)])
        for time in range(6)
    ]
    return [one for one in done if one is not None]


def test_who_reports_what_two_others_deny_contradicts_both() -> None:
    [*_, lied] = rounds(lies=True)
    pairs = contradictions(lied)
    assert {(one, other) for one, other, _ in pairs} == {(0, 2), (1, 2)}
    assert all(what.startswith("objects ") for _, _, what in pairs)
    [*_, honest] = rounds(lies=False)
    assert not contradictions(honest)


def test_a_picture_shows_who_is_believed_and_who_is_not() -> None:
    counts = []
    for lies in (False, True):
        [*_, last] = rounds(lies)
        pixels = np.asarray(Image.open(io.BytesIO(fused_picture(last))).convert("RGB"))[:, :740]
        counts.append([int((pixels == np.array(color)).all(axis=-1).sum()) for color in (TRUSTED, DISTRUSTED)])
    (honest, none), (trusted, distrusted) = counts
    assert honest > 300
    assert none == 0
    assert trusted > 200
    assert distrusted > 100  # its disc, its objects, and two lines


def test_a_strip_shows_how_trust_went() -> None:
    """Three agents are trusted at first; at the end one is not, below its map as in it."""
    first, *_, last = rounds(lies=True)
    honest, *_ = rounds(lies=False)
    strip = np.asarray(Image.open(io.BytesIO(fused_strip([honest, last]))).convert("RGB"))
    half = strip.shape[1] // 2
    below = strip[STRIP_SIDE + 50 :]
    squares = (below == np.array(TRUSTED)).all(axis=-1)
    assert (squares[:, :half].sum() / 144, squares[:, half:].sum() / 144) == (3, 2)
    one = np.asarray(Image.open(io.BytesIO(fused_strip([first]))))
    assert one.shape[1] == half + 10


def test_surfaces_that_another_agent_claims_free_are_where_they_stand() -> None:
    sees, denies = report(AGENTS[0], CARS), report(AGENTS[1], CARS, standing=CARS[:0])
    places = claimed_free(denies, sees)
    assert len(places) > 3
    assert np.linalg.norm(places[:, None] - CARS[None, :, :2], axis=2).min(axis=1).max() < 3.0
    assert not len(claimed_free(sees, denies))


def test_a_picture_has_outlines_of_views_and_dots_where_they_contradict_each_other() -> None:
    said = [report(AGENTS[0], CARS), report(AGENTS[1], CARS, standing=CARS[:0])]
    done = Rounds().together(0.0, said)
    verdicts = replace(done.picture.verdicts, against=np.full((2, 2), 2.0 * CONTRADICTION_NATS))
    contradicting = replace(done, picture=replace(done.picture, verdicts=verdicts))
    seen, dotted = (np.asarray(Image.open(io.BytesIO(fused_picture(one))))[50:] for one in (done, contradicting))
    for number in range(2):
        assert (seen[:, :740] == np.array(agent_color(number, 2))).all(axis=-1).sum() > 500
    red, dots = ((each[:, :740] == np.array(DISTRUSTED)).all(axis=-1).sum() for each in (seen, dotted))
    assert (red, dots > 50) == (0, True)


def test_a_page_holds_each_time_and_the_trust_in_each_agent() -> None:
    done = rounds(lies=True)
    page = fused_page(done, [b"picture"] * len(done), "three <agents>").decode()
    assert page.count("cGljdHVyZQ==") == len(done)
    assert page.count("<polyline") == 3
    assert "three &lt;agents&gt;" in page
    points = page.split('<polyline points="')[3].split('"')[0].split()
    heights = [float(point.split(",")[1]) for point in points]
    assert heights[-1] > heights[0]  # the trust in the liar falls: down the page
