"""What is not installed is named in one line, with the extra that installs it."""

import re
import subprocess
import sys
import tomllib
from importlib import import_module, metadata
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

from viewshed._extras import _DISTRIBUTIONS, EXTRAS, needed_for
from viewshed.cli import main

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
files: Any = import_module("sweep_files")
recordings: Any = import_module("recording_files")


class Need(NamedTuple):
    """A command, and what it says where a package is missing."""

    package: str
    command: str
    said: str


NEEDS = [
    Need("pyarrow", "info a.feather", r"a.feather: reading Argoverse 2 needs pyarrow: pip install 'viewshed\[data\]'"),
    Need("pyarrow", "simulate nuscenes --sweeps 2 --out made",
         r"a data set in an archive needs pyarrow: pip install 'viewshed\[data\]'"),
    Need("rosbags", "info a.mcap", r"a.mcap: reading a bag needs rosbags: pip install 'viewshed\[bags\]'"),
    Need("lz4", "info lz4.mcap", r"reading a bag packed by lz4 needs lz4: pip install 'viewshed\[bags\]'"),
    Need("zstandard", "info a.mcap", r"reading a bag packed by zstd needs zstandard: pip install 'viewshed\[bags\]'"),
    Need("velodyne_decoder", "info v.pcap",
         r"v.pcap: reading Velodyne packets needs velodyne-decoder: pip install 'viewshed\[packets\]'"),
    Need("rosbags", "record v.pcap --to made.bag", r"writing a bag needs rosbags: pip install 'viewshed\[bags\]'"),
    Need("lz4", "record v.pcap --to made.mcap", r"writing MCAP needs lz4: pip install 'viewshed\[bags\]'"),
    Need("foxglove", "replay v.pcap --as-fast --to made.mcap --schemas foxglove",
         r"writing Foxglove's schemas needs foxglove-sdk: pip install 'viewshed\[foxglove\]'"),
    Need("foxglove", "view v.pcap --foxglove 8765",
         r"writing Foxglove's schemas needs foxglove-sdk: pip install 'viewshed\[foxglove\]'"),
    Need("rasterio", "export v.pcap --to geotiff", r"writing a GeoTIFF needs rasterio: pip install 'viewshed\[geo\]'"),
    Need("rerun", "view v.pcap --rerun made.rrd", r"writing for Rerun needs rerun-sdk: pip install 'viewshed\[view\]'"),
    Need("yaml", "info opv2v", r"reading OPV2V needs pyyaml: pip install 'viewshed\[opv2v\]'"),
    Need("ray", "simulate nuscenes --sweeps 2 --engine ray --out made",
         r"engine ray needs ray: pip install 'viewshed\[ray\]'"),
    Need("torch", "train road --out made", r"training needs torch: pip install 'viewshed\[train\]'"),
    Need("lightning", "train road --out made", r"training needs lightning: pip install 'viewshed\[train\]'"),
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
    import_module("viewshed.datasets.recordings.rosbag").decoder.cache_clear()
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
        ("numba", "simulate ugv --sweeps 2 --out made", "viewshed simulate needs numba: pip install 'viewshed[sim]'"),
        ("numba", "attack a.npz --attack far_wall --out made",
         "viewshed attack needs numba: pip install 'viewshed[sim]'"),
        ("scipy", "simulate ugv --sweeps 2 --out made", "viewshed simulate needs scipy: pip install 'viewshed[sim]'"),
        ("matplotlib", "simulate ugv --preview --out a.png",
         "viewshed simulate needs matplotlib: pip install 'viewshed[sim]'"),
    ],
)  # fmt: skip
def test_a_missing_package_at_the_top_of_a_module_is_named_as_well(
    package: str, words: str, said: str, tmp_path: Path
) -> None:
    code = f"import sys; sys.modules[{package!r}] = None; from viewshed.cli import main; main({words.split()})"
    done = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (2, f"viewshed: {said}\n")


def test_the_table_says_what_the_project_says() -> None:
    """Each package of the table is installed by its extra, and none by the core."""
    extras = {name: _names(wanted) for name, wanted in PROJECT["optional-dependencies"].items()}
    for package, extra in EXTRAS.items():
        assert _DISTRIBUTIONS.get(package, package) in extras[extra], f"{extra} must install {package}"
    core = _names(PROJECT["dependencies"])
    assert not core & {_DISTRIBUTIONS.get(package, package) for package in EXTRAS}


def _names(wanted: list[str]) -> set[str]:
    return {re.split(r"[\[<>=]", name)[0] for name in wanted}


def test_a_public_name_that_needs_the_laboratory_says_so() -> None:
    code = "import sys; sys.modules['numba'] = None; import viewshed; viewshed.attacks"
    done = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True)
    assert done.stderr.endswith("ImportError: viewshed.attacks needs numba: pip install 'viewshed[sim]'\n")


def test_a_module_of_no_extra_is_missing_as_python_says() -> None:
    with pytest.raises(ModuleNotFoundError, match="No module named 'no_such_module'"), needed_for("a test"):
        import_module("no_such_module")


APART = {"carla"}
"""Extras whose packages fit the version of a server: they need not go together with the rest."""


def test_extras_that_go_together_can_be_installed_together() -> None:
    """No package that one of them installs pins another to a version that a second one excludes."""
    wanted = [
        Requirement(text)
        for name, texts in PROJECT["optional-dependencies"].items() if name not in APART
        for text in (*texts, *PROJECT["dependencies"])
    ]  # fmt: skip
    asked: dict[str, dict[str, SpecifierSet]] = {}
    for requirement in wanted:
        asked.setdefault(canonicalize_name(requirement.name), {})["viewshed"] = requirement.specifier
        try:
            needs = [Requirement(text) for text in metadata.requires(requirement.name) or ()]
        except metadata.PackageNotFoundError:  # of an extra that is not installed here
            continue
        for need in needs:
            if need.marker is None or need.marker.evaluate({"extra": ""}):
                asked.setdefault(canonicalize_name(need.name), {})[requirement.name] = need.specifier
    for package, rules in asked.items():
        pinned = {one.version for rule in rules.values() for one in rule if one.operator == "=="}
        for version in pinned - {"*"}:
            if "*" not in version:
                refused = {
                    who: str(rule) for who, rule in rules.items() if not rule.contains(version, prereleases=True)
                }
                assert not refused, f"{package} {version}: {refused}"


def test_bags_and_packets_go_together() -> None:
    """The maker's decoder of Ouster packets pins an older rosbags: it may not be in any extra."""
    extras = PROJECT["optional-dependencies"]
    assert not any(Requirement(text).name == "ouster-sdk" for texts in extras.values() for text in texts)
    [rosbags] = [each for each in map(Requirement, extras["bags"]) if each.name == "rosbags"]
    assert not rosbags.specifier.contains("0.9.23")
