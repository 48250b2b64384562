"""What ``viewshed.threats.attacks`` gives by name."""

from viewshed.threats import attacks
from viewshed.threats.attacks import _gradient as gradient
from viewshed.threats.attacks import adaptive


def test_the_names_are_those_of_their_modules() -> None:
    assert attacks.ADAPTIVE is adaptive.ADAPTIVE
    assert attacks.WhiteBox is gradient.WhiteBox
    assert attacks.Evade is adaptive.Evade
    assert not attacks.ADAPTIVE.keys() & attacks.ATTACKS.keys()
    assert set(attacks.__all__) <= set(dir(attacks))
