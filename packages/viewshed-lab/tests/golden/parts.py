"""The parts of the golden files: how each is recorded and checked."""

from __future__ import annotations

import datetime
import json
import platform
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.golden import recorder, stored, tables

FOLDER = Path(__file__).parent
SHARDS = FOLDER / "shards.json"
TABLES = FOLDER / "tables"
RESULTS = FOLDER.parents[3] / "docs" / "results"


@dataclass(frozen=True, slots=True)
class Part:
    """One part; both functions take the folder of real sweeps, or None if there is none."""

    record: Callable[[Path | None], None]
    check: Callable[[Path | None], list[str]]


def write_json(path: Path, table: Any) -> None:
    """Write plain values as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(table, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def read_json(path: Path) -> Any:
    """Return the plain values of a JSON file."""
    return json.loads(path.read_text(encoding="utf-8"))


def _facts(part: str) -> dict[str, str]:
    commit = subprocess.run(["git", "rev-parse", "HEAD"], cwd=FOLDER, check=False, capture_output=True, text=True)
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    fields = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    model = " ".join(fields.get(key, "") for key in ("model name", "cpu family", "model"))
    return {
        "command": f"python tools/golden.py record {part}",
        "date": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d"),
        "commit": commit.stdout.strip(),
        "processor": f"{platform.machine()} {model.strip()} (name, family, model)",
    }


def _record_arrays(real_data: Path | None) -> None:
    if real_data is None:
        raise ValueError("recording arrays needs the real sweeps; set VIEWSHED_REAL_DATA to their folder")
    arrays: dict[str, dict[str, recorder.Arrays]] = {method: {} for method in recorder.METHODS}
    about: dict[str, dict[str, Any]] = {}
    for name in recorder.SWEEPS:
        sweep = recorder.sweep_of(name, real_data)
        about[str(name)] = {"grid": name.grid, "returns": len(sweep)}
        sha256 = stored.checksum(name, real_data)
        if sha256 is not None:
            about[str(name)]["sha256"] = sha256
        for method in recorder.methods_of(name):
            arrays[method][str(name)] = recorder.estimate(method, name, sweep)
    for method, estimates in arrays.items():
        stored.save(method, estimates)
    config = recorder.config()
    write_json(stored.MANIFEST, {**_facts("arrays"), "config": config, "sweeps": about})


def _record_shards(_: Path | None) -> None:
    with tempfile.TemporaryDirectory() as folder:
        digests = {name: recorder.shard_digests(name, Path(folder)) for name in recorder.PRESETS}
    write_json(SHARDS, {**_facts("shards"), "presets": digests})


def shard_differences(preset: str, folder: Path) -> list[str]:
    """Return one line for each column of the short shard of a preset that differs from the recorded one."""
    expected, actual = read_json(SHARDS)["presets"][preset], recorder.shard_digests(preset, folder)
    if set(expected) != set(actual):
        return [f"{preset}: frames are {', '.join(actual)}, not {', '.join(expected)}"]
    return [
        f"{preset}, frame {frame}: {column} differs"
        for frame in expected
        for column in sorted({*expected[frame], *actual[frame]})
        if expected[frame].get(column) != actual[frame].get(column)
    ]


def _check_shards(_: Path | None) -> list[str]:
    with tempfile.TemporaryDirectory() as folder:
        return [line for name in recorder.PRESETS for line in shard_differences(name, Path(folder))]


def _check_arrays(real_data: Path | None) -> list[str]:
    if real_data is None:
        raise ValueError("checking arrays needs the real sweeps; set VIEWSHED_REAL_DATA to their folder")
    return stored.differences(recorder.SWEEPS, real_data)


def published() -> dict[str, tables.Page]:
    """Return the tables of the published pages, by page; the overview and the full pages (``_full``) are skipped."""
    paths = [path for path in sorted(RESULTS.glob("*.md")) if path.stem != "index" and not path.stem.endswith("_full")]
    pages = {path.stem: tables.parse(path.read_text(encoding="utf-8")) for path in paths}
    return {name: page for name, page in pages.items() if page}


def _tiny() -> dict[str, tables.Page]:
    with tempfile.TemporaryDirectory() as folder:
        pages = recorder.tiny_pages(Path(folder))
    return {name: tables.without_timings(tables.parse(text)) for name, text in pages.items()}


def _record_tables(kind: str, pages: dict[str, tables.Page]) -> None:
    for old in (TABLES / kind).glob("*.json"):
        old.unlink()
    for name, page in pages.items():
        write_json(TABLES / kind / f"{name}.json", page)


def table_differences(kind: str, pages: dict[str, tables.Page]) -> list[str]:
    """Return one line for each table, header or row that differs from the recorded one."""
    recorded = {path.stem: read_json(path) for path in sorted((TABLES / kind).glob("*.json"))}
    names = [*recorded, *(name for name in pages if name not in recorded)]
    return [line for name in names for line in tables.differences(name, recorded.get(name, {}), pages.get(name, {}))]


PARTS = {
    "arrays": Part(_record_arrays, _check_arrays),
    "shards": Part(_record_shards, _check_shards),
    "published": Part(
        lambda _: _record_tables("published", published()), lambda _: table_differences("published", published())
    ),
    "tiny": Part(lambda _: _record_tables("tiny", _tiny()), lambda _: table_differences("tiny", _tiny())),
}
