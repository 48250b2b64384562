"""Running with the viewshed of another checkout: it is the one that is imported, whatever is installed."""

import subprocess
import sys
from pathlib import Path

import pytest

TOOL = Path(__file__).resolve().parents[1] / "tools" / "with_checkout.py"

EDITABLE = """\
import sys
from importlib.util import spec_from_file_location
class ScikitBuildRedirectingFinder:
    @staticmethod
    def find_spec(name, path=None, target=None):
        return spec_from_file_location(name, {installed!r}) if name == "viewshed" else None
sys.meta_path.insert(0, ScikitBuildRedirectingFinder())
"""
"""What scikit-build-core puts into an environment in which viewshed is installed to be edited."""

PRINT = "import viewshed; print(viewshed.__file__)"


def write_package(checkout: Path) -> Path:
    """Write an empty viewshed into a checkout."""
    file = checkout / "src" / "viewshed" / "__init__.py"
    file.parent.mkdir(parents=True)
    file.touch()
    return file


@pytest.fixture
def python(tmp_path: Path) -> Path:
    """Return the Python of an environment with an editable install."""
    installed = write_package(tmp_path / "installed")
    subprocess.run((sys.executable, "-m", "venv", "--without-pip", tmp_path / "venv"), check=True)
    (site,) = (tmp_path / "venv").glob("lib/python*/site-packages")
    (site / "_editable.py").write_text(EDITABLE.format(installed=str(installed)))
    (site / "_editable.pth").write_text("import _editable\n")
    return tmp_path / "venv" / "bin" / "python"


def imported(*command: str | Path) -> Path:
    """Return the file that a command says it imports."""
    return Path(subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip())


def test_the_named_checkout_is_imported(python: Path, tmp_path: Path) -> None:
    assert imported(python, "-c", PRINT) == tmp_path / "installed" / "src" / "viewshed" / "__init__.py"
    wanted = write_package(tmp_path / "wanted")
    assert imported(python, TOOL, tmp_path / "wanted", "-c", PRINT) == wanted
    child = f"import subprocess, sys; subprocess.run((sys.executable, '-c', {PRINT!r}), check=True)"
    assert imported(python, TOOL, tmp_path / "wanted", "-c", child) == wanted


def test_a_checkout_of_two_packages_is_imported_as_well(python: Path, tmp_path: Path) -> None:
    wanted = write_package(tmp_path / "wanted" / "packages" / "viewshed")
    assert imported(python, TOOL, tmp_path / "wanted", "-c", PRINT) == wanted


def test_a_folder_without_viewshed_is_refused(tmp_path: Path) -> None:
    run = subprocess.run((sys.executable, TOOL, tmp_path, "-c", ""), capture_output=True, text=True, check=False)
    assert run.returncode == 1
    assert run.stderr.endswith("CHECKOUT must have viewshed's sources\n")
