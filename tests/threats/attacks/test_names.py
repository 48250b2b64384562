"""What ``viewshed.threats.attacks`` gives by name, and that it imports no more than is used."""

import subprocess
import sys

import pytest

from viewshed.threats import attacks
from viewshed.threats.attacks import _gradient as gradient
from viewshed.threats.attacks import adaptive
from viewshed.threats.attacks import adaptive as objectives

SCRIPT = """
import sys, viewshed.threats.attacks as attacks
late = {f"viewshed.threats.attacks.{name}" for name in ("adaptive", "_gradient", "_search")}
assert not late & set(sys.modules), late & set(sys.modules)
assert set(attacks.__all__) <= set(dir(attacks))
from viewshed.threats.attacks import OverClaim
assert "viewshed.threats.attacks._gradient" not in sys.modules
print(OverClaim.__module__, len({name: getattr(attacks, name) for name in attacks.__all__}) == len(attacks.__all__))
"""


def test_attackers_who_adapt_are_imported_when_they_are_used() -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=False)
    assert (done.stdout.split(), done.stderr) == (["viewshed.threats.attacks.adaptive", "True"], "")


def test_the_names_are_those_of_their_modules() -> None:
    assert attacks.ADAPTIVE is adaptive.ADAPTIVE
    assert attacks.WhiteBox is gradient.WhiteBox
    assert attacks.Evade is objectives.Evade
    assert not attacks.ADAPTIVE.keys() & attacks.ATTACKS.keys()
    with pytest.raises(AttributeError, match=r"module .viewshed\.threats\.attacks. has no attribute 'BlackBocks'"):
        _ = attacks.BlackBocks
