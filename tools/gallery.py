"""The gallery of real situations: one picture each by the default estimator, with its source, license and summary.

    python tools/gallery.py FOLDER [--out docs]

``FOLDER`` holds ``data`` (sweeps with an ``index.json``) and ``recordings``. Writes ``gallery.md`` and
``assets/gallery/NAME.png``; the situations and what their pictures show stand in ``tools/gallery.toml``.
"""

from __future__ import annotations

import argparse
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

from viewshed import FovEstimate, read_sweep
from viewshed._files import write_atomic
from viewshed.cli._outputs import summary_line
from viewshed.estimators import load_estimator
from viewshed.io import read_index, read_indexed
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sweep import Sweep
from viewshed_lab._page import facts, page

_ABOUT = """Ten real sweeps, each as `viewshed estimate FILE` draws it. Sweeps of nuScenes, KITTI and Argoverse 2 are
left out, because their licenses forbid commercial use; no point cloud is published here.

The left picture is a map from above, forward up: free, surface, hidden and unknown cells. The right pictures show the
probability that a car there would be seen (in rooms a person), and the probability that this answer is wrong. The
lines above state the sensor's height, how it is known, and how much of the view lies over ground that was not seen.
Scales are the same in all pictures."""


_CLIP = """## Three vehicles at a junction

![Thirty seconds of what each of three vehicles sees, side by side](assets/agents.webp)

Simulated, thirty seconds. The commands that made it:

```sh
viewshed record sim --world junction --agents 3 --seconds 30 --hz 2 --to drive.mcap
viewshed view drive.mcap --html run.html
python tools/clip.py run.html docs/assets/agents.webp --side 300
```"""


@dataclass(frozen=True, slots=True)
class Situation:
    """One picture of the gallery."""

    name: str  # of the picture's file
    title: str  # of its section
    folder: str  # ``data`` or ``recordings``
    file: str  # below that folder
    shows: str  # what the picture shows, for the reader
    source: str  # author, sensor and license of the recording
    grid: str = "road"  # name of the grid
    target: str = "car"  # name of the target


def situations() -> list[Situation]:
    """Return the situations of ``gallery.toml``."""
    table = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    return [Situation(**entry) for entry in table["situation"]]


def estimate_of(situation: Situation, folder: Path) -> tuple[LeveledSweep, FovEstimate]:
    """Return the leveled sweep of a situation and its estimate."""
    estimator = load_estimator(grid=situation.grid, target=situation.target)
    leveled = level(_sweep_of(situation, folder), estimator.grid)
    return leveled, estimator.estimate(leveled)


def _sweep_of(situation: Situation, folder: Path) -> Sweep:
    path = folder / situation.folder / situation.file
    index = folder / situation.folder / "index.json"
    if situation.folder == "data":
        return next(read_indexed(entry) for entry in read_index(index) if entry.file == path.resolve())
    return read_sweep(path)


def main() -> int:
    """Draw the pictures and write the page; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs"))
    arguments = parser.parse_args()
    pictures = arguments.out / "assets" / "gallery"
    pictures.mkdir(parents=True, exist_ok=True)
    parts = [_ABOUT]
    for number, situation in enumerate(situations()):
        leveled, estimate = estimate_of(situation, arguments.folder.resolve())
        line = summary_line(estimate)
        write_atomic(pictures / f"{situation.name}.png", estimate.plot(leveled, f"{situation.title}\n{line}"))
        parts += [
            f"## {situation.title}",
            f"![{situation.title} from above](assets/gallery/{situation.name}.png)",
            f"{situation.shows}\n\n*{situation.source}.*",
        ]
        if number == 0:
            write_atomic(
                pictures / f"{situation.name}_dark.png", estimate.plot(leveled, f"{situation.title}\n{line}", dark=True)
            )
            parts += [
                "The same on a dark page (`--dark`):",
                f"![{situation.title} on a dark page](assets/gallery/{situation.name}_dark.png)",
            ]
        print(f"{situation.name}: {line}", flush=True)
    parts.append(_CLIP)
    text = page("Gallery: ten real situations", facts(command="`python tools/gallery.py FOLDER`"), *parts)
    write_atomic(arguments.out / "gallery.md", text.encode())
    return 0


if __name__ == "__main__":
    sys.exit(main())
