"""Hooks of mkdocs, and tables that pages of the documentation take from code and results.

``python tools/docs_site.py`` rewrites each table between ``<!-- generated: NAME -->`` and ``<!-- end of NAME -->`` by
the function of that name in ``GENERATED``. In the site, each notebook becomes a page with its stored outputs, the
site's name shows the version, and the header links the repository if the checkout has a remote.
"""

from __future__ import annotations

import base64
import json
import math
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

import results_index

import viewshed
from viewshed_lab._page import table
from viewshed_lab._results import KeyNumber

ROOT = Path(__file__).resolve().parents[1]
MARK = re.compile(r"^<!-- generated: (\w+) -->\n(?:.*?\n)?<!-- end of \1 -->$", re.MULTILINE | re.DOTALL)
TUTORIAL_SWEEP = "kitti/odometry00/000000.bin"
"""Sweep of the tutorial, below the folder of real sweeps."""
RESULTS = ("gallery.md", "first_hour.md", "release.md")
"""Pages written entirely by commands."""
RINGS, POINTS = "road, car #3", "road, car #4"
"""Headings of two tables for cars on roads in ``docs/results/wild.md``: with rings and intensity, and points alone."""
ELSEWHERE = {
    "contribute/contributing.md": "CONTRIBUTING.md",
    "contribute/core.md": "packages/viewshed/src/core/README.md",
    "contribute/changes.md": "CHANGELOG.md",
    "reference/ros_node.md": "ros/viewshed_ros/README.md",
}
"""Page of the site → file outside of ``docs`` that it shows."""


# What mkdocs calls.


def on_config(config: Any) -> Any:
    """Set the site's name with the version, and its link to the repository of the checkout's remote."""
    config.site_name = f"viewshed {viewshed.__version__}"
    command = ["git", "-C", str(ROOT), "remote", "get-url", "origin"]
    origin = subprocess.run(command, check=False, capture_output=True, text=True).stdout.strip()
    if origin.startswith("https://"):
        config.repo_url = origin.removesuffix(".git")
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add a page for each notebook with its pictures, and the pages of ``ELSEWHERE``."""
    from mkdocs.structure.files import File

    for file in [file for file in files if file.src_uri.endswith(".ipynb")]:
        text, pictures = page_of_notebook(Path(file.abs_src_path))
        files.append(File.generated(config, file.src_uri.replace(".ipynb", ".md"), content=text))
        for name, content in pictures.items():
            files.append(File.generated(config, f"{Path(file.src_uri).parent}/{name}", content=content))
    for page, path in ELSEWHERE.items():
        text = re.sub(r"\]\((\.\./)*docs/", "](../", (ROOT / path).read_text(encoding="utf-8"))
        for other, place in ELSEWHERE.items():
            text = text.replace(f"]({place})", f"](../{other})")
        files.append(File.generated(config, page, content=text))
    return files


def on_page_markdown(markdown: str, page: Any = None, **_: Any) -> str:
    """Replace links to notebooks and files of ``ELSEWHERE`` by links to their pages; add all options to ``cli.md``."""
    if results_index.MARK in markdown:
        markdown = results_index.with_overview(markdown)
    for own, path in ELSEWHERE.items():
        markdown = markdown.replace(f"](../{path})", f"]({own})")
    options = f"\n\n{commands()}" if page is not None and page.file.src_uri == "cli.md" else ""
    return markdown.replace(".ipynb)", ".md)") + options


def on_page_content(html: str, **_: Any) -> str:
    """Link each picture to itself: most pictures are wider than the page."""
    return re.sub(r'<img [^>]*src="([^"]+)"[^>]*>', r'<a href="\1">\g<0></a>', html)


# Notebooks.


def page_of_notebook(path: Path) -> tuple[str, dict[str, bytes]]:
    """Return a notebook with its stored outputs as Markdown, and its pictures (PNG) by name."""
    blocks: list[str] = []
    pictures: dict[str, bytes] = {}
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        blocks.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for output in cell.get("outputs", []):
            if "image/png" in output.get("data", {}):
                name = f"{path.stem}_{len(pictures)}.png"
                pictures[name] = base64.b64decode(output["data"]["image/png"])
                blocks.append(f"![Output of the cell above]({name})")
        if printed := printed_by(cell):
            blocks.append(f"```text\n{printed.rstrip()}\n```")
    return "\n\n".join(blocks) + "\n", pictures


def printed_by(cell: Any) -> str:
    """Return the stored text output of a notebook's cell, without pictures."""
    outputs = [output for output in cell.get("outputs", []) if "image/png" not in output.get("data", {})]
    return "".join("".join(o.get("text") or o.get("data", {}).get("text/plain", "")) for o in outputs)


# Tables.


def command_names() -> list[str]:
    """Return the commands that ``--help`` lists; a command of a group follows the group's name (``study paper``)."""
    from typer.main import get_command

    from viewshed.cli import application

    return list(_names(get_command(application())))


def _names(group: Any, prefix: str = "") -> Iterator[str]:
    for name, command in group.commands.items():
        if getattr(command, "commands", None):
            yield from () if command.hidden else _names(command, f"{prefix}{name} ")
        elif not command.hidden:
            yield f"{prefix}{name}"


@cache
def commands() -> str:
    """Return the ``--help`` text of every command as Markdown."""
    from typer.testing import CliRunner

    from viewshed.cli import application

    runner = CliRunner()
    shown = {
        name: runner.invoke(application(), [*name.split(), "--help"], prog_name="viewshed").stdout
        for name in command_names()
    }
    return "\n\n".join(f"## viewshed {name}\n\n```text\n{text.strip()}\n```" for name, text in shown.items())


def command_table() -> str:
    """Return the table of commands with the first sentence of their help."""
    summaries = re.findall(r"^## viewshed (.*)\n\n```text\nUsage: (?:.+\n)+\n +(.*?\.)\s", commands(), re.MULTILINE)
    return table(("command", "does"), [[f"`{name}`", summary] for name, summary in summaries])


def attacks() -> str:
    """Return the table of attacks: family, name, mode, effect, and defaults of their own parameters."""
    from viewshed import Sweep
    from viewshed_lab.threats.attacks import ATTACKS, FAMILY, FREE_FORM, INFORMED, WHOLE_CLOUD, Knowledge

    common = {"spoofer", "mode", "earlier", "first", "first_ns"}
    knowledge = Knowledge((Sweep([[1.0, 0.0, 0.0]]),))  # type: ignore[arg-type]
    rows = []
    for name, make in (ATTACKS | INFORMED | WHOLE_CLOUD).items():
        attack: Any = make(None, knowledge)
        defaults = ", ".join(
            f"`{f.name}` {_text(getattr(attack, f.name))}" for f in fields(attack) if f.name not in common
        )
        what = str(type(attack).__doc__).splitlines()[0].split(": ")[0].removesuffix(".")
        mode = "free-form" if name in FREE_FORM else "–" if name in {"pose_spoof", *WHOLE_CLOUD} else "on beams"
        rows.append([str(FAMILY[name]), f"`{name}`", mode, what, defaults])
    return table(("family", "name", "mode", "what", "defaults"), rows)


def corruptions() -> str:
    """Return the table of each corruption's parameters at its five severities."""
    from viewshed_lab.threats.corruptions import SEVERITIES, Weather

    weather = ("extinction_per_m", "particles_per_m", "particle_reach", "wet", "noise")
    rows = []
    for name, steps in SEVERITIES.items():
        values: list[Any] = [step.conditions if isinstance(step, Weather) else step for step in steps]
        keys = weather if isinstance(steps[0], Weather) else [field.name for field in fields(values[0])]
        rows += [[f"`{name}`", f"`{key}`", *(_text(getattr(value, key)) for value in values)] for key in keys]
    return table(("name", "parameter", "1", "2", "3", "4", "5"), rows)


def defenses() -> str:
    """Return the table of each defense's parameters and defaults."""
    from viewshed_lab.threats.defenses import DEFENSES

    rows = []
    for name, make in DEFENSES.items():
        defense: Any = make()
        values = {field.name: getattr(defense, field.name) for field in fields(defense) if field.init}
        rows += [[f"`{name}`", f"`{k}`", f"{v:g}"] for k, v in values.items() if isinstance(v, int | float)]
    return table(("name", "parameter", "default"), rows)


def worlds() -> str:
    """Return the table of simulated worlds, described by the docstring of their function or, failing that, module."""
    from viewshed_lab.sim.worlds import WORLDS

    return table(("kind", "what is there"), [[f"`{name}`", _first_line(make)] for name, make in WORLDS.items()])


def _first_line(make: Any) -> str:
    from importlib import import_module

    _, _, more = str(make.__doc__).partition("\n\n")
    return (more or str(import_module(make.__module__).__doc__)).strip().splitlines()[0].removesuffix(".")


def materials() -> str:
    """Return the table of the materials of simulated worlds."""
    from viewshed_lab.sim.assets.shapes import MATERIALS

    rows = [
        [material.name, f"{material.reflectivity:g}", "–" if math.isinf(material.per_m) else f"{material.per_m:g}"]
        for material in MATERIALS
    ]
    return table(("material", "reflectivity", "stops per meter"), rows)


def weather() -> str:
    """Return the table of the simulator's weather and faults, with the parameters that differ from clear air."""
    from viewshed_lab.sim.lidar.weather import CONDITIONS

    names, clear = [field.name for field in fields(CONDITIONS["clear"])], CONDITIONS["clear"]
    keys = [key for key in names if any(getattr(air, key) != getattr(clear, key) for air in CONDITIONS.values())]
    rows = [[f"`{name}`", *(f"{getattr(air, key):g}" for key in keys)] for name, air in CONDITIONS.items()]
    return table(("name", *(f"`{key}`" for key in keys)), rows)


def sensors() -> str:
    """Return the table of sensors: rings, elevations, range, reach, simulated noise, and source of the beam table."""
    from viewshed.sensors import lidar_model, sensor_names
    from viewshed_lab.sim.lidar.optics import optics_of

    rows = []
    for name in sensor_names():
        model, optics = lidar_model(name), optics_of(lidar_model(name))
        low, high = (round(math.degrees(elevation), 1) for elevation in model.elevation[[0, -1]])
        rows.append([
            f"`{name}`", str(model.rings) if model.fires_rings else "no rings", f"{low:g}…{high:g}°",
            f"{model.min_range_m:g}–{model.max_range_m:g}", "–" if model.reach_m is None else f"{model.reach_m:g}",
            f"{1e3 * optics.sigma_m:g}", "yes" if model.inferred else "no", model.source,
        ])  # fmt: skip
    header = ("name", "rings", "elevations", "range, m", "reach, m", "noise, mm", "inferred", "from")
    return table(header, rows)


def _text(value: object) -> str:
    if isinstance(value, tuple):
        return "(" + ", ".join(_text(part) for part in value) + ")"
    return f"{value:g}" if isinstance(value, float) else str(value)


# Tables of figures, read from the pages of results.


def methods() -> str:
    """Return the table of precision, recall and F1 of each method in ``wild.md``, on its own and on other worlds."""
    columns = ("own: precision / recall", "own: F1", "other: precision / recall", "other: F1")
    rows = []
    for name in [name for name in viewshed.ESTIMATORS if f"\n| {name} |" in _result("wild")]:
        own, own_f1, other, f1 = (_cell("wild", RINGS, f"{name} |", column) for column in columns)
        rows.append((f"`{name}`", *own.split(" / "), own_f1.split()[0], *other.split(" / "), f1.split()[0]))
    header = ("method", "own: precision", "recall", "F1", "other: precision", "recall", "F1")
    return table(header, sorted(rows, key=lambda row: -float(row[-1])))


def figures() -> str:
    """Return the table of the README: question, command, figure, data and inputs, from the pages of results."""
    doubt = _headline("calibration", "AUROC of its doubt").split(" → ")[1]
    over = _headline("crossview", "claimed though hidden, of the hidden columns, `shadow_map`, HDL-64E")
    caught = _cell("monitor", "What is caught", "mean of the attacks", "caught in .5 s at 6 alarms an hour")
    false = _cell("monitor", "By place", "all |", "an hour, limit of 6")
    speed, real_speed = _headline("speed", "`shadow_map`, 35k"), _headline("speed", "the same of a real sweep")
    lines = [
        ("Would a car there be seen?", "estimate FILE", _seen(RINGS), "simulated",
         "rings; no sensor, no height", "wild"),
        ("… of bare points?", "estimate FILE", _seen(POINTS), "simulated", "points alone", "wild"),
        ("Is hidden ground claimed?", "evaluate crossview INDEX", f"{over} columns", "real, HDL-64E",
         "points, poses", "crossview"),
        ("Which answers are wrong?", "estimate FILE", f"AUROC of the doubt {doubt}", "simulated",
         "rings; no sensor, no height", "calibration"),
        ("Is someone lying?", "monitor check DRIVE",
         f"{caught} of the attacks caught in .5 s, {false} false alarms an hour",
         "simulated, unseen places and attacks", "a limit for 6 an hour", "monitor"),
        ("How fast, one thread?", "estimate FILE", f"{speed} ms of 35k points; real: {real_speed} ms",
         "simulated; real", "rings", "speed"),
    ]  # fmt: skip
    rows = [
        (f"[{question}](docs/results/{page}.md)", f"`viewshed {command}`", figure, where, given)
        for question, command, figure, where, given, page in lines
    ]
    return table(("question", "command", "figure", "measured on", "what was given"), rows)


def _headline(page: str, words: str) -> str:
    """Return the bold number of the line with these words, from the list at the top of a page of results."""
    match = re.search(rf"^- \*\*(.*?)\*\* .*{re.escape(words)}", _result(page), re.MULTILINE)
    if match is None:
        raise ValueError(f"docs/results/{page}.md must have a line '- **NUMBER** … {words}' at its top")
    return match[1]


def _cell(page: str, heading: str, row: str, column: str) -> str:
    """Return a cell of the table below a heading of a page of results: first row that begins with ``row``."""
    cell = KeyNumber("", heading, row, column).find(_result(page))
    if cell is None:
        raise ValueError(f"docs/results/{page}.md must have a row {row!r} with {column!r} below {heading!r}")
    return cell


def _seen(heading: str) -> str:
    """Return precision, recall and F1 of the default method on other worlds, in words."""
    precision, recall = _cell("wild", heading, "shadow_map", "other: precision / recall").split(" / ")
    return f"precision {precision}, recall {recall}, F1 {_cell('wild', heading, 'shadow_map', 'other: F1')}"


def _result(page: str) -> str:
    return (ROOT / "docs" / "results" / f"{page}.md").read_text(encoding="utf-8")


GENERATED: dict[str, Callable[[], str]] = {
    make.__name__: make
    for make in (
        command_table, attacks, corruptions, defenses, worlds, materials, weather, sensors, methods, figures
    )
}  # fmt: skip


def with_tables(markdown: str) -> str:
    """Return a page with its generated tables rewritten."""
    return MARK.sub(
        lambda mark: f"<!-- generated: {mark[1]} -->\n{GENERATED[mark[1]]()}\n<!-- end of {mark[1]} -->", markdown
    )


def words() -> int:
    """Count the words of ``docs/*.md``, without pages and tables that are generated."""
    pages = [path for path in sorted((ROOT / "docs").glob("*.md")) if path.name not in RESULTS]
    return sum(len(MARK.sub("", path.read_text(encoding="utf-8")).split()) for path in pages)


# The tutorial.


def transcript(text: str, folder: Path) -> str:
    """Return a page with the output of its commands, run in a folder.

    Commands are the lines of ``console`` blocks that begin with ``$``, whose output is written below, and the lines of
    ``sh`` blocks, whose output is not shown.
    """

    def rerun(block: re.Match[str]) -> str:
        if block["kind"] == "sh":
            for line in block["lines"].splitlines():
                _print(line, folder)
            return block[0]
        commands = re.findall(r"^\$ (.*)", block["lines"], re.MULTILINE)
        return "```console\n" + "".join(f"$ {command}\n{_print(command, folder)}" for command in commands)

    return re.sub(r"^```(?P<kind>sh|console)\n(?P<lines>.*?)(?=^```)", rerun, text, flags=re.MULTILINE | re.DOTALL)


def _print(command: str, folder: Path) -> str:
    """Run a command ``viewshed …`` in a folder; return its output without the folder's path."""
    program = [sys.executable, "-c", "import sys; from viewshed.cli import main; sys.argv[0] = 'viewshed'; main()"]
    done = subprocess.run(
        [*program, *shlex.split(command)[1:]], cwd=folder, check=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        text=True,
    )  # fmt: skip
    return done.stdout.replace(f"{folder}/", "")


def main() -> None:
    """Rewrite the generated tables of the pages, and the tutorial if its real sweep exists."""
    for path in [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]:
        before = path.read_text(encoding="utf-8")
        if (after := with_tables(before)) != before:
            path.write_text(after, encoding="utf-8")
    sweep = Path(os.environ.get("VIEWSHED_REAL_DATA", ROOT / ".." / "shared" / "data"), TUTORIAL_SWEEP)
    if sweep.is_file():
        page = ROOT / "docs" / "tutorial.md"
        with tempfile.TemporaryDirectory() as folder:
            shutil.copy(sweep, folder)
            page.write_text(transcript(page.read_text(encoding="utf-8"), Path(folder)), encoding="utf-8")
    print(f"{words()} words to read in docs/*.md")


if __name__ == "__main__":
    main()
