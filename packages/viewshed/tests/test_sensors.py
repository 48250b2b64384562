"""Beam tables: those shipped, those of a user, and what is said about wrong ones."""

import math
from pathlib import Path

import numpy as np
import pytest

import viewshed
from viewshed import GRIDS, Sweep, read_sweep, write_sweep
from viewshed.preprocess.leveling import level
from viewshed.preprocess.plausibility import doubts
from viewshed.preprocess.sensor_identification import identify_sensor
from viewshed.sensors import LidarModel, inferable_sensors, lidar_model, sensor_names
from viewshed_lab.data.archive.schema import model_of_text, text_of_model

RINGS = {
    "carla": 32, "carla256": 256, "hdl32e": 32, "hdl64e": 64, "os0_128": 128, "os0_32": 32, "os0_64": 64,
    "os1_128": 128, "os1_32": 32, "os1_32g": 32, "os1_64": 64, "ot128": 128, "pandar40p": 40, "pandar64": 64,
    "roadside": 128, "vlp16": 16, "vlp32c": 32, "xt32": 32,
    # named only, never inferred
    "at128": 128, "bpearl": 32, "helios32": 32, "os2_128": 128, "os2_32": 32, "os2_64": 64, "pandar128": 128,
    "qt128": 128, "qt64": 64, "rs16": 16, "rs32": 32, "ruby_plus": 128, "vls128": 128, "xt16": 16,
    # without rings
    "livox_avia": 32, "livox_hap": 32, "livox_horizon": 32, "livox_mid360": 32, "livox_mid40": 32, "livox_mid70": 32,
}  # fmt: skip
GOOD = 'name = "mine"\nelevations_deg = [-10, 0, 5.5]\nazimuth_columns = 900\n'


def test_the_shipped_tables_are_these() -> None:
    assert {name: lidar_model(name).rings for name in sensor_names()} == RINGS


@pytest.mark.parametrize("name", RINGS)
def test_a_shipped_table_ascends_and_cites_its_source(name: str) -> None:
    model = lidar_model(name)
    assert (np.diff(model.elevation) > 0).all()
    assert len(model.source) > 10
    assert model.azimuth_offset.shape == model.origin_m.shape == (model.rings,)
    assert np.abs(model.origin_m).max() < 0.3
    assert np.abs(model.azimuth_offset).max() < math.radians(15)
    assert not model.elevation.flags.writeable


@pytest.mark.parametrize(
    ("name", "lowest", "highest"),
    [
        ("vlp16", -15, 15), ("hdl32e", -30.67, 10.67), ("vlp32c", -25, 15), ("xt32", -16, 15), ("carla", -30, 10),
        ("carla256", -30, 60), ("pandar64", -24.9, 14.9), ("pandar40p", -25, 14.8), ("ot128", -24.7, 15.1),
        ("vls128", -25, 15), ("qt64", -52.1, 52.1), ("qt128", -52.63, 52.63),
        ("pandar128", -24.7, 15.1), ("at128", -12.47, 12.93),
        ("os2_128", -11.25, 11.25), ("rs32", -25.03, 14.98), ("helios32", -55, 15), ("bpearl", 2.3, 89.5),
        ("ruby_plus", -25.05, 15.03), ("xt16", -15, 15), ("livox_mid360", -7, 52), ("livox_hap", -12.5, 12.5),
        ("os0_128", -46.3, 45.8), ("os1_128", -21.8, 21.0), ("hdl64e", -25, 1.9), ("roadside", -55, 0),
    ],
)  # fmt: skip
def test_vertical_field_of_view(name: str, lowest: float, highest: float) -> None:
    opening = np.rad2deg(lidar_model(name).elevation[[0, -1]])
    assert opening == pytest.approx([lowest, highest], abs=0.06)


def test_vlp32c_azimuth_offset_is_counter_clockwise() -> None:
    model = lidar_model("VLP-32C")
    beam = int(np.argmin(np.abs(model.elevation - math.radians(0.333))))
    assert math.degrees(model.azimuth_offset[beam]) == pytest.approx(4.2)  # the manual: -4.2 clockwise


@pytest.mark.parametrize("spelling", ["VLP-16", "vlp16", "Vlp 16", "VLP_16"])
def test_case_and_punctuation_do_not_matter(spelling: str) -> None:
    assert lidar_model(spelling) is lidar_model("vlp16")


def test_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"sensor must be one of at128, .*xt32 or a TOML file, got 'sick'"):
        lidar_model("sick")


def _write(folder: Path, text: str) -> str:
    path = folder / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_own_table_with_defaults(tmp_path: Path) -> None:
    model = lidar_model(_write(tmp_path, GOOD))
    assert np.rad2deg(model.elevation).tolist() == pytest.approx([-10, 0, 5.5])
    assert (model.name, model.azimuth_columns, model.min_range_m, model.max_range_m) == ("mine", 900, 0.5, 100.0)
    assert model.origin_m.tolist() == model.azimuth_offset.tolist() == [0, 0, 0]
    assert model.azimuth_step == pytest.approx(math.radians(0.4))


def test_own_table_is_read_again_when_it_changes(tmp_path: Path) -> None:
    name = _write(tmp_path, GOOD)
    lidar_model(name)
    _write(tmp_path, GOOD.replace("900", "1200"))
    assert lidar_model(name).azimuth_columns == 1200


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name = ", "must be a TOML beam table"),
        ("\x00", "must be a TOML beam table"),
        ('name = "a"', r"missing keys \['azimuth_columns', 'elevations_deg'\]"),
        (GOOD + "color = 3", r"unknown keys \['color'\]"),
        (GOOD.replace("-10, 0, 5.5", "0, -10, 5"), r"mine: elevations must ascend strictly within ±90°; ring 0"),
        (GOOD.replace("5.5", "91"), "must ascend strictly within ±90°"),
        (GOOD.replace("-10, 0, 5.5", ""), "elevations must be 1 to 4096 finite numbers"),
        (GOOD.replace("5.5", "nan"), "elevations must be 1 to 4096 finite numbers"),
        (GOOD.replace("5.5", '"5.5"'), "elevations_deg must be a number, got '5.5'"),
        (GOOD.replace("[-10, 0, 5.5]", "7"), "elevations_deg must be a list of numbers, got 7"),
        (GOOD.replace("[-10, 0, 5.5]", "[[1]]"), r"elevations_deg must be a number, got \[1\]"),
        (GOOD.replace("900", "900.5"), "azimuth_columns must be a whole number, got 900.5"),
        (GOOD.replace("900", "true"), "azimuth_columns must be a whole number, got True"),
        (GOOD.replace("900", "3"), r"azimuth_columns must lie in \[4, 36000\], got 3"),
        (GOOD.replace('"mine"', '""'), "name must be text in quotes, got ''"),
        (GOOD + "inferred = 1", "inferred must be true or false, got 1"),
        (GOOD + "source = 1", "source must be text in quotes, got 1"),
        (GOOD + "min_range_m = true", "min_range_m must be a number, got True"),
        (GOOD + "min_range_m = 200", "ranges must satisfy 0 ≤ min_range_m < max_range_m"),
        (GOOD + "max_range_m = nan", "ranges must satisfy 0 ≤ min_range_m < max_range_m"),
        (GOOD + "origins_m = [0.1, 0.2]", r"origin_m must be 3 finite numbers, one a ring, got \(2,\)"),
        (GOOD + "azimuth_offsets_deg = [0, inf, 0]", "azimuth_offset must be 3 finite numbers"),
    ],
)
def test_wrong_table_is_told_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = _write(tmp_path, text)
    with pytest.raises(ValueError, match=message) as caught:
        LidarModel.from_toml(path)
    assert str(caught.value).startswith(path)
    assert "\n" not in str(caught.value)


def test_missing_file_is_an_oserror(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"none\.toml"):
        lidar_model(str(tmp_path / "none.toml"))


def test_only_sensors_that_were_held_against_sweeps_or_stand_alone_are_inferred() -> None:
    names = set(inferable_sensors())
    assert names == set(RINGS) - {
        "at128", "bpearl", "helios32", "os2_128", "os2_32", "os2_64", "pandar128", "qt128", "qt64", "rs16", "rs32",
        "ruby_plus",
        "vls128", "xt16", *(name for name in RINGS if name.startswith("livox")),
    }  # fmt: skip


def test_a_sensor_without_rings_keeps_that_in_files(tmp_path: Path) -> None:
    model = lidar_model("livox_mid360")
    assert not model.fires_rings
    write_sweep(Sweep(np.ones((4, 3), np.float32), model=model), tmp_path / "a.npz")
    back = read_sweep(tmp_path / "a.npz").model
    assert (back.fires_rings, back.reach_m) == (False, 40.0)
    assert model_of_text(text_of_model(model)) is model
    plain = lidar_model("vlp16")
    assert "fires_rings" not in text_of_model(plain)


@pytest.mark.parametrize("name", ["livox_mid360", "livox_avia"])
def test_no_rings_are_looked_for_in_a_field(name: str) -> None:
    model = lidar_model(name)
    rng = np.random.default_rng(3)
    azimuth, elevation = rng.uniform(-0.6, 0.6, 5000), rng.uniform(model.elevation[0], model.elevation[-1], 5000)
    towards = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    points = (10.0 * np.column_stack(towards)).astype(np.float32)
    sweep = Sweep(points, ring=np.zeros(5000, np.int16), model=model)
    found = identify_sensor(sweep)
    assert found.ring is None
    assert found.model is model
    leveled = level(sweep, GRIDS["indoor"])
    assert not [doubt for doubt in doubts(leveled) if "outside of the field" in doubt]
    tilted = sweep.replace(points=points[:, [0, 2, 1]] * np.array([0.2, 1.0, 9.0], np.float32))
    assert any("outside of the field of Livox" in doubt for doubt in doubts(level(tilted, GRIDS["indoor"])))
    assert viewshed.estimate(sweep, grid="indoor").basis is not None
