"""Sets in the wild share nothing, are the same for the same seed, and their samples are what they say."""

from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

from viewshed.geometry import Rigid, rotation_from_quaternion
from viewshed_lab._jobs import LocalEngine
from viewshed_lab.data.archive.build import ShardResult
from viewshed_lab.data.archive.storage import Storage
from viewshed_lab.data.wild import (
    GIVEN,
    OPEN_SEALED,
    WildObservation,
    WildScene,
    check_apart,
    make_wild_archive,
    split_of_set,
    wild_samples,
    wild_scenes,
    wild_tables,
)
from viewshed_lab.sim.world import GROUND

TABLES = wild_tables()


def first_scenes(count: int = 6) -> list[WildScene]:
    """Return a few scenes of every open domain."""
    return [
        WildScene(domain, number)
        for domain in TABLES.domains
        if domain.set_name != "sealed"
        for number in range(min(domain.scenes, count))
    ]


def digest(seen: WildObservation) -> str:
    """Return what is the same for two observations only if all their bytes are."""
    out = sha256()
    for given in GIVEN:
        sample = seen.sample(given)
        sweep = sample.sweep
        for array in (sweep.points, sweep.ring, sweep.time_s, sweep.intensity, sample.known, sample.ground_m):
            out.update(b"-" if array is None else np.ascontiguousarray(array).tobytes())
        for target in sorted(sample.truth.expected_returns):
            out.update(sample.truth.expected_returns[target].tobytes())
    return out.hexdigest()


@pytest.mark.parametrize("key", ["styles", "sensors", "mountings", "seed"])
def test_sets_that_share_anything_are_refused(key: str) -> None:
    """Within a set, and with ``own``, sharing is allowed."""
    own, training, sealed = (TABLES.of_set(name)[0] for name in ("own", "training", "sealed"))
    check_apart((own, replace(own, set_name="training"), replace(own, set_name="training")))
    shared = replace(sealed, **{key: getattr(training, key)})
    for known in (training, replace(training, set_name="learning")):
        with pytest.raises(ValueError, match=f"must share no {key}"):
            check_apart((known, shared))


def test_the_sealed_set_has_what_it_must_have() -> None:
    domains = TABLES.of_set("sealed")
    assert sum(domain.scenes for domain in domains) >= 60
    assert len({style for domain in domains for style in domain.styles}) >= 6
    families = [TABLES.sensors[name] for domain in domains for name in domain.sensors]
    assert len({one.name for one in families}) >= 4
    assert any(one.pattern != "rings" for one in families)
    assert any(one.pattern == "rings" and "ring" in one.leaves_out for one in families)
    scenes = wild_scenes("sealed", unseal=OPEN_SEALED)
    met = {(scene.domain.name, scene.style, scene.sensor) for scene in scenes}
    assert met == {(one.name, style, sensor) for one in domains for style in one.styles for sensor in one.sensors}


@pytest.mark.parametrize("unseal", ["", "please"])
def test_the_sealed_set_stays_closed(unseal: str) -> None:
    with pytest.raises(ValueError, match="must not be sealed"):
        wild_scenes("sealed", unseal=unseal)
    with pytest.raises(ValueError, match="must not be sealed"):
        next(wild_samples("sealed", unseal=unseal))


def test_bytes_follow_from_the_seed_in_any_order() -> None:
    scenes = first_scenes(2)
    forward = [digest(scene.observe(0)) for scene in scenes]
    assert [digest(scene.observe(0)) for scene in reversed(scenes)][::-1] == forward
    assert len(set(forward)) == len(forward)
    other = replace(scenes[0], domain=replace(scenes[0].domain, seed=1))
    assert digest(other.observe(0)) != forward[0]


@pytest.mark.parametrize("scene", first_scenes(), ids=lambda scene: scene.name)
def test_a_sample_says_what_it_is_told_and_no_more(scene: WildScene) -> None:
    seen = scene.observe(0)
    table, rings, nothing = (seen.given(given) for given in GIVEN)
    assert len(table) == len(rings) == len(nothing) > 50
    assert (nothing.ring, nothing.model, nothing.intensity, nothing.time_s) == (None,) * 4
    for sweep in (rings, nothing):
        assert (sweep.model, sweep.sensor_height_m, sweep.attitude, sweep.world_from_sensor) == (None,) * 4
    leaves_out = seen.sensor.leaves_out
    assert (rings.ring is None) == ("ring" in leaves_out)
    assert (table.model is None) == (seen.sensor.table is None)
    assert (table.sensor_height_m is None) == (seen.mounting.family.frame == "base")
    sample = seen.sample("rings")
    assert sample.known.shape == sample.ground_m.shape == sample.truth.grid.shape == scene.domain.grid.shape
    assert sample.truth.grid == scene.domain.grid
    assert 0.2 < sample.truth.visible()[sample.known].mean() + 0.2 < 1.2


@pytest.mark.parametrize("scene", first_scenes(), ids=lambda scene: scene.name)
def test_ground_returns_lie_on_the_exact_ground(scene: WildScene) -> None:
    """Whatever the mounting and the frame: leveled exactly, they stand 0 m above the ground of their cell."""
    seen = scene.observe(0)
    sample = seen.sample("nothing")
    level = Rigid(rotation_from_quaternion(sample.attitude), np.array([0.0, 0.0, sample.origin_height_m]))
    points = level @ sample.sweep.points.astype(np.float64)
    cell, inside = sample.truth.grid.index(points)
    height = points[inside, 2] - sample.ground_m[cell[inside, 0], cell[inside, 1]]
    near, met = np.abs(height) < 0.15, seen.scan.thing[np.isfinite(seen.scan.depth_m)]
    if seen.world.upper is None:
        assert near.mean() >= 0.4 * (met == GROUND).mean()
    assert near.sum() < 100 or np.abs(np.median(height[near])) < 0.05
    assert np.percentile(height, 2) > -0.5


def test_an_archive_goes_on_to_the_same_bytes_and_gives_the_samples_back(tmp_path: Path) -> None:
    stores = [Storage.of(str(tmp_path / name)) for name in ("whole", "stopped")]
    whole = make_wild_archive("development", "road", stores[0], LocalEngine(1), scenes=2)
    with pytest.raises(OSError, match="stop"):
        make_wild_archive("development", "road", stores[1], LocalEngine(1), scenes=2, on_progress=_stop)
    kept = sorted(path.name for path in (tmp_path / "stopped").glob("*.parquet"))
    assert len(kept) >= 1
    make_wild_archive("development", "road", stores[1], LocalEngine(1), scenes=2)
    for path in (tmp_path / "whole").glob("*.parquet"):
        assert path.read_bytes() == (tmp_path / "stopped" / path.name).read_bytes()
    assert whole.splits == ("development",)
    assert split_of_set("training") == "train"
    sample, seen = whole[0], wild_scenes("development", "road")[0].observe(0)
    assert sample.sweep.points.tobytes() == seen.given("rings").points.tobytes()
    assert (sample.truth.expected_returns["car"] == seen.truth.expected_returns["car"]).all()
    assert (sample.known == seen.known).all()


def _stop(_shard: ShardResult) -> None:
    raise OSError("stop")
