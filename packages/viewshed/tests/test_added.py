"""An estimator, a file format and a sensor that a package of one's own adds, without a change to viewshed."""

import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = '''
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from viewshed import CAR, BevGrid, Target
from viewshed.estimators.classical import ClassicalEstimator
from viewshed.io import Columns, Format


@dataclass(frozen=True)
class NearBy(ClassicalEstimator):
    """Everything within ten meters is visible."""

    grid: BevGrid
    target: Target = CAR
    name: str = "near_by"

    def visible_prob(self, leveled, history):
        return (np.hypot(*np.moveaxis(self.grid.centers, -1, 0)) < 10.0).astype(np.float32)


def read_lines(source, frame) -> Iterator[Columns]:
    points = np.loadtxt(source.content().decode().splitlines(), ndmin=2)
    yield Columns(points=points.astype(np.float32))


LINES = Format(read_lines, (".lines",))
TABLE = Path(__file__).with_name("two_rings.toml")
'''

SENSOR = """name = "Two rings"
elevations_deg = [-10.0, -5.0]
azimuth_columns = 360
source = "made by a test"
"""

ENTRY_POINTS = """[viewshed.estimators]
near_by = newcomer:NearBy

[viewshed.formats]
lines = newcomer:LINES

[viewshed.sensors]
two_rings = newcomer:TABLE
"""


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    """A folder with an installed package, as pip leaves one."""
    facts = tmp_path / "newcomer-1.0.dist-info"
    facts.mkdir()
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: newcomer\nVersion: 1.0\n")
    (facts / "entry_points.txt").write_text(ENTRY_POINTS)
    (tmp_path / "newcomer.py").write_text(PACKAGE)
    (tmp_path / "two_rings.toml").write_text(SENSOR)
    (tmp_path / "a.lines").write_text("5 1 -1.5\n0 7 -1.5\n")
    return tmp_path


def run(folder: Path, code: str) -> subprocess.CompletedProcess[str]:
    start = f"import sys; sys.path.insert(0, {str(folder)!r})\n"
    return subprocess.run([sys.executable, "-c", start + code], capture_output=True, text=True, check=False, cwd=folder)


def test_what_a_package_adds_is_known_by_its_name(installed: Path) -> None:
    done = run(
        installed,
        "import viewshed as vs\n"
        "sweep = vs.read_sweep('a.lines')\n"
        "print(len(sweep), vs.lidar_model('two-rings').rings)\n"
        "fov = vs.load_estimator('near_by').estimate(sweep)\n"
        "print(fov.method, fov.at([[3.0, 4.0], [30.0, 40.0]]).tolist())\n",
    )
    assert done.stdout.splitlines() == ["2 2", "near_by [1.0, 0.0]"], done.stderr


def test_the_command_line_knows_them_as_well_and_lists_them(installed: Path) -> None:
    words = ["estimate", "a.lines", "--method", "near_by", "--sensor", "two_rings", "--results", "npz"]
    code = "from viewshed.cli import main\ntry:\n    main({})\nexcept SystemExit as end:\n    assert not end.code\n"
    done = run(installed, code.format(words) + "main(['estimate', 'a.lines', '--method', 'far_off'])")
    assert "(near_by, " in done.stdout
    assert done.returncode == 2
    assert "near_by, got 'far_off'" in done.stderr
