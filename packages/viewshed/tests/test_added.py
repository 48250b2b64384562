"""An estimator, a file format and a sensor that a package of one's own adds, without a change to viewshed."""

import subprocess
import sys
from pathlib import Path

import numpy as np
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
SENSOR_ROWS = 2
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

STALE = """[viewshed.commands]
broken = nosuchpkg.cli:app
renamed = newcomer:gone
number = newcomer:SENSOR_ROWS

[viewshed.estimators]
near_by = newcomer:SENSOR_ROWS

[viewshed.formats]
lines = newcomer:LINES
packets = newcomer:SENSOR_ROWS

[viewshed.sensors]
two_rings = newcomer:SENSOR_ROWS

[viewshed.weights]
pixels = newcomer:SENSOR_ROWS
"""
"""What a package of another version names: modules and attributes that are gone, or things of another kind."""


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


@pytest.mark.parametrize(
    ("words", "point", "problem"),
    [
        ("broken", "commands 'broken'", "No module named 'nosuchpkg'"),
        ("renamed", "commands 'renamed'", "module 'newcomer' has no attribute 'gone'"),
        ("number", "commands 'number'", "it must name a function or a typer.Typer, got 2"),
        ("estimate a.npy --method near_by",
         "estimators 'near_by'", "it must name a class or a function, got 2"),
        ("estimate a.npy --sensor two_rings",
         "sensors 'two_rings'", "it must name the path of a TOML file, got 2"),
        ("estimate a.npy --weights pixels",
         "weights 'pixels'", "it must name a folder, got 2"),
    ],
)  # fmt: skip
def test_what_cannot_be_loaded_is_named_with_its_package_when_it_is_used(
    installed: Path, words: str, point: str, problem: str
) -> None:
    _make_stale(installed)
    done = run(installed, f"from viewshed.cli import main\nmain({words.split()})")
    assert done.returncode == 2, done.stderr
    said = f"entry point viewshed.{point} of newcomer cannot be loaded: {problem}; uninstall or update newcomer"
    assert done.stderr.splitlines()[-1].endswith(said)
    assert "Traceback" not in done.stderr


def test_what_cannot_be_loaded_hinders_no_other_command_and_no_other_format(installed: Path) -> None:
    _make_stale(installed)
    assert run(installed, "from viewshed.cli import main\nmain(['--help'])").returncode == 0
    done = run(installed, "from viewshed.cli import main\nmain(['info', 'a.lines'])")
    assert done.returncode == 0, done.stderr
    assert "warning: format 'packets' is left out: entry point viewshed.formats 'packets' of newcomer" in done.stderr


def _make_stale(installed: Path) -> None:
    (installed / "newcomer-1.0.dist-info" / "entry_points.txt").write_text(STALE)
    np.save(installed / "a.npy", np.array([[5.0, 1.0, -1.5], [0.0, 7.0, -1.5]], dtype=np.float32))
