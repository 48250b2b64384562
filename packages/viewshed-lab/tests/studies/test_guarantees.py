"""The study of guarantees: attacks obey their threat and break a wrong certificate; a tiny study writes a page."""

from pathlib import Path

import numpy as np
import pytest
from tests.cli.commands import run

from viewshed.fov.estimate import FovEstimate
from viewshed.fov.visibility import TARGETS
from viewshed.geometry import Rigid
from viewshed.guarantees.envelope import Envelope, Threat
from viewshed.io import read_sweep
from viewshed.io.samples import junction_path
from viewshed.preprocess.leveling import level
from viewshed.recordings.read.source import ObjectBox
from viewshed.sweep import Sweep
from viewshed_lab.sim.assets.shapes import Box
from viewshed_lab.sim.lidar.weather import Conditions
from viewshed_lab.sim.world import Thing
from viewshed_lab.studies.guarantees import attacks, driving, jobs, scenes
from viewshed_lab.studies.guarantees.attacks import Tally, Victim


def toy() -> Victim:
    return attacks.toy_victim(np.random.default_rng(3))


@pytest.mark.parametrize("how", attacks.HOW)
@pytest.mark.parametrize("words", attacks.TRIED_TOY)
def test_no_attack_breaks_a_certificate(words: str, how: str) -> None:
    tally = Tally()
    attacks.try_attacks(toy(), words, how, 25, np.random.default_rng(1), tally)
    assert (tally.tried, tally.violations) == (25, 0)


def test_attacks_open_what_a_wrong_bound_denies() -> None:
    # By its envelope nothing is claimed without an attack, and its bound counts on that: an attack shows it wrong.
    victim, tally = toy(), Tally()
    own = victim.envelope
    none = np.zeros_like(own.margins)
    wrong = Envelope(own.grid, own.target, own.sent, own.nearest_m, none, none > 0)
    victim.envelope = wrong
    attacks.try_attacks(victim, "dropped:5", "gradient", 60, np.random.default_rng(1), tally)
    assert tally.violations > 0


@pytest.mark.parametrize("words", attacks.TRIED_TOY)
def test_attacks_obey_their_threat(words: str) -> None:
    victim, threat, rng = toy(), Threat.parse(words), np.random.default_rng(2)
    for weight in (None, rng.random((4, 24))):
        beams = attacks.beams_within(threat, victim, rng, weight)
        if threat.kind == "wedge":
            assert len(np.unique(beams % 24)) == threat.amount / 360 * 24
        elif threat.kind == "window":  # no window of this grid is wider than 8 of 24 columns
            for first in range(24):
                assert np.isin(beams % 24, (first + np.arange(8)) % 24).sum() <= threat.amount
        else:
            assert len(beams) == threat.amount


def test_who_vanishes_leaves_no_return() -> None:
    place = driving.Junction(1, Conditions())
    x_m, ahead_m = place.start_m[0] - 10.0, place.car[1]
    sweep = place.sweep(0, x_m, 3.0, place.lane_m, walks=True)

    def returns_of(one: Sweep) -> int:
        near = np.hypot(one.points[:, 0] - 10.0 + ahead_m, one.points[:, 1]) < 0.7
        return int((near & (one.points[:, 2] > -1.6)).sum())

    attack = driving.ATTACKS["vanished"](0.0)
    assert returns_of(sweep) > 10
    assert returns_of(attack.apply(sweep, np.random.default_rng(0)).sweep) == 0


def test_a_stronger_threat_allows_no_higher_speed() -> None:
    speeds = driving.certified_speeds(0)
    for kind in ("window", "replaced", "wedge"):
        found = [speed for name, speed in speeds.items() if name in ("the whole claim", "added") or kind in name]
        assert found == sorted(found, reverse=True)
    assert speeds["the whole claim"] >= 5.0
    assert speeds["wedge:30"] == 0.0


def test_who_walks_fills_a_part_of_a_box_and_a_box_all_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    assert 0.15 < driving.filled_share(0) < 0.6
    monkeypatch.setattr(driving, "person", lambda *_, **__: Thing("box", (Box(0.0, 0.0, 0.6, 0.6, 1.7),)))
    assert 0.8 < driving.filled_share(0) < 1.2


def test_without_an_alarm_three_monitors_drive_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driving, "LAST_S", 2.0)
    seen: list[list[tuple[float, float, bytes]]] = []

    def keep(time_s: float, speed_mps: float, _: tuple[float, float], view: FovEstimate) -> None:
        seen[-1].append((time_s, speed_mps, view.state.tobytes()))

    for monitor in ("ours", "no monitor", "ours + certificate"):
        seen.append([])
        driving.drive_through(0, "none", monitor, keep)
    assert len(seen[0]) == 10
    assert seen[0] == seen[1] == seen[2]


@pytest.mark.parametrize(("alarm_s", "driven"), [(0.0, {"ours", "published detector", "certified only"}), (0.2, None)])
def test_what_is_known_is_not_driven_again(
    monkeypatch: pytest.MonkeyPatch, alarm_s: float, driven: set[str] | None
) -> None:
    called: list[str] = []

    def drive(number: int, case: str, monitor: str) -> driving.Drive:
        called.append(monitor)
        return driving.Drive(False, 20.0 if monitor == "ours" else 21.0, 0.0, alarm_s)

    monkeypatch.setattr(driving, "drive_through", drive)
    found = dict(driving.drives_left(0, "none", {}))
    assert set(found) == set(driving.MONITORS)
    assert sorted(called) == sorted(driven or driving.MONITORS)
    assert found["ours + certificate"].time_s == (20.0 if driven else 21.0)
    called.clear()
    left = dict(driving.drives_left(0, "none", {"ours": found["ours"], "certified only": found["certified only"]}))
    assert set(left) == {"no monitor", "published detector", "ours + certificate"}
    assert "ours" not in called
    assert not dict(driving.drives_left(0, "none", found))


def test_behind_a_box_is_what_it_hides_whole() -> None:
    sweep = read_sweep(junction_path(), sensor="hdl32e", sensor_height_m=1.84, attitude=[1, 0, 0, 0])
    leveled, flat = level(sweep, scenes.GRID), np.zeros(scenes.GRID.shape, np.float32)

    def hides(height_m: float, *xy: tuple[float, float]) -> list[bool]:
        # Without a pose a box is in the sensor's frame; this one stands on the ground, 6 m wide, 10 to 12 m ahead.
        box = ObjectBox(Rigid.from_yaw(0.0, (11.0, 0.0, height_m / 2 - 1.84)), (2.0, 6.0, height_m), "truck")
        behind = scenes.behind_boxes(leveled, [box], flat, TARGETS["car"])
        return [bool(behind[tuple(scenes.GRID.index(np.array(one))[0])]) for one in xy]

    # Right behind it, far behind, half beside it, before it, at its side, and behind the sensor.
    places = (14.0, 0.0), (40.0, 8.0), (20.0, 5.5), (8.0, 0.0), (11.0, 5.0), (-20.0, 0.0)
    assert hides(3.0, *places) == [True, True, False, False, False, False]
    # Over 1.7 m the sensor looks down: the line that touches the top's end at 12 m is 1.5 m high at 29 m.
    assert hides(1.7, (16.0, 0.0), (27.0, 0.0), (32.0, 0.0)) == [True, True, False]
    assert hides(1.0, *places) == [False] * 6


def test_a_line_that_was_cut_short_is_made_again(tmp_path: Path) -> None:
    jobs._add(tmp_path, "costs", 0, {"a": {}})
    with (tmp_path / "costs.jsonl").open("a") as file:
        file.write('{"number": 1, "a": {}')
    assert list(jobs._left(tmp_path, "costs", 2, lambda _: None)) == [1]
    jobs._add(tmp_path, "costs", 1, {"a": {}})
    assert jobs.lines_of(tmp_path, "costs") == [{"number": number, "a": {}} for number in (0, 1)]


def test_results_of_other_sizes_are_refused(tmp_path: Path) -> None:
    jobs.check_sizes(tmp_path / "one", jobs.SIZES["tiny"])
    with pytest.raises(ValueError, match=r"one must hold .* got another plan \(certificates 2 there, 65 now, .*--out"):
        jobs.run_study(tmp_path / "one", jobs.SIZES["full"], print)
    # Lines of a version that wrote no sizes.
    (tmp_path / "old").mkdir()
    jobs._add(tmp_path / "old", "costs", 0, {})
    with pytest.raises(
        ValueError, match=r"old must hold .* got those of an unknown plan; give another --out or delete"
    ):
        jobs.run_study(tmp_path / "old", jobs.SIZES["full"], print)


@pytest.mark.slow
def test_a_tiny_study(tmp_path: Path) -> None:
    words = ("study", "guarantees", "--preset", "tiny", "--out", tmp_path, "--ship", tmp_path / "conformal.json")
    assert run(*words).returncode == 0
    page = (tmp_path / "guarantees.md").read_text(encoding="utf-8")
    assert "| all |" in page
    done = jobs.lines_of(tmp_path, "attacks")
    assert run(*words).returncode == 0
    assert jobs.lines_of(tmp_path, "attacks") == done  # nothing is done twice
    other = run("study", "guarantees", "--preset", "full", "--no-run", "--out", tmp_path)
    assert (other.returncode, other.stderr.count("\n")) == (2, 1)
