"""The published trust, value by value on scenes made by hand."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from viewshed_lab.studies.agents.mate import (
    MateReport,
    MateTrust,
    forget,
    gains,
    mean_of,
    miss_weight,
    prior,
    pseudo_measurements,
)
from viewshed_lab.studies.agents.published import PublishedTrust


def test_a_pseudo_measurement_moves_trust_by_the_published_formula() -> None:
    """Agent, bias 4: n = 1 from .4 on; below it n = 4, so 4/5 of c·v and 16/5 of c·(1 - v)."""
    value, confidence = np.array([1.0, 0.4, 0.25, 0.0]), np.array([1.0, 0.5, 0.5, 0.1])
    assert gains(value, confidence, 4.0, 0.4) == pytest.approx(
        np.array([[0.5, 0.0], [0.1, 0.15], [0.8 * 0.5 * 0.25, 3.2 * 0.5 * 0.75], [0.0, 0.32]])
    )
    # A track has no bias: n = 1 whatever the value is.
    assert gains(value, confidence, 1.0, 0.4) == pytest.approx(
        0.5 * confidence[:, None] * np.stack([value, 1 - value], 1)
    )


@pytest.mark.parametrize(
    ("bias", "threshold", "below", "expected"), [(6, 0.3, 0.2, 36 / 7), (8, 0.2, 0.1, 64 / 9), (3, 0.4, 0.3, 9 / 4)]
)
def test_the_other_published_biases(bias: float, threshold: float, below: float, expected: float) -> None:
    """Below the threshold β moves by n² / (n + 1) of c · (1 - v), at the threshold by one half of it."""
    moved = gains(np.array([below, threshold]), np.ones(2), bias, threshold)[:, 1]
    assert moved == pytest.approx([expected * (1 - below), 0.5 * (1 - threshold)])
    trust = MateTrust(agent_bias=bias, agent_threshold=threshold, track_prior="trusted")
    trust.update(0.0, [], IDS, AT, NINE)
    trust.update(0.1, reports(denies=True), IDS, AT, NINE)
    # The track keeps 99 % of its .8 and has σ = .282: v = .203 of a miss is under .3 and .4, not under .2.
    ratio = expected if threshold > 0.203 else 0.5
    v, c = 0.8 * 0.99 + 0.005, 1 - 2 * np.sqrt(0.797 * 0.203 / 2)
    assert trust.agents["car1"][1] == pytest.approx(0.5 + 0.5 * c * (1 - v) + ratio * 0.25 * c * v, rel=1e-3)


@pytest.mark.parametrize(("name", "mean"), [("distrusted", 0.2), ("untrusted", 0.5), ("trusted", 0.8)])
def test_priors_have_the_published_means_and_a_strength_of_one(name: str, mean: float) -> None:
    assert prior(name).tolist() == [mean, pytest.approx(1 - mean)]
    trust = MateTrust(agent_prior=name, track_prior=name)
    assert trust.of_agent("nobody") == pytest.approx(mean)
    assert trust.of_tracks(np.array([99])) == pytest.approx(mean)
    trust.update(0.0, [MateReport("car", np.zeros(2), np.zeros((0, 2)), np.zeros(2, np.bool_))], IDS, AT, NINE)
    assert trust.agents["car"] == pytest.approx(np.array([mean, 1 - mean]))
    assert trust.tracks[3] == pytest.approx(np.array([mean, 1 - mean]))


def test_trust_returns_to_one_half_in_ten_seconds_or_in_one() -> None:
    """Of Beta(8.5, 0.5): a quarter of the way after 2.5 s of 10, and no farther than there after 25 s."""
    beta = np.array([8.5, 0.5])
    assert forget(beta, 2.5).tolist() == [6.5, 0.5]
    assert forget(beta, 0.25, return_s=1.0).tolist() == [6.5, 0.5]
    assert forget(beta, 25.0).tolist() == forget(beta, 1.0, return_s=1.0).tolist() == [0.5, 0.5]
    trust = MateTrust(return_s=1.0, agents={"car": beta}, tracks={3: beta})
    for t_s in (0.0, 0.25):
        trust.update(t_s, [], IDS, AT, NINE)
    assert trust.agents["car"].tolist() == trust.tracks[3].tolist() == [6.5, 0.5]


@pytest.mark.parametrize(
    ("distance_m", "frames", "updates", "expected"),
    [
        (10, 2, 9, 0.25), (29.9, 3, 9, 1.0),  # near: after two frames it counts
        (30, 3, 9, 0.0), (45, 5, 9, 2 / 3), (45, 60, 9, 1.0),  # farther: slowly
        (65, 4, 9, 1 / 6),  # far: half of that
        (10, 9, 1, 0.0), (10, 9, 2, 1.0),  # a young track counts for nothing
    ],
)  # fmt: skip
def test_weight_of_what_is_not_seen(distance_m: float, frames: float, updates: float, expected: float) -> None:
    found = miss_weight(np.array([distance_m]), np.array([frames]), np.array([updates]))
    assert found.tolist() == pytest.approx([expected])


TRUSTED = np.array([19.0, 1.0])  # mean .95, standard deviation sqrt(19 / 8400)
SURENESS = 1 - 2 * np.sqrt(19 / 8400)


def test_each_case_of_the_table() -> None:
    """Matched, the agent itself within 1 m, missed at 69.9 m, out of view, in view beyond 70 m, missed at 1.01 m.

    The agent has a track of itself as well: that confirms nothing.
    """
    xy_m = np.array([[20.0, 0.0], [0.6, 0.78], [0.0, 69.9], [-20.0, 0.0], [70.1, 0.0], [0.0, -1.01]])
    report = MateReport(
        "car", np.zeros(2), np.array([[21.0, 2.0], [8.0, 8.0], [0.6, 0.78]]), np.array([1, 1, 1, 0, 1, 1], np.bool_)
    )
    frames = np.array([9, 9, 4, 0, 9, 9], np.int32)
    said = pseudo_measurements(
        report, np.array([3.0, 1.0]), xy_m, np.full(6, 9, np.int32), np.tile(TRUSTED, (6, 1)), frames
    )
    nan = np.nan
    sixth = 1 / 6  # a third of the frames, and half for the distance
    assert said.agent_value == pytest.approx([0.95, nan, 0.05, nan, nan, 0.05], nan_ok=True)
    assert said.agent_confidence == pytest.approx([SURENESS, nan, sixth * SURENESS, nan, nan, SURENESS], nan_ok=True)
    assert said.track_value == pytest.approx([1.0, 1.0, 0.0, nan, nan, 0.0], nan_ok=True)
    assert said.track_confidence == pytest.approx([0.75, 1.0, sixth * 0.75, nan, nan, 0.75], nan_ok=True)


def test_confidences_of_agents_are_clipped() -> None:
    """Tracks whose σ is nothing: a match counts .9999, and a miss that weighs nothing 1e-4; the track gets 0 of it."""
    xy_m = np.array([[20.0, 0.0], [0.0, 50.0]])
    report = MateReport("car", np.zeros(2), xy_m[:1], np.ones(2, np.bool_))
    sure = np.tile([9e11, 1e11], (2, 1))
    said = pseudo_measurements(
        report, np.array([3.0, 1.0]), xy_m, np.full(2, 9, np.int32), sure, np.array([9, 3], np.int32)
    )
    assert said.agent_confidence.tolist() == [0.9999, 1e-4]
    assert said.track_confidence.tolist() == [0.75, 0.0]


@pytest.mark.parametrize(
    ("gate_m", "off_m", "is_matched"), [(3.0, 2.9, True), (2.0, 1.9, True), (2.0, 2.1, False), (1.0, 1.1, False)]
)
def test_the_published_gates(gate_m: float, off_m: float, is_matched: bool) -> None:
    """An agent's own track lies so far from the first of the center, which is in its view; the second is not."""
    trust = MateTrust(gate_m=gate_m)
    own = AT[:1] + np.array([0.0, off_m])
    trust.update(0.0, [MateReport("car", np.zeros(2), own, np.array([True, False]))], IDS, AT, NINE)
    c = 1 - np.sqrt(0.5)
    assert trust.agents["car"][0] == pytest.approx(0.5 + 0.25 * c * (1.0 if is_matched else 0.25))


def test_assignment_is_global_and_gated() -> None:
    """Tracks at 0 and 2, own ones at 1.1 and 3: what is nearest to the second track is given to the first."""
    xy_m, nobody = np.array([[20.0, 0.0], [20.0, 2.0]]), np.zeros((0, 2))
    for own, expected in (
        (np.array([[20.0, 1.1], [20.0, 3.0]]), [0.5, 0.5]),
        (np.array([[20.0, 3.0]]), [np.nan, 0.5]),  # 3 m is no longer within the gate
        (nobody, [np.nan, np.nan]),
    ):
        report = MateReport("car", np.zeros(2), own, np.zeros(2, np.bool_))
        said = pseudo_measurements(
            report, np.ones(2), xy_m, np.full(2, 9, np.int32), np.full((2, 2), 0.5), np.zeros(2, np.int32)
        )
        assert said.agent_value == pytest.approx(expected, nan_ok=True)


def scene(agreed: int, denied: int, track_mean: float = 0.9) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Tracks of the center around an agent within 25 m, so sure that σ is nothing; the agent does not see the last."""
    count = agreed + denied
    turns = np.arange(count) * (2 * np.pi / count)
    xy_m = 25.0 * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    betas = np.tile(np.array([track_mean, 1 - track_mean]) * 1e9, (count, 1))
    return xy_m, xy_m[:agreed], betas


@pytest.mark.parametrize(("agreed", "denied", "expected"), [(20, 1, 0.70), (5, 1, 0.43), (5, 2, 0.29)])
def test_the_bias_convicts_the_innocent(agreed: int, denied: int, expected: float) -> None:
    """An honest agent that disagrees in 1 of 21, 1 of 6, 2 of 7 measurements, for as long as it is heard.

    With tracks of trust .9: agreeing adds .45 and .05 to α and β, disagreeing .08 and 2.88. The priors fade: in 1 of 6
    trust is (5 · .45 + .08) / (5 · .5 + 2.96) = .427.
    """
    xy_m, seen, betas = scene(agreed, denied)
    trust = np.array([0.5, 0.5])
    report = MateReport("car", np.zeros(2), seen, np.ones(agreed + denied, np.bool_))
    frames = updates = np.full(agreed + denied, 99, np.int32)
    for _ in range(300):
        said = pseudo_measurements(report, trust, xy_m, updates, betas, frames)
        trust = trust + np.nansum(gains(said.agent_value, said.agent_confidence, 4.0, 0.4), axis=0)
    assert float(mean_of(trust)) == pytest.approx(expected, abs=0.005)
    by_hand = (0.45 * agreed + 0.08 * denied) / (0.5 * agreed + 2.96 * denied)
    assert float(mean_of(trust)) == pytest.approx(by_hand, abs=2e-3)


IDS, AT, NINE = np.array([3, 8]), np.array([[20.0, 0.0], [0.0, 20.0]]), np.full(2, 9, np.int32)


def reports(*, denies: bool = False, agents: int = 2) -> list[MateReport]:
    """Agents that see both tracks; the last may deny the second one though its view covers it."""
    seen = [AT] * (agents - 1) + [AT[:1] if denies else AT]
    return [MateReport(f"car{k}", np.array([3.0 * k, -4.0]), seen[k], np.ones(2, np.bool_)) for k in range(agents)]


def test_a_round_by_hand() -> None:
    """Two agents and two tracks, all untrusted: E = .5 and σ = sqrt(1/8), so that c = 1 - sqrt(1/2)."""
    trust = MateTrust()
    trust.update(0.0, reports(denies=True), IDS, AT, NINE)
    c = 1 - np.sqrt(0.5)
    # Both values are .5, no contradiction yet: car0 gets two matches of c; car1 one, and one miss of a quarter of c,
    # for the track is in its view for the first time.
    assert trust.agents["car0"] == pytest.approx(np.array([0.5 + 0.5 * c, 0.5 + 0.5 * c]))
    assert trust.agents["car1"] == pytest.approx(np.array([0.5 + 0.25 * 1.25 * c, 0.5 + 0.25 * 1.25 * c]))
    # Tracks get v = 1 with c = .5 from who sees them, v = 0 with c = .25 · .5 from who does not.
    assert trust.tracks[3] == pytest.approx(np.array([0.5 + 2 * 0.25, 0.5]))
    assert trust.tracks[8] == pytest.approx(np.array([0.5 + 0.25, 0.5 + 0.5 * 0.125]))
    assert trust.of_tracks(np.array([3, 8, 99])).tolist() == pytest.approx([1 / 1.5, 0.75 / 1.3125, 0.5])
    # A second later the first thing is to forget a tenth.
    before = trust.tracks[3]
    trust.update(1.0, [], IDS, AT, NINE)
    assert trust.tracks[3] == pytest.approx(0.9 * before + 0.05)


def test_a_track_needs_two_measurements_in_a_round() -> None:
    trust = MateTrust()
    trust.update(0.0, reports(agents=1), IDS, AT, NINE)
    assert trust.tracks[3].tolist() == [0.5, 0.5]
    assert trust.agents["car0"].sum() > 1.0  # agents need no more than one
    trust.update(0.1, reports(agents=2), IDS, AT, NINE)
    assert trust.tracks[3][0] > 0.7


def test_tracks_that_end_are_forgotten_and_new_ones_begin_untrusted() -> None:
    trust = MateTrust()
    trust.update(0.0, reports(), IDS, AT, NINE)
    trust.update(0.1, reports(), np.array([8, 12]), AT, NINE)
    assert set(trust.tracks) == {8, 12}
    assert trust.of_agent("nobody") == 0.5
    assert trust.of_tracks(np.array([99])).tolist() == [0.5]


def test_wrong_priors_and_rounds_are_refused() -> None:
    with pytest.raises(ValueError, match="prior must be one of distrusted, untrusted, trusted, got 'friend'"):
        MateTrust(agent_prior="friend").of_agent("car")
    trust = MateTrust()
    trust.update(1.0, reports(), IDS, AT, NINE)
    with pytest.raises(ValueError, match=r"must not decrease, got 0\.5 after 1\.0"):
        trust.update(0.5, reports(), IDS, AT, NINE)
    with pytest.raises(ValueError, match="one value for each of 1 tracks"):
        trust.update(2.0, reports(), IDS[:1], AT[:1], NINE[:1])


def test_tracks_below_the_published_trust_are_dropped() -> None:
    """Below .40, in the air below .5."""
    kept = {k: np.array([mean, 1 - mean]) for k, mean in enumerate((0.39, 0.40, 0.51))}
    tracks = SimpleNamespace(
        ids=np.arange(3), boxes=np.zeros((3, 7)), detection=np.zeros(3, np.int32), confirmed=np.ones(3, np.bool_)
    )
    picture: Any = SimpleNamespace(t_s=0.0, agents=("car",), tracks=tracks)
    on_ground, in_air = PublishedTrust(_mate=MateTrust(tracks=kept)), PublishedTrust(0.5, MateTrust(tracks=kept))
    assert on_ground.add(picture, [])[1].tolist() == [False, True, True]
    assert in_air.add(picture, [])[1].tolist() == [False, False, True]
