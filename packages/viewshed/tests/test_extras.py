"""What is not installed is named in one line, with the extra that installs it."""

import re
import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from hatchling.metadata.core import ProjectMetadata
from hatchling.plugin.manager import PluginManager

import viewshed
import viewshed_lab
from viewshed._extras import _DISTRIBUTIONS, EXTRAS
from viewshed.cli import main

ROOT = Path(__file__).resolve().parents[3]
_FILES = {
    name: tomllib.loads((ROOT / "packages" / name / "pyproject.toml").read_text(encoding="utf-8"))
    for name in ("viewshed", "viewshed-lab")
}
PROJECTS = {name: file["project"] for name, file in _FILES.items()}
# The laboratory's own list; its version and the robot's package of that version come before it, by hatch_build.py.
PROJECTS["viewshed-lab"]["dependencies"] = _FILES["viewshed-lab"]["tool"]["hatch"]["metadata"]["hooks"]["custom"][
    "dependencies"
]
files: Any = import_module("sweep_files")
recordings: Any = import_module("recording_files")


class Need(NamedTuple):
    """A command, and what it says where a package is missing."""

    package: str
    command: str
    said: str


BRINGS = r"pip install 'viewshed\[recordings\]'"

NEEDS = [
    Need("pyarrow", "info a.feather", rf"a.feather: reading Argoverse 2 needs pyarrow: {BRINGS}"),
    Need("pyarrow", "simulate nuscenes --sweeps 2 --out made",
         rf"a data set in an archive needs pyarrow: {BRINGS}"),
    Need("pebble", "simulate nuscenes --sweeps 2 --workers 2 --out made",
         r"more than one worker needs pebble: pip install 'viewshed-lab'"),
    Need("rosbags", "info a.mcap", rf"a.mcap: reading a bag needs rosbags: {BRINGS}"),
    Need("mcap", "info a.mcap", rf"reading MCAP needs mcap: {BRINGS}"),
    Need("lz4", "info lz4.mcap", rf"reading a bag packed by lz4 needs lz4: {BRINGS}"),
    Need("zstandard", "info a.mcap", rf"reading a bag packed by zstd needs zstandard: {BRINGS}"),
    Need("velodyne_decoder", "info v.pcap",
         rf"v.pcap: reading Velodyne packets needs velodyne-decoder: {BRINGS}"),
    Need("rosbags", "record v.pcap --to made.bag", rf"writing a bag needs rosbags: {BRINGS}"),
    Need("lz4", "record v.pcap --to made.mcap", rf"writing MCAP needs lz4: {BRINGS}"),
    Need("foxglove", "replay v.pcap --as-fast --to made.mcap --schemas foxglove",
         rf"writing Foxglove's schemas needs foxglove-sdk: {BRINGS}"),
    Need("foxglove", "view v.pcap --foxglove 8765",
         rf"writing Foxglove's schemas needs foxglove-sdk: {BRINGS}"),
    Need("rasterio", "export v.pcap --to geotiff", r"writing a GeoTIFF needs rasterio: pip install 'viewshed\[geo\]'"),
    Need("rerun", "view v.pcap --rerun made.rrd", r"writing for Rerun needs rerun-sdk: pip install 'viewshed\[view\]'"),
    Need("yaml", "info opv2v", rf"reading OPV2V needs pyyaml: {BRINGS}"),
    Need("ray", "simulate nuscenes --sweeps 2 --engine ray --out made",
         r"engine ray needs ray: pip install 'viewshed-lab\[ray\]'"),
    Need("torch", "train road --out made", r"training needs torch: pip install 'viewshed-lab\[train\]'"),
    Need("lightning", "train road --out made", r"training needs lightning: pip install 'viewshed-lab\[train\]'"),
]  # fmt: skip
"""Packages that are imported when they are needed; those that a module imports at its top are below."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("extras")
    samples = files.samples()
    for name in ("argoverse2 lz4", "velodyne pcap"):
        for other, content in {samples[name].name: samples[name].content, **samples[name].beside}.items():
            (place / other).write_bytes(content)
    (place / "a.mcap").write_bytes(recordings.mcap("ZSTD"))
    (place / "lz4.mcap").write_bytes(recordings.mcap("LZ4"))
    recordings.write(place / "opv2v", recordings.opv2v())
    return place


@pytest.mark.parametrize("need", NEEDS, ids=lambda need: f"{need.package} {need.command.split()[0]}")
def test_a_missing_package_is_named_with_its_extra(
    need: Need, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    for name in [name for name in sys.modules if name.partition(".")[0] == need.package]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, need.package, None)
    import_module("viewshed.recordings.read.rosbag").decoder.cache_clear()
    with pytest.raises(SystemExit) as stopped:
        main(need.command.split())
    said = capsys.readouterr().err
    assert stopped.value.code == 2
    assert re.search(rf"^viewshed: .*{need.said}", said, re.MULTILINE), said
    assert "Traceback" not in said
    assert not [*folder.glob("*made*")]


@pytest.mark.parametrize(
    ("package", "words", "said"),
    [
        ("numba", "simulate ugv --sweeps 2 --out made", "viewshed simulate needs numba: pip install 'viewshed-lab'"),
        ("scipy", "simulate ugv --sweeps 2 --out made",
         "viewshed simulate needs scipy: pip install 'viewshed[agents]'"),
        ("matplotlib", "simulate ugv --preview --out a.png",
         "viewshed simulate needs matplotlib: pip install 'viewshed-lab'"),
    ],
)  # fmt: skip
def test_a_missing_package_at_the_top_of_a_module_is_named_as_well(
    package: str, words: str, said: str, tmp_path: Path
) -> None:
    code = f"import sys; sys.modules[{package!r}] = None; from viewshed.cli import main; main({words.split()})"
    done = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (2, f"viewshed: {said}\n")


def test_the_table_says_what_the_projects_say() -> None:
    """Each package of the table is installed by what the table names, and none by the robot's package alone."""
    brought = {name: _names(project["dependencies"]) for name, project in PROJECTS.items()}
    for name, project in PROJECTS.items():
        brought |= {f"{name}[{extra}]": _names(each) for extra, each in project["optional-dependencies"].items()}
    for package, install in EXTRAS.items():
        assert _DISTRIBUTIONS.get(package, package) in brought[install], f"{install} must install {package}"
    assert not brought["viewshed"] & {_DISTRIBUTIONS.get(package, package) for package in EXTRAS}


def test_the_two_packages_have_one_version_and_one_place_for_it() -> None:
    assert viewshed_lab.__version__ == viewshed.__version__
    assert [project["dynamic"][0] for project in PROJECTS.values()] == ["version", "version"]
    built = ProjectMetadata(str(ROOT / "packages" / "viewshed-lab"), PluginManager())
    assert built.core.version == viewshed.__version__
    assert f"viewshed[recordings]=={viewshed.__version__}" in built.core.dependencies


def _names(wanted: list[str]) -> set[str]:
    return {re.split(r"[\[<>=]", name)[0] for name in wanted}


def test_a_public_name_that_needs_the_laboratory_says_so() -> None:
    code = "import sys; sys.modules['numba'] = None; import viewshed; viewshed.attacks"
    done = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True)
    assert done.stderr.endswith("ImportError: viewshed.attacks needs numba: pip install 'viewshed-lab'\n")


def test_a_command_or_a_name_of_the_laboratory_names_it_where_it_is_not_installed(tmp_path: Path) -> None:
    done = _without_laboratory("from viewshed.cli import main; main(['study', 'wild', '--preset', 'tiny'])", tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "viewshed study needs viewshed-lab: pip install viewshed-lab" in done.stderr
    done = _without_laboratory("from viewshed.cli import main; main(['--help'])", tmp_path)
    assert re.search(r"simulate, label, .*, study: pip install viewshed-lab", " ".join(done.stdout.split()))
    done = _without_laboratory("import viewshed; viewshed.Archive", tmp_path)
    assert "ImportError: viewshed.Archive needs viewshed-lab: pip install viewshed-lab" in done.stderr
    every = "from viewshed import *; import inspect, viewshed; inspect.getmembers(viewshed)"
    assert _without_laboratory(every, tmp_path).stderr == ""
    done = _without_laboratory("import viewshed.sim.worlds", tmp_path)
    assert "ImportError: viewshed.sim needs viewshed-lab: pip install viewshed-lab" in done.stderr


_ALONE = """
import importlib.metadata, sys
importlib.metadata.entry_points = lambda **of: ()
class Absent:
    def find_spec(name, *_):
        if name.partition(".")[0] == "viewshed_lab":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Absent)
"""


def _without_laboratory(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run code where the laboratory is not installed and no package adds anything to viewshed."""
    command = [sys.executable, "-c", _ALONE + code]
    return subprocess.run(command, check=False, capture_output=True, text=True, cwd=folder)


FORMER = {
    "viewshed.integrity.report": "viewshed.monitor.report", "viewshed.fusion.single": "viewshed.objects.single",
    "viewshed.fusion.trust": "viewshed.agents.trust", "viewshed.messages.signing": "viewshed.agents.signing",
    "viewshed.tracking.tracker": "viewshed.objects.tracker", "viewshed.plot": "viewshed.show.plot",
    "viewshed.perception": "viewshed.objects", "viewshed.sim.worlds": "viewshed_lab.sim.worlds",
    "viewshed.datasets": "viewshed_lab.data", "viewshed.datasets.recordings": "viewshed.recordings.read",
}  # fmt: skip
"""Path of version 0.3 → path now."""


def test_paths_of_version_0_3_are_taken_and_name_the_path_now() -> None:
    code = f"""
import warnings
from importlib import import_module
for path in {list(FORMER)}:
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        former = import_module(path)
    now = former.__spec__.name
    print(path, import_module(now) is former, str(seen[-1].message))
"""
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.splitlines() == [f"{former} True {former} is now {now}" for former, now in FORMER.items()]
