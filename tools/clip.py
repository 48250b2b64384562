"""A clip of a page of ``viewshed view``: its frames, agents or layers side by side, as animated WebP.

    viewshed record sim --world junction --agents 3 --seconds 30 --hz 2 --to drive.mcap
    viewshed view drive.mcap --html run.html
    python tools/clip.py run.html docs/assets/agents.webp [--seconds 30] [--side 320]

    viewshed view PANDASET/*.bin --file-frame pandaset --html three.html
    python tools/clip.py three.html docs/assets/real.webp --layers states,doubt --pace 2.5 --side 400

The page draws every frame itself, in a headless Chromium, and its canvas is what the clip shows.
"""

from __future__ import annotations

import argparse
import base64
import io
import json
import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from browser import Browser, open_browser
from PIL import Image

from viewshed.show._canvas import Canvas

_HEAD = 46
"""Pixels above a picture for its two lines."""


@dataclass(frozen=True, slots=True)
class Shown:
    """A frame of the page."""

    number: int  # of the frame on the page
    agent: str  # whose sweep it is
    name: str  # of the sweep
    time_s: float  # since the first frame
    visible_m2: float  # of the estimate


def frames_of(browser: Browser) -> list[Shown]:
    """Return the frames of the open page, in its order."""
    rows = json.loads(
        browser.value(
            "JSON.stringify(abouts.map((about, k) => [about.agent, about.name, seconds[k], about.visible_m2]))"
        )
    )
    return [Shown(number, *row) for number, row in enumerate(rows)]


def steps(frames: list[Shown], max_s: float) -> list[dict[str, Shown]]:
    """Return the latest frame of each agent at each time, from the first time at which all have one up to ``max_s``.

    >>> a, b, c = Shown(0, "x", "", 0.0, 1.0), Shown(1, "y", "", 0.1, 1.0), Shown(2, "x", "", 1.0, 1.0)
    >>> [[shown.number for shown in step.values()] for step in steps([a, b, c], 30.0)]
    [[0, 1], [2, 1]]
    """
    agents = {frame.agent for frame in frames}
    latest: dict[str, Shown] = {}
    states = []
    for frame in frames:
        latest[frame.agent] = frame
        if len(latest) == len(agents) and frame.time_s <= max_s:
            states.append(dict(sorted(latest.items())))
    # Agents measure within a revolution of each other: keep one step per frame of the first agent.
    return [step for k, step in enumerate(states) if k == 0 or _first(step).number != _first(states[k - 1]).number]


def _first(step: dict[str, Shown]) -> Shown:
    return next(iter(step.values()))


def picture(browser: Browser, frame: Shown, side: int, layer: str, heading: tuple[str, str]) -> Image.Image:
    """Return the page's picture of a frame in a layer, below a heading of two lines."""
    browser.value(f"document.querySelector('#bases input[value={layer}]').click()")
    browser.value(f"show({frame.number})")
    browser.wait_for(f"current === {frame.number} && element('sweep').textContent.startsWith('{frame.number + 1} of')")
    address = str(browser.value("map.toDataURL('image/png')"))
    canvas = Image.open(io.BytesIO(base64.b64decode(address.partition(",")[2])))
    # The grid is the square in the middle of the canvas, which has no background.
    edge = min(canvas.size)
    left, top = (canvas.width - edge) // 2, (canvas.height - edge) // 2
    square = canvas.crop((left, top, left + edge, top + edge)).resize((side, side), Image.Resampling.LANCZOS)
    page = Canvas.blank(side, side + _HEAD)
    page.text((6, 18), heading[0], 10, bold=True)
    page.text((6, 38), heading[1], 9)
    image = Image.fromarray(page.pixels())
    image.paste(square, (0, _HEAD), square if square.mode == "RGBA" else None)
    return image


_LAYERS = {
    "states": "free blue, surface orange, hidden gray, unknown light",
    "probability": "probability that a target would be seen",
    "doubt": "doubt: probability that the answer is wrong",
}


def _heading(frame: Shown, layer: str, is_timed: bool) -> tuple[str, str]:
    """Return the heading of a picture: agent and time of a drive, or sweep and layer."""
    if is_timed:
        return frame.agent.partition("/")[0], f"{frame.time_s:.1f} s · sees {frame.visible_m2:,.0f} m²"
    return f"{frame.name} · sees {frame.visible_m2:,.0f} m²", _LAYERS.get(layer, layer)


def main() -> int:
    """Write the clip; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("page", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--side", type=int, default=320)
    parser.add_argument("--layers", default="states", help="of the cells, with commas; several stand side by side")
    parser.add_argument(
        "--pace", type=float, help="seconds that each frame is shown, in place of the sweeps' own times"
    )
    arguments = parser.parse_args()
    pictures = []
    with open_browser() as browser:
        browser.window(1200, 900)
        browser.open(arguments.page.resolve().as_uri())
        browser.wait_for("typeof abouts !== 'undefined' && element('sweep').textContent !== ''")
        shown = steps(frames_of(browser), arguments.seconds)
        for step in shown:
            tiles = [
                picture(browser, frame, arguments.side, layer, _heading(frame, layer, arguments.pace is None))
                for frame in step.values()
                for layer in arguments.layers.split(",")
            ]
            strip = Image.new("RGB", ((arguments.side + 8) * len(tiles) - 8, arguments.side + _HEAD), "white")
            for number, tile in enumerate(tiles):
                strip.paste(tile, (number * (arguments.side + 8), 0))
            pictures.append(strip)
    times_ms = [round(1000 * _first(step).time_s) for step in shown]
    durations_ms = [after - before for before, after in pairwise(times_ms)] or [1000]
    durations_ms.append(durations_ms[-1])
    if arguments.pace is not None:
        durations_ms = [round(1000 * arguments.pace)] * len(shown)
    first, *more = pictures
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    durations_ms = durations_ms[: len(pictures)]
    first.save(arguments.out, save_all=True, append_images=more, duration=durations_ms, quality=60, loop=0)
    size = arguments.out.stat().st_size / 1e6
    print(f"{arguments.out}: {len(pictures)} pictures, {sum(durations_ms) / 1000:.1f} s, {size:.2f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
