"""The report of two versions under every attack: the files that both read, and differences by hand."""

from dataclasses import replace
from pathlib import Path

import attack_families
import numpy as np
import pytest
from attack_families import Counted

from viewshed.datasets.presets import preset_named
from viewshed.studies.cases import DEFAULT
from viewshed.studies.records import BENIGN, Case
from viewshed.studies.samples import sample_of_preset

CASES = (BENIGN, Case("attack", "far_wall", DEFAULT), Case("corruption", "fewer_beams", "3"))


def test_both_versions_read_the_files_that_one_wrote(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(attack_families, "CASES", CASES)
    preset = replace(preset_named("roads"), conditions=("clear",), condition_weights=(1.0,))
    attack_families.write_scene(tmp_path, 0, sample_of_preset(preset, 0, 1, 5))
    found = Counted.of_json(attack_families.counted(tmp_path).to_json())
    assert set(found.counts) == {
        (method, case) for method in attack_families.METHODS for case in ("benign", "far_wall", "fewer_beams")
    }
    assert all(0.5 < found.ranks["viewnet", case] < 1.0 for case in found.of("viewnet"))
    for counts in found.counts.values():
        assert counts.shape == (1, 4)
        assert counts[0, 0] > 1000
    # The attack opens what the truth does not show; a sensor with fewer beams has a truth of its own.
    shadow_map = found.of("shadow_map")
    assert shadow_map["far_wall"][0, 1] > shadow_map["benign"][0, 1] + 100
    visible = {case: counts[0, 0] + counts[0, 2] for case, counts in shadow_map.items()}
    assert visible["far_wall"] == visible["benign"] > visible["fewer_beams"]


def _counted(both: int, over: int) -> Counted:
    rows = np.array([[both, over, 100 - both, 1000 - over]] * 3, np.float64)
    keys = [(method, "benign") for method in attack_families.METHODS]
    return Counted("v", "viewnet", dict.fromkeys(keys, rows), dict.fromkeys(keys, 0.9))


def test_a_version_is_worse_below_the_least_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(attack_families, "CASES", (BENIGN,))
    before, same, worse = _counted(90, 10), _counted(90, 10), _counted(80, 0)
    value, low, high = attack_families.difference(before.of("shadow_map")["benign"], worse.of("shadow_map")["benign"])
    assert value == pytest.approx(160 / 180 - 0.9)
    assert low == pytest.approx(value)
    assert high == pytest.approx(value)
    assert "**worse**" not in attack_families.report(before, same).split("\n## ", 1)[1]
    text = attack_families.report(before, worse)
    assert "| benign | 0.900 | 0.889 | -0.011 [-0.011, -0.011] | +0.000 | **worse** |" in text
    assert "| benign | 0.900 | 0.900 | 0.900 | 0.900 |" in text
    with pytest.raises(ValueError, match="must count the same files, got others for benign; run counts again"):
        attack_families.report(_counted(50, 1), replace(same, counts={("shadow_map", "benign"): np.ones((3, 4))}))
