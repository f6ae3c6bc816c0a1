"""The page of a watched run: a time line of the three statements, and the map with what has changed."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from sensorgraph.diagnosis.report.quantities import minus
from sensorgraph.show.page_shell import page_shell
from sensorgraph.types import Floats
from sensorgraph.watching.evidence import FaultDoubt
from sensorgraph.watching.settings import DISTANCE_FAULTS, LASER_FAULTS, MISSING_FAULT
from sensorgraph.watching.status import WatchStatus
from sensorgraph.watching.summary import PageData, Span

COLOURS = {
    "ok": "#2a788e", "unknown": "#c9ced8", "ambiguous": "#e0a030", "off": "#d1345b", "lost": "#7d1536",
    "fault": "#d1345b", "changed": "#e0a030",
}  # fmt: skip
WIDTH, ROW, LEFT = 900, 34, 70
"""[px] of the time line; the map has its width, and at most as much height."""
STEPS = (1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600)
"""[s] between the labels of the time line; above an hour, whole hours."""
MOST_LABELS = 8
USUAL_SIZES = {fault.name: fault.size for fault in (*DISTANCE_FAULTS, *LASER_FAULTS, MISSING_FAULT)}
"""Standard deviation of the size of a fault; a drive with a larger standard error does not show it."""


def watch_page(data: PageData) -> str:
    """Return the page as HTML."""
    last = data.last
    lead = [*data.at_the_end, *filter(None, [data.next_step])]
    kind = "found" if data.level != "ok" else "calm"
    return page_shell(
        headline=data.headline, lead=lead, eyebrow=f"{data.graph_name} · {data.run_name} · {data.duration / 60:.1f} min",
        kind=kind,
        sections=[
            "<h2>Time line</h2>" + _time_line(data), "<h2>Map</h2>" + _map(data), _changes(last), _robot(last),
            _notes(data.notes),
        ],
    )  # fmt: skip


def _time_line(data: PageData) -> str:
    scale = (WIDTH - LEFT - 10) / max(data.duration, 1.0)
    rows = (("pose", data.pose_spans), ("place", data.place_spans), ("robot", data.robot_spans))
    parts = []
    for k, (name, spans) in enumerate(rows):
        y = 8 + k * ROW
        parts.append(f'<text x="0" y="{y + 16}" font-size="13">{name}</text>')
        parts += [_bar(span, scale, y) for span in spans]
    y = 8 + len(rows) * ROW
    for t in np.arange(0.0, data.duration, _step(data.duration)):
        x, anchor = LEFT + t * scale, "middle" if t else "start"
        parts.append(
            f'<text x="{x:.1f}" y="{y + 10}" font-size="11" fill="#6d7282" text-anchor="{anchor}">{t:.0f} s</text>'
        )
    words: dict[str, list[str]] = {}
    for word, colour in COLOURS.items():
        words.setdefault(colour, []).append("outside what the graph knows" if word == "unknown" else word)
    legend = " ".join(
        f'<span style="color:{colour}">■</span>&nbsp;{" or ".join(some)}' for colour, some in words.items()
    )
    return (
        f'<div class="wide"><svg viewBox="0 0 {WIDTH} {y + 18}" width="100%" font-family="inherit">{"".join(parts)}</svg></div>'
        f'<p class="note">{legend}</p>'
    )


def _step(duration: float) -> float:
    """Return the time [s] between labels of a time line."""
    least = duration / MOST_LABELS
    return next((float(step) for step in STEPS if step >= least), 3600.0 * np.ceil(least / 3600.0))


def _bar(span: Span, scale: float, y: float) -> str:
    x, width = LEFT + span.first * scale, max((span.last - span.first) * scale, 1.5)
    title = escape(f"{span.first:.0f} to {span.last:.0f} s: {span.text}")
    return f'<rect x="{x:.1f}" y="{y}" width="{width:.1f}" height="22" fill="{COLOURS[span.word]}"><title>{title}</title></rect>'


def _map(data: PageData) -> str:
    ends = data.walls.reshape(-1, 2)
    path = data.path[np.isfinite(data.path[:, 0]), :2]
    every = np.concatenate([ends, path]) if len(path) else ends
    low, high = every.min(axis=0) - 0.5, every.max(axis=0) + 0.5
    scale = WIDTH / max(high - low)
    width, height = (high - low) * scale

    def line(points: Floats) -> str:
        x, y = (points[:, 0] - low[0]) * scale, (high[1] - points[:, 1]) * scale
        return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))

    walls = "".join(f"M{line(wall).replace(' ', ' L')}" for wall in data.walls)
    parts = [f'<path d="{walls}" stroke="#5a6070" stroke-width="1.2" fill="none"/>']
    parts += [
        f'<polyline points="{line(data.path[a:b, :2])}" fill="none" stroke="{COLOURS[word]}" stroke-width="{1.2 if word == "ok" else 2.4}" opacity="0.8"/>'
        for a, b, word in data.path_pieces
    ]
    if len(path):
        (start, end) = (line(path[[k]]).split(",") for k in (0, -1))
        parts += [
            f'<circle cx="{start[0]}" cy="{start[1]}" r="6" fill="none" stroke="#23262f" stroke-width="2"><title>start</title></circle>',
            f'<circle cx="{end[0]}" cy="{end[1]}" r="5" fill="#23262f"><title>end</title></circle>',
        ]
    for change in data.last.changes:
        colour = "#d1345b" if change.kind == "new" else "#2a5bd1"
        title = escape(f"{change.kind}: {change.passes} passes, p = {change.p:.2f}")
        parts += [
            f'<polygon points="{line(outline)}" fill="{colour}" fill-opacity="0.45" stroke="{colour}" stroke-width="1.5"><title>{title}</title></polygon>'
            for outline in change.outlines
        ]
    for thing in data.last.moved:
        title = escape(f"moved by {thing.distance:.2f} m, p = {thing.p:.2f}")
        parts.append(
            f'<polyline points="{line(np.array([thing.gone.centre, thing.new.centre]))}" fill="none" stroke="#8c4799" '
            f'stroke-width="3"><title>{title}</title></polyline>'
        )
    return (
        f'<svg viewBox="0 0 {width:.0f} {height:.0f}" width="100%">{"".join(parts)}</svg>'
        f'<p class="note">x from {low[0]:.1f} to {high[0]:.1f} m, y from {low[1]:.1f} to {high[1]:.1f} m; '
        "grey: surfaces of the graph; line: where the robot was, by our own tracking, from the ring to the dot, in the colours "
        'of the time line; <span style="color:#d1345b">■</span>&nbsp;new, <span style="color:#2a5bd1">■</span>&nbsp;gone, '
        '<span style="color:#8c4799">■</span>&nbsp;way of a thing that moved</p>'
    )


def _changes(last: WatchStatus) -> str:
    if not last.changes:
        return "<h2>Changes of the place</h2><p>None that several passes agree on.</p>"
    rows = "".join(
        f'<tr><td>{change.kind}</td><td class="n">{change.centre[0]:.2f}, {change.centre[1]:.2f} m</td>'
        f'<td class="n">{change.size[0]:.1f} × {change.size[1]:.1f} m</td><td class="n">{change.first_seen:.0f} s</td>'
        f'<td class="n">{change.last_seen:.0f} s</td><td class="n">{change.passes}</td><td class="n">{change.p:.2f}</td></tr>'
        for change in last.changes
    )
    rows += "".join(
        f'<tr><td>moved by {thing.distance:.2f} m</td><td class="n">{thing.new.centre[0]:.2f}, {thing.new.centre[1]:.2f} m</td>'
        f'<td colspan="4">from {thing.gone.centre[0]:.2f}, {thing.gone.centre[1]:.2f} m: the new and the gone thing there are one</td>'
        f'<td class="n">{thing.p:.2f}</td></tr>'
        for thing in last.moved
    )
    numbers = ("where", "size", "first seen", "last seen", "passes", "probability")
    head = "<th>what</th>" + "".join(f'<th class="n">{word}</th>' for word in numbers)
    return f"<h2>Changes of the place</h2><table><tr>{head}</tr>{rows}</table>"


def _robot(last: WatchStatus) -> str:
    rows = "".join(
        f"<tr><td><code>{escape(doubt.name)}</code></td><td>{escape(_size(doubt))}</td>"
        f'<td class="n">{doubt.p:.3f}</td><td class="n">{minus(f"{doubt.nats:.1f}")}</td></tr>'
        for doubt in last.doubts
    )
    return (
        "<h2>Laser and wheels</h2><table><tr><th>hypothesis</th><th>size</th><th class='n'>probability</th>"
        "<th class='n'>evidence [nats]</th></tr>"
        f"{rows}</table>"
    )


def _size(doubt: FaultDoubt) -> str:
    is_hidden = max(doubt.stderr.values(), default=0.0) > USUAL_SIZES.get(doubt.name, np.inf)
    return "not shown by this drive" if is_hidden else doubt.sentence()


def _notes(notes: Sequence[str]) -> str:
    if not notes:
        return ""
    return "<h2>Input</h2><ul>" + "".join(f"<li>{escape(note)}</li>" for note in notes) + "</ul>"
