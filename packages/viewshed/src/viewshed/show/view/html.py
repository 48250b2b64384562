"""Write the viewer page: frames, style and script in one self-contained HTML file.

``page.html`` has slots ``{{name}}``; ``page.css`` and ``page.js`` fill two of them. Frames are streamed to the file, so
memory does not grow with their number. The file is written atomically.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
from collections.abc import Iterable
from importlib import resources
from pathlib import Path
from typing import Any

from viewshed._files import open_atomic, remove_old_drafts
from viewshed.agents.legend import LEGEND
from viewshed.fov.estimate import CellState
from viewshed.show.plot import COLORS, HEIGHTS_M, WORDS, color_map
from viewshed.show.view.frames import DEVIATION_STEPS, PROBABILITY_STEPS, PackedFrame

UNKNOWN_ON_DARK = (0.17, 0.18, 0.2)
"""Color of UNKNOWN on a dark page, where its light gray would dominate; the other states keep their colors."""

_LEGEND_ORDER = (CellState.FREE, CellState.SURFACE, CellState.HIDDEN, CellState.UNKNOWN)

_PROBABILITY_MAP, _DOUBT_MAP, _HEIGHT_MAP = "cividis", "magma", "viridis"
"""Color maps, the same as in pictures of estimates."""

_SLOT = re.compile(r"\{\{(\w+)\}\}")


def write_page(path: str | Path, frames: Iterable[PackedFrame], title: str) -> int:
    """Write a page of all frames and return its size in bytes.

    Args:
        path: of the HTML file.
        frames: consumed one by one; each is written before the next is taken.
        title: of the page, any text.

    Raises:
        ValueError: there are no frames.
        OSError: the file cannot be written. No partial file remains, also if ``frames`` raises.
    """
    before, after = _filled_page(title)
    count = 0
    remove_old_drafts(Path(path))
    with open_atomic(path) as file:
        file.write(before.encode())
        for frame in frames:
            file.write(_frame_elements(frame))
            count += 1
        if not count:
            raise ValueError(f"frames must be at least one, got none; no page {path} was written")
        file.write(after.encode())
        return file.tell()


def _filled_page(title: str) -> tuple[str, str]:
    """Return the parts of the page before and after its frames."""
    title = title.encode(errors="replace").decode()  # file names may not be valid UTF-8
    script = _text("page.js")
    slots = {
        "title": html.escape(title),
        # The content security policy allows this script only and no network, even if other code got into the page.
        "script_hash": base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
        "style": _text("page.css"),
        "legend": "\n".join(_legend_item(state) for state in _LEGEND_ORDER),
        "track_legend": "\n".join(_track_item(at) for at in range(len(LEGEND))),
        "low_m": f"{HEIGHTS_M[0]:g}",
        "high_m": f"{HEIGHTS_M[1]:g}",
        "height_colors": _gradient(_HEIGHT_MAP),
        "probability_colors": _gradient(_PROBABILITY_MAP),
        "doubt_colors": _gradient(_DOUBT_MAP),
        "settings": json_in_html(_settings()),
        "script": script,
    }
    before, _, after = _text("page.html").partition("{{frames}}")
    return _SLOT.sub(lambda slot: slots[slot[1]], before), _SLOT.sub(lambda slot: slots[slot[1]], after)


def _text(name: str) -> str:
    return resources.files("viewshed.show.view").joinpath(name).read_text(encoding="utf-8")


def _settings() -> dict[str, Any]:
    """Return the script's settings: states with their colors by theme, color maps and scales."""
    maps = {"probability": _PROBABILITY_MAP, "doubt": _DOUBT_MAP, "deviation": _DOUBT_MAP, "height": _HEIGHT_MAP}
    return {
        "states": [{"name": state.name, "light": _light(state), "dark": _dark(state)} for state in CellState],
        "maps": {layer: base64.b64encode(color_map(name).tobytes()).decode() for layer, name in maps.items()},
        "heights_m": list(HEIGHTS_M),
        "steps": PROBABILITY_STEPS,
        "deviation_steps": DEVIATION_STEPS,
        "tracks": [{"word": item.word, "color": f"rgb{tuple(_bytes(item.color))}"} for item in LEGEND],
    }


def _legend_item(state: CellState) -> str:
    colors = f"--light: rgb{tuple(_light(state))}; --dark: rgb{tuple(_dark(state))}"
    swatch = f'<span class="state swatch" style="{colors}"></span>'
    return f'        <li data-layer="states">{swatch}<span>{html.escape(WORDS[state])}</span></li>'


def _track_item(at: int) -> str:
    """Return the legend item of an explanation of tracks; the page shows it if it has such tracks."""
    word, color = LEGEND[at]
    swatch = f'<span class="swatch" style="background: rgb{tuple(_bytes(color))}"></span>'
    return f'        <li data-layer="tracks" data-track="{at}">{swatch}<span>track: {html.escape(word)}</span></li>'


def _gradient(name: str) -> str:
    """Return a color map as a CSS gradient from left to right."""
    stops = [f"rgb{tuple(color)}" for color in color_map(name)[::51].tolist()]
    return f"linear-gradient(to right, {', '.join(stops)})"


def _light(state: CellState) -> list[int]:
    return _bytes(COLORS[state])


def _dark(state: CellState) -> list[int]:
    return _bytes(UNKNOWN_ON_DARK if state == CellState.UNKNOWN else COLORS[state])


def _bytes(color: tuple[float, float, float]) -> list[int]:
    return [round(255 * share) for share in color]


def _frame_elements(frame: PackedFrame) -> bytes:
    """Return a frame as two inert script elements, which the page reads when it shows the frame."""
    about, data = json_in_html(frame.about), base64.b64encode(frame.data).decode()
    return (
        f'<script type="application/json" class="about">{about}</script>\n'
        f'<script type="text/plain" class="data">{data}</script>\n'
    ).encode()


def json_in_html(value: Any) -> str:
    r"""Return a value as JSON that can neither close its HTML element nor open another.

    >>> json_in_html({"name": "</script>&"})
    '{"name":"\\u003c/script\\u003e\\u0026"}'
    """
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
