"""What ``viewshed_lab.threats.attacks`` gives by name."""

from viewshed_lab.threats import attacks
from viewshed_lab.threats.attacks import _gradient as gradient
from viewshed_lab.threats.attacks import adaptive


def test_the_names_are_those_of_their_modules() -> None:
    assert attacks.ADAPTIVE is adaptive.ADAPTIVE
    assert attacks.WhiteBox is gradient.WhiteBox
    assert attacks.Evade is adaptive.Evade
    assert not attacks.ADAPTIVE.keys() & attacks.ATTACKS.keys()
    assert set(attacks.__all__) <= set(dir(attacks))
