"""Pictures of a center's fusion of several agents: joint view, believed objects, and contradictions between agents."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Sequence
from colorsys import hls_to_rgb
from dataclasses import replace
from itertools import permutations
from textwrap import wrap

import numpy as np
from numpy.typing import NDArray

from viewshed.agents.registration import surface_cells
from viewshed.agents.report import AgentReport
from viewshed.agents.rounds import Round
from viewshed.agents.view_evidence import FARTHEST_M, NEAREST_M, SAME_GROUND_M
from viewshed.arrays import F64
from viewshed.fov.estimate import CellState
from viewshed.objects.matching import corners_of
from viewshed.show._canvas import BLACK, WHITE, Canvas, Color
from viewshed.show.plot import Panel, map_picture

SIDE, STRIP_SIDE, MARGIN, COLUMN = 720, 520, 20, 380
"""Sizes in pixels: the map, each map of a strip, the margin, and the column of text."""

TRUSTED, DOUBTED, DISTRUSTED, QUIET = (20, 140, 40), (235, 150, 0), (214, 39, 40), (120, 120, 130)
"""Colors of agents and objects: believed, in between, not believed; and of those only their neighbors report."""

CONTRADICTION_NATS = 3.0
"""Two views contradict each other if their comparison is at least this rare."""

MAX_OUTLINED = 5
"""Views are outlined for up to this many agents; more lines hide each other."""

_MIN_AREA_M2 = 20.0
"""Smaller pieces of a view are not outlined."""

_LINE, _LETTERS = 20, 54
"""Line spacing of text in pixels, and maximum letters of a line."""


def color_of(trust: float) -> Color:
    """Return the color of a probability of trust or existence.

    >>> color_of(0.9) == TRUSTED, color_of(0.5) == DOUBTED, color_of(0.1) == DISTRUSTED
    (True, True, True)
    """
    return TRUSTED if trust >= 0.7 else DOUBTED if trust >= 0.3 else DISTRUSTED


def agent_color(number: int, agents: int) -> Color:
    """Return the color of an agent's own lines, from cyan to purple, distinct from the colors of trust."""
    hue = (170.0 + 150.0 * number / max(agents - 1, 1)) / 360.0
    red, green, blue = (round(255 * part) for part in hls_to_rgb(hue, 0.4, 0.7))
    return red, green, blue


def claimed_free(claims: AgentReport, other: AgentReport) -> F64:
    """Return world positions (K, 2) of another agent's surfaces that ``claims`` says are free, on the same ground."""
    own = surface_cells(other.estimate, NEAREST_M, FARTHEST_M)
    pose = other.world_from_level
    world: F64 = own @ pose.rotation[:2, :2].T + pose.translation[:2]
    level = claims.in_level(world)
    cells, inside = claims.estimate.grid.index(level)
    is_free = inside & (claims.estimate.state[cells[:, 0], cells[:, 1]] == CellState.FREE)
    claimed: F64 = world[is_free & (np.abs(claims.ground_m(level) - other.ground_m(own)) < SAME_GROUND_M)]
    return claimed


def contradictions(done: Round) -> list[tuple[int, int, str]]:
    """Return the pairs of agents that contradict each other, as indices, and the subject of each contradiction.

    Objects: one agent reports an object that the other should see and denies. Views: see ``Verdicts.against``.
    """
    picture, names = done.picture, done.picture.agents
    denied = picture.reporters[:, :, None] & picture.deniers[:, None]
    against = picture.verdicts.against
    pairs = []
    for one in range(len(names)):
        for other in range(one + 1, len(names)):
            ids = picture.tracks.ids[denied[:, one, other] | denied[:, other, one]].tolist()
            parts = [f"objects {', '.join(map(str, ids[:4]))}{' …' if len(ids) > 4 else ''}"] if ids else []
            parts += ["views"] if against[one, other] >= CONTRADICTION_NATS else []
            if parts:
                pairs.append((one, other, " and ".join(parts)))
    return pairs


def _map_of(done: Round, pairs: list[tuple[int, int, str]], side: int) -> Canvas:
    """Return the map of a round, ``side`` pixels wide: joint view, agents, objects, lines between pairs."""
    picture, joint = done.picture, done.joint
    panel = Panel(replace(joint.estimate(done.t_ns), agent=""), "")
    area = map_picture(panel, side)
    half_m, middle = joint.grid.half_extent_m, joint.world_from_grid.translation[:2]

    def pixels(xy_m: NDArray[np.float64]) -> list[tuple[float, float]]:
        """Return (column, row) of world positions; x points up, y to the left."""
        row_column = (half_m - (np.atleast_2d(xy_m) - middle)) * side / (2 * half_m)
        return [(float(column), float(row)) for row, column in row_column]

    places = {report.agent: report.world_from_level.translation[:2] for report in done.reports}
    trust = dict(zip(picture.agents, picture.verdicts.trust.tolist(), strict=True))
    own_colors = _own_colors(done)
    # 1. Outline of each view.
    if _is_outlined(done):
        for report in done.reports:
            pose = report.world_from_level
            for piece in report.estimate.polygon().geoms:
                if piece.area >= _MIN_AREA_M2:
                    ring = np.array(piece.exterior.coords) @ pose.rotation[:2, :2].T + pose.translation[:2]
                    area.line(pixels(ring), own_colors[report.agent], 2)
    # 2. Surfaces of one agent that another claims to be free, if their views contradict each other.
    numbers = {report.agent: picture.agents.index(report.agent) for report in done.reports}
    for claims, other in permutations(done.reports, 2) if _is_outlined(done) else ():
        if picture.verdicts.against[numbers[claims.agent], numbers[other.agent]] >= CONTRADICTION_NATS:
            for x, y in pixels(claimed_free(claims, other)):
                area.rectangle((x - 1.5, y - 1.5, x + 1.5, y + 1.5), DISTRUSTED)
    # 3. Lines between agents that contradict each other.
    for first, second, _ in pairs:
        ends = [places.get(picture.agents[index]) for index in (first, second)]
        if ends[0] is not None and ends[1] is not None:
            area.polygon(pixels(np.stack([ends[0], ends[1]])), DISTRUSTED, grow=1.2)
    # 4. Outlines of objects that are reported or believed.
    for number in np.flatnonzero(picture.reported | picture.believed):
        color = color_of(float(picture.existence[number]))
        corners = pixels(corners_of(picture.tracks.boxes[[number]])[0])
        for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
            area.polygon([start, end], color, grow=1.0)
        area.text((corners[0][0] + 3, corners[0][1] - 3), str(picture.tracks.ids[number]), 6)
    # 5. Agents: a disc in the color of the agent's trust, and its name.
    for agent, xy in places.items():
        [(column, row)] = pixels(xy)
        turn = np.linspace(0.0, 2 * np.pi, 17)[:-1]
        disc = [(column + 7 * float(np.cos(t)), row + 7 * float(np.sin(t))) for t in turn]
        area.polygon(disc, WHITE, grow=2.0)
        area.polygon(disc, color_of(trust[agent]))
        area.text((column + 11, row + 4), agent, 8, bold=True)
    return area


def _is_outlined(done: Round) -> bool:
    return len(done.reports) <= MAX_OUTLINED


def _own_colors(done: Round) -> dict[str, Color]:
    agents = sorted(done.picture.agents)
    return {name: agent_color(number, len(agents)) for number, name in enumerate(agents)}


def fused_strip(rounds: Sequence[Round]) -> bytes:
    """Return a PNG of several rounds side by side: the map of each above the list of agents with their trust."""
    rows = max(len(done.picture.agents) for done in rounds)
    page = Canvas.blank(len(rounds) * (STRIP_SIDE + MARGIN) + MARGIN, STRIP_SIDE + 2 * MARGIN + 30 + (rows + 1) * _LINE)
    for number, done in enumerate(rounds):
        left, top = MARGIN + number * (STRIP_SIDE + MARGIN), MARGIN + 12
        page.text((left, top), f"{done.picture.t_s:.2f} s", 11, bold=True)
        page.paste(_map_of(done, contradictions(done), STRIP_SIDE), left, MARGIN + 30)
        top += STRIP_SIDE + 30 + _LINE
        _write_agents(page, done, left, top)
    return page.png()


def _write_agents(page: Canvas, done: Round, left: int, top: int) -> int:
    """Draw the list of agents with their trust at (left, top), and return the row below it."""
    own_colors, heard = _own_colors(done), {report.agent for report in done.reports}
    for at, agent in enumerate(done.picture.agents):
        trust = float(done.picture.verdicts.trust[at])
        word = "accused" if done.accused[at] else "disputed" if done.disputed[at] else ""
        page.rectangle((left, top - 11, left + 12, top + 1), color_of(trust))
        silent = "" if agent in heard else " (silent)"
        if _is_outlined(done):
            page.rectangle((left + 14, top - 11, left + 18, top + 1), own_colors[agent])
        page.text((left + 24, top), f"{agent}{silent}: trust {trust:.2f} {word}", 9, bold=bool(word))
        top += _LINE
    return top


def fused_picture(done: Round) -> bytes:
    """Return a PNG of a round: joint view, agents by trust, objects by existence, lines between contradicting agents.

    With up to ``MAX_OUTLINED`` agents also the outlines of their views, and red dots where an agent claims another
    one's surface to be free.
    """
    picture, pairs = done.picture, contradictions(done)
    page = Canvas.blank(SIDE + COLUMN + 2 * MARGIN, SIDE + 2 * MARGIN + 30)
    page.text((MARGIN, MARGIN + 12), f"{len(done.reports)} agents, {picture.t_s:.2f} s", 11, bold=True)
    page.paste(_map_of(done, pairs, SIDE), MARGIN, MARGIN + 30)
    left, top = SIDE + 2 * MARGIN, MARGIN + 44
    # 6. Text: agents with their trust, believed objects, contradictions.
    top = _write_agents(page, done, left, top)
    shown = picture.reported | picture.believed
    top += _LINE // 2
    page.text((left, top), f"{int(picture.believed.sum())} of {int(shown.sum())} objects believed", 9)
    words = [
        (f"{picture.agents[one]} contradicts {picture.agents[other]}: {what}", False) for one, other, what in pairs
    ]
    for sentence, bold in [*words[:12], *((line, True) for line in done.sentences())]:
        for line in wrap(sentence, _LETTERS):
            top += _LINE
            page.text((left, top), line, 8, bold=bold)
    top = SIDE + MARGIN - 4 * _LINE
    legend = (("believed", TRUSTED), ("in doubt", DOUBTED), ("not believed; contradiction", DISTRUSTED))
    if _is_outlined(done):
        page.text((left, top + 3 * _LINE), "lines: edges of what each agent sees", 8)
        page.text((left, top + 4 * _LINE), "red dots: surfaces that another agent claims free", 8)
    for line_number, (word, color) in enumerate(legend):
        page.rectangle((left, top + line_number * _LINE - 11, left + 12, top + line_number * _LINE + 1), color, BLACK)
        page.text((left + 20, top + line_number * _LINE), f"agents and objects: {word}" if not line_number else word, 8)
    return page.png()


def fused_page(rounds: Sequence[Round], pictures: Sequence[bytes], title: str) -> bytes:
    """Return a self-contained HTML page of rounds over time: pictures with a slider, and curves of trust."""
    agents = sorted({agent for done in rounds for agent in done.picture.agents})
    times_s = [done.picture.t_s for done in rounds]
    width, height, begin, end = 720.0, 160.0, times_s[0], max(times_s[-1], times_s[0] + 1e-3)
    lines, ends = [], list[tuple[float, str]]()
    for number, agent in enumerate(agents):
        places = [
            (width * (done.picture.t_s - begin) / (end - begin),
             height * (1.0 - float(done.picture.verdicts.trust[done.picture.agents.index(agent)])))
            for done in rounds if agent in done.picture.agents
        ]  # fmt: skip
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
        color = "#{:02x}{:02x}{:02x}".format(*agent_color(number, len(agents)))
        lines.append(f'<polyline points="{path}" fill="none" stroke="{color}" stroke-width="2"/>')
        ends.append((places[-1][1], f'fill="{color}">{html.escape(agent)}</text>'))
    # Names at the ends of their curves, moved down where they would overlap.
    below = -np.inf
    for row, name in sorted(ends):
        below = max(row, below + 15.0)
        lines.append(f'<text x="{width + 6}" y="{below:.0f}" {name}')
    sources = json.dumps([base64.b64encode(picture).decode() for picture in pictures])
    return f"""<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title>
<style>body{{font:14px sans-serif;margin:16px}}img{{max-width:100%}}input{{width:720px}}svg{{overflow:visible}}</style>
</head><body><h1>{html.escape(title)}</h1>
<input id="time" type="range" min="0" max="{len(pictures) - 1}" value="{len(pictures) - 1}" aria-label="time">
<p><img id="picture" alt="agents, what they see together, objects by belief, and who contradicts whom"></p>
<h2>Trust in each agent</h2>
<svg width="{width + 160:.0f}" height="{height + 8:.0f}" role="img" aria-label="trust over time">
<rect width="{width}" height="{height}" fill="none" stroke="#999"/>
<line x2="{width}" y1="{height / 2}" y2="{height / 2}" stroke="#ccc"/>{"".join(lines)}</svg>
<script>const pictures = {sources};
const show = () => {{ document.getElementById("picture").src =
  "data:image/png;base64," + pictures[document.getElementById("time").value]; }};
document.getElementById("time").addEventListener("input", show); show();</script></body></html>
""".encode()
