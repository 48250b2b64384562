"""What a sensor stores, against the formulas of the page on measurement and plain Monte Carlo."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from tests.sim.oracle import firing

from viewshed.geometry import Rigid
from viewshed.sensors import LidarModel, lidar_model
from viewshed_lab.sim.assets.shapes import material_index
from viewshed_lab.sim.lidar.measurement import BLOCK_COLUMNS, measure
from viewshed_lab.sim.lidar.optics import OPTICS, Optics, optics_of, step_of
from viewshed_lab.sim.lidar.stored_sweep import StoredSweep
from viewshed_lab.sim.lidar.weather import CONDITIONS, Conditions, conditions_named
from viewshed_lab.sim.raycast.scan import STILL, ExactScan

CLEAR = Conditions(mixed_share=0.0)
PERFECT = lidar_model("carla256")


def scan_of(
    model: LidarModel, depth_m: object, material: str = "asphalt", cosine: float = 1.0, thing: int = 0
) -> ExactScan:
    """A scan with every beam at the given depths; its arrays are read-only."""
    shape = (model.azimuth_columns, model.rings)
    pose = Rigid.from_yaw(0.4, (3.0, -2.0, 1.9))
    origin, direction, time_s = firing(model, STILL, pose)
    arrays = (
        np.broadcast_to(np.asarray(depth_m, np.float32), shape).copy(),
        np.full(shape, thing, np.int32),
        np.full(shape, material_index(material), np.uint8),
        np.full(shape, cosine, np.float32),
    )
    for array in arrays:
        array.setflags(write=False)
    return ExactScan(model, pose, STILL, time_s, origin, direction, *arrays)


def measured(scan: ExactScan, conditions: Conditions = CLEAR, seed: int = 0) -> StoredSweep:
    return measure(scan, conditions, np.random.Generator(np.random.PCG64(seed)))


def share(scan: ExactScan, conditions: Conditions = CLEAR) -> float:
    return float(np.mean(measured(scan, conditions).steps > 0))


def range_m(image: StoredSweep) -> NDArray[np.float64]:
    return np.asarray(image.steps[image.steps > 0] * image.step_m, np.float64)


def test_perfect_sensor_stores_depth_to_half_a_step() -> None:
    depth = np.linspace(0.5, 49.0, PERFECT.azimuth_columns)[:, None] + 0.001 * np.arange(PERFECT.rings)
    image = measured(scan_of(PERFECT, depth))
    assert np.abs(image.steps * 0.002 - depth).max() < 0.00101
    assert image.step_m == 0.002


def test_noise_of_strong_returns_is_that_of_the_sensor() -> None:
    found = range_m(measured(scan_of(lidar_model("hdl64e"), 5.0)))
    assert found.mean() == pytest.approx(5.0, abs=0.001)
    assert found.std() == pytest.approx(OPTICS["HDL-64E"].sigma_m, rel=0.05)
    tail = np.mean(np.abs(found - 5.0) > 0.019)
    assert tail == pytest.approx(0.0574, abs=0.01)  # normal: 5.74 % beyond 1.9 standard deviations


@pytest.mark.parametrize(("signal", "probability"), [(0.5, 1 / 17), (1.0, 0.5), (2.0, 16 / 17)])
def test_weak_returns_are_detected_as_the_curve_says(signal: float, probability: float) -> None:
    model = replace(lidar_model("hdl64e"), max_range_m=250.0)
    optics = OPTICS["HDL-64E"]
    at_m = optics.reach_m * (1.2 / signal) ** 0.5
    assert share(scan_of(model, at_m)) == pytest.approx(probability * (1 - optics.missing_share), abs=0.01)


def test_light_lost_in_air_counts_both_ways() -> None:
    model = lidar_model("hdl64e")
    fog = replace(CLEAR, extinction_per_m=0.02)
    at_m = 40.0
    signal = 1.2 * (OPTICS["HDL-64E"].reach_m / at_m) ** 2 * np.exp(-2 * 0.02 * at_m)
    expected = signal**4 / (1 + signal**4) * (1 - OPTICS["HDL-64E"].missing_share)
    assert share(scan_of(model, at_m), fog) == pytest.approx(expected, abs=0.01)


def test_oblique_surfaces_return_less_and_wet_ground_less_still() -> None:
    model = lidar_model("hdl32e")
    facing, oblique = (share(scan_of(model, 60.0, cosine=c)) for c in (1.0, 0.05))
    dry, wet = (share(scan_of(model, 35.0, cosine=0.05, thing=-1), replace(CLEAR, wet=w)) for w in (1.0, 0.4))
    other = share(scan_of(model, 35.0, cosine=0.05, thing=0), replace(CLEAR, wet=0.4))
    assert facing > 0.9
    assert oblique < 0.3
    assert other == dry > wet + 0.3


@pytest.mark.parametrize("material", ["glass", "absorber"])
def test_what_reflects_nothing_returns_nothing(material: str) -> None:
    assert measured(scan_of(lidar_model("hdl32e"), 3.0, material)).steps.max() == 0
    assert measured(scan_of(PERFECT, 3.0, material)).steps.max() == 0


def test_a_window_returns_where_it_faces_the_sensor_and_its_dust_near_by() -> None:
    """At 60 m a window has s = 8.12 · (80 / 60)² facing, and 0.12 · (80 / 60)² from 0.2 rad on, without the glint."""
    model, far = lidar_model("hdl32e"), 60.0
    turned = float(np.cos(0.2))
    assert share(scan_of(model, far, "window")) > 0.97
    assert share(scan_of(model, far, "window", turned)) < 0.01
    assert share(scan_of(model, 5.0, "window", turned)) > 0.97
    half = measured(scan_of(model, 8.0, "window", float(np.cos(0.05)))).intensity  # e⁻¹ of 80 %, and dust
    assert float(np.median(half[half > 0])) == pytest.approx(100 * (0.8 / np.e + 0.012), abs=2)


def test_nothing_nearer_than_the_minimum_or_beyond_the_maximum_range() -> None:
    model = replace(lidar_model("hdl32e"), min_range_m=1.0, max_range_m=60.0, reach_m=60.0)
    for depth, limits in ((1.0, (1.0, 1.2)), (59.999, (59.8, 60.0))):
        found = range_m(measured(scan_of(model, depth, "sign")))
        assert limits[0] - 0.0011 <= found.min() <= found.max() <= limits[1] + 0.0011
    assert share(scan_of(model, 0.5)) == 0
    assert share(scan_of(model, np.inf)) == 0


def test_intensity_follows_reflectivity_and_signs_shine() -> None:
    model = lidar_model("hdl32e")
    levels = {name: measured(scan_of(model, 8.0, name)).intensity for name in ("asphalt", "plaster", "sign")}
    medians = {name: float(np.median(level[level > 0])) for name, level in levels.items()}
    assert medians["asphalt"] == pytest.approx(12, abs=1)
    assert medians["plaster"] == pytest.approx(55, abs=2)
    assert medians["sign"] > 150
    image = measured(scan_of(model, 70.0))
    assert ((image.intensity > 0) == (image.steps > 0)).all()


def test_edges_mix_two_depths_only_where_they_are_close() -> None:
    depth = np.full((PERFECT.azimuth_columns, 1), 10.0)
    depth[100:200], depth[200:] = 11.0, 30.0
    image = measured(scan_of(PERFECT, depth), replace(CLEAR, mixed_share=1.0))
    between = np.argwhere(np.abs(image.steps * 0.002 - depth) > 0.01)
    assert set(between[:, 0]) == {99}
    assert 0.3 < np.mean(image.steps[99] * 0.002 - 10.0) < 0.7
    assert (np.abs(measured(scan_of(PERFECT, depth)).steps * 0.002 - depth) < 0.002).all()


def test_particles_lie_before_the_surface_where_chance_puts_them() -> None:
    model = replace(lidar_model("hdl32e"), min_range_m=0.01)
    snow = replace(CLEAR, particles_per_m=0.2, particle_reach=0.1, noise=0.0)
    found = range_m(measured(scan_of(model, np.inf), snow))
    first = _first_particles(0.2, 0.1 * OPTICS["HDL-32E"].reach_m, 20_000)
    met = np.isfinite(first)
    assert len(found) / (1084 * 32) == pytest.approx(met.mean() * (1 - OPTICS["HDL-32E"].missing_share), abs=0.015)
    wanted = np.quantile(first[met], (0.1, 0.5, 0.9))
    assert np.quantile(found, (0.1, 0.5, 0.9)) == pytest.approx(wanted, rel=0.06, abs=0.03)


def _first_particles(per_m: float, reach_m: float, beams: int) -> NDArray[np.float64]:
    """Ranges (beams,) of the first detected particle by plain Monte Carlo, 50 m of clear air; +inf for none."""
    rng = np.random.default_rng(5)
    first = np.full(beams, np.inf)
    for beam, count in enumerate(rng.poisson(per_m * 50.0, beams)):
        at, size = rng.random(count) * 50.0, rng.exponential(size=count)
        seen = at[size * (reach_m / at) ** 2 > 1.0]
        first[beam] = seen.min(initial=np.inf)
    return first


def test_faults_are_whole_rings_sectors_and_packets() -> None:
    model = lidar_model("vlp16")
    scan = scan_of(PERFECT, 5.0)
    rings = measured(scan, replace(CLEAR, dead_ring_share=0.2)).steps > 0
    assert (rings.all(axis=0) | ~rings.any(axis=0)).all()
    assert 0.1 < np.mean(~rings.any(axis=0)) < 0.3
    sector = (measured(scan, replace(CLEAR, dead_sector_share=1.0, dead_sector_deg=40.0)).steps > 0).all(axis=1)
    assert np.sum(sector != np.roll(sector, 1)) == 2
    assert np.mean(~sector) == pytest.approx(40 / 360, abs=0.005)
    columns = (measured(scan_of(model, 5.0), replace(CLEAR, lost_block_share=0.1)).steps > 0).any(axis=1)
    blocks = columns.reshape(-1, BLOCK_COLUMNS)
    assert (blocks.all(axis=1) | ~blocks.any(axis=1)).all()
    assert 0.03 < np.mean(~columns) < 0.2


@settings(max_examples=15)
@given(st.sampled_from(sorted(CONDITIONS)), st.integers(0, 2**40), st.integers(0, 1083), st.integers(0, 31))
def test_same_seed_same_image_and_a_beam_does_not_disturb_the_others(name: str, seed: int, c: int, r: int) -> None:
    model = lidar_model("hdl32e")
    depth = np.full((1084, 32), 21.0)
    conditions = replace(CONDITIONS[name], mixed_share=0.0)
    before = measured(scan_of(model, depth), conditions, seed)
    again = measured(scan_of(model, depth), conditions, seed)
    assert (before.steps == again.steps).all()
    assert (before.intensity == again.intensity).all()
    assert (before.steps != measured(scan_of(model, depth), conditions, seed + 1).steps).any()
    depth[c, r] = 14.0
    changed = np.argwhere(before.steps != measured(scan_of(model, depth), conditions, seed).steps)
    assert changed.tolist() in ([], [[c, r]])


def test_crosstalk_is_heard_where_it_comes_first_and_by_no_dead_beam() -> None:
    model = lidar_model("hdl32e")
    talk = replace(CLEAR, crosstalk_share=0.05, noise=0.0, mixed_share=0.0)
    far, none = (measured(scan_of(model, depth, "plaster"), talk) for depth in (20.0, np.inf))
    expected = 0.05 * (20.0 - model.min_range_m) / (model.max_range_m - model.min_range_m)
    heard = (far.steps > 0) & (far.steps * far.step_m < 19.9)
    assert heard.mean() == pytest.approx(expected, rel=0.1)
    assert (none.steps > 0).mean() == pytest.approx(0.05, rel=0.05)
    assert (none.intensity[none.steps > 0] > 0).all()
    dead = replace(talk, dead_ring_share=0.3, lost_block_share=0.2)
    alive = measured(scan_of(model, 20.0, "plaster"), replace(dead, crosstalk_share=0.0)).steps > 0
    with_talk = measured(scan_of(model, 20.0, "plaster"), dead).steps > 0
    assert not with_talk[~alive.any(axis=1)].any()
    assert not with_talk[:, ~alive.any(axis=0)].any()


def test_every_sensor_has_optics_and_its_step_reaches_its_range() -> None:
    from viewshed.sensors import sensor_names

    for name in sensor_names():
        model = lidar_model(name)
        assert step_of(model) * 65_535 >= model.max_range_m
        assert model.name in OPTICS or name == "roadside"
    assert optics_of(replace(PERFECT, name="mine", max_range_m=80.0)).reach_m == pytest.approx(48.0)
    assert step_of(lidar_model("vlp32c")) == 0.004


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Conditions(missing_share=1.5), "missing_share must lie in .0, 1., got 1.5"),
        (lambda: Conditions(extinction_per_m=-0.1), "extinction_per_m must lie in .0, 1., got -0.1"),
        (lambda: Conditions(particle_reach=0.0), "particle_reach must lie in .0, 1., got 0.0"),
        (lambda: Conditions(dead_sector_deg=400.0), "dead_sector_deg must lie in .0, 360., got 400"),
        (lambda: Conditions(noise=float("nan")), "noise must lie in .0, 100., got nan"),
        (lambda: Optics(sigma_m=-1.0), "optics must have sigma_m"),
        (lambda: conditions_named("hail"), "conditions must be one of clear, rain, .* got 'hail'"),
    ],
)
def test_bad_numbers_are_refused(make: object, words: str) -> None:
    assert callable(make)
    with pytest.raises(ValueError, match=words):
        make()


def test_noise_of_weak_returns_doubles_at_the_threshold() -> None:
    model = lidar_model("hdl32e")
    threshold_m = OPTICS["HDL-32E"].reach_m * 1.2**0.5  # asphalt reflects 12 %, the reach is for 10 %
    found = range_m(measured(scan_of(model, threshold_m)))
    assert found.std() == pytest.approx(2 * OPTICS["HDL-32E"].sigma_m, rel=0.05)


def test_a_bright_near_surface_outshines_particles() -> None:
    model = lidar_model("hdl32e")
    fog = replace(CONDITIONS["dense_fog"], noise=0.0)
    near, far = (measured(scan_of(model, depth, "plaster"), fog) for depth in (4.0, 45.0))
    assert np.mean(np.abs(range_m(near) - 4.0) < 0.01) > 0.95
    early = range_m(far)[range_m(far) < 44.0]
    assert len(early) > 0.3 * near.steps.size
    assert range_m(far).max() < 45.01
