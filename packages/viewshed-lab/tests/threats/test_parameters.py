"""Parameters of attacks, defenses and corruptions that cannot be: one line that names the parameter and its rule."""

import re
from dataclasses import replace
from math import nan
from typing import Any

import pytest

from viewshed_lab.threats import corruptions, defenses
from viewshed_lab.threats.adversary import Adversary
from viewshed_lab.threats.attacks import ATTACKS, Spoofer
from viewshed_lab.threats.defenses import TemporalConsistency
from viewshed_lab.threats.object_attacks import OBJECT_ATTACKS


def attack(name: str, **changes: Any) -> object:
    made: Any = ATTACKS[name]()
    return lambda: replace(made, **changes)


def on_objects(**changes: Any) -> object:
    return lambda: OBJECT_ATTACKS["fabricate_static"](**{"counts": "exact"} | changes)


REFUSED: list[tuple[object, str]] = [
    (attack("uniform", mode="beams"), "mode must be one of free_form, beam_constrained, got 'beams'"),
    (attack("cluster", range_m=(30.0, 20.0)), "range_m[0] must lie in [0.1, 20], got 30.0"),
    (attack("wedge_cluster", azimuth=nan), "azimuth must be finite, in radians, got nan"),
    (attack("frustum", side="above"), "side must be one of behind, before, got 'above'"),
    (attack("ghost_car", size_m=(4.0, 0.0, 1.5)), "size_m must lie in [0.05, 100], got 0.0"),
    (attack("ghost_wall", sector_deg=180.0), "sector_deg must lie in [0.01, 150], got 180.0"),
    (attack("far_wall", far_m=-1.0), "far_m must lie in [0.5, 1000], got -1.0"),
    (attack("far_wall", placement="best"), "placement must be one of random, … largest_hidden_area, got 'best'"),
    (attack("jamming", share=nan), "share must lie in [0, 1], got nan"),
    (attack("coherent_phantom", velocity_mps=(1.0, 0.0)), "a ghost that moves must have a start, got no first_ns…"),
    (lambda: Spoofer(1.2), "reliability must lie in [0, 1], got 1.2"),
    (on_objects(mean_count=1.5), "mean_count must be a whole number where counts are exact, got 1.5"),
    (on_objects(motion="sideways"), "motion must be one of static, markov, trajectory, got 'sideways'"),
    (on_objects(trajectory=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))), "trajectory must be rows of rising seconds…"),
    (lambda: Adversary("melt"), "attack must be one of … far_wall, … got 'melt'"),
    (lambda: Adversary("far_wall", start_s=3.0, end_s=2.0), "… must have 0 <= start_s < end_s…"),
    (lambda: defenses.StatisticalOutlierRemoval(0), "neighbors must lie in [1, 1000], got 0"),
    (lambda: defenses.RadiusOutlierRemoval(0.0), "radius_m must lie in (0, 1000], got 0.0"),
    (lambda: defenses.ClusteringOutlierRemoval(0.5, 1), "fewest must be at least 2, got 1"),
    (lambda: defenses.OneReturnPerBeam(1.0), "tolerance must lie in [0, 0.999], got 1.0"),
    (lambda: defenses.EmptySectorCheck(0.0), "width_deg must lie in (0, 360], got 0.0"),
    (lambda: TemporalConsistency(margin_m=0.0), "margin_m and gap_m must be positive, got 0.0 and 1.0"),
    (lambda: corruptions.DroppedBeams(1.5), "share must lie in [0, 1], got 1.5"),
    (lambda: corruptions.FewerBeams(3, 2), "kept must lie in [1, 2], got 3"),
    (lambda: corruptions.RangeNoise(nan), "sigma_m must lie in [0, 10], got nan"),
]
"""What makes it, and its line (… stands for anything but a new line)."""


@pytest.mark.parametrize(("make", "words"), REFUSED, ids=[words for _, words in REFUSED])
def test_parameters_out_of_range_are_one_clear_line(make: Any, words: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(words).replace('…', '.*')}$"):
        make()
