"""fleet.html, and a page for each log: they open from disk and load nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from sensorgraph.diagnosis.report.quantities import percent
from sensorgraph.show.page_shell import page_shell
from sensorgraph.surveying.drawing import change_map, trend
from sensorgraph.surveying.quantities import LABELS, quantities_of
from sensorgraph.surveying.result import Fleet, RobotChange
from sensorgraph.version import __version__

MAX_TRENDS = 60
"""Maximum number of trends without a change that are drawn."""
MAX_LINES = 12
"""Maximum number of changes above the table."""
WIDE = "<style>main{max-width:84rem} .trends{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(25rem,100%),1fr));gap:1.4rem} .trends figure{margin:0} .trends figcaption{margin:0 0 .3rem;color:var(--ink)} table{font-size:.84rem} td.n,td.day{white-space:nowrap} .scroll{overflow-x:auto} svg{max-width:100%;height:auto}</style>"


def fleet_page(fleet: Fleet) -> str:
    """Return fleet.html."""
    changes = [str(one) for one in fleet.changes]
    return page_shell(
        headline=changes[0] if len(changes) == 1 else fleet.changed_robots,
        lead=[
            f"{fleet.extent}; {len(fleet.failures)} failed.",
            *(escape(f"{one}.") for one in fleet.shared_names),
            *([] if len(changes) < 2 else [f"{one}." for one in changes[:MAX_LINES]]),
            *([f"{len(changes) - MAX_LINES} more are in the table."] if len(changes) > MAX_LINES else []),
        ],
        eyebrow=f"sensorgraph fleet {__version__}",
        kind="found" if changes or fleet.odd else "",
        sections=[
            WIDE, _changes(fleet), _odd(fleet), _trends(fleet), _maps(fleet), _failures(fleet), _table(fleet),
        ],
    )  # fmt: skip


def _changes(fleet: Fleet) -> str:
    if not fleet.changes and not fleet.possible:
        return ""
    rows = [
        f"<tr><td>{escape(one.robot)}</td><td>{escape(LABELS[one.quantity].title)}</td>"
        f'<td class="n">{LABELS[one.quantity].change(one.size, one.sigma)}</td>'
        f"<td>{'drift over all logs' if one.is_drift else escape(one.day)}</td>"
        f'<td class="n">{percent(one.probability)}</td>'
        f"<td>{', '.join(LABELS[name].title for name in one.seen_in)}</td></tr>"
        for one in (*fleet.changes, *fleet.possible)
    ]
    return (
        "<h2>Changes</h2><table><tr><th>robot</th><th>quantity</th><th class='n'>change</th><th>since</th>"
        f"<th class='n'>probability</th><th>explains the change of</th></tr>{''.join(rows)}</table>"
        '<p class="note">Changes from 95 % on are stated; less probable ones are possible. ± is one standard error.</p>'
    )


def _odd(fleet: Fleet) -> str:
    if not fleet.odd:
        return ""
    rows = [
        f"<tr><td>{escape(one.robot)}</td><td>{escape(LABELS[one.quantity].title)}</td>"
        f'<td class="n">{LABELS[one.quantity].change(one.size, one.sigma)}</td>'
        f'<td class="n">{percent(one.probability)}</td></tr>'
        for one in fleet.odd
    ]
    return (
        "<h2>Robots that differ from their sisters</h2><table><tr><th>robot</th><th>quantity</th>"
        f"<th class='n'>difference</th><th class='n'>probability</th></tr>{''.join(rows)}</table>"
    )


def _trends(fleet: Fleet) -> str:
    """Draw each quantity of each robot over its logs: those with a change, and then the others."""
    changed: list[str] = []
    steady: list[str] = []
    for robot in sorted({str(row["robot"]) for row in fleet.rows}):
        own = [row for row in fleet.rows if row["robot"] == robot]
        for quantity in quantities_of(own):
            found = [
                one
                for one in fleet.changes
                if one.robot == robot and quantity in (one.quantity, *one.seen_in)
            ]
            picture = _trend(own, quantity, found)
            if picture:
                (changed if found else steady).append(picture)
    rest = len(steady) - MAX_TRENDS
    more = f'<p class="note">{rest} more are not drawn; fleet.csv has all values.</p>' if rest > 0 else ""
    parts = [f'<h2>Trends</h2><div class="trends">{"".join(changed)}</div>'] if changed else []
    if steady:
        parts.append(
            f"<details><summary>Trends without a change ({len(steady)})</summary>"
            f'<div class="trends">{"".join(steady[:MAX_TRENDS])}</div>{more}</details>'
        )
    return "".join(parts)


def _trend(own: Sequence[Mapping[str, Any]], quantity: str, found: Sequence[RobotChange]) -> str:
    """Draw one quantity of one robot; nothing if fewer than two logs have it."""
    points = [
        (float(row["epoch_s"]), *row["quantities"][quantity], str(row["day"]))
        for row in own
        if quantity in row["quantities"]
    ]
    if len(points) < 2:
        return ""
    at = {str(row["log"]): float(row["epoch_s"]) for row in own}
    label = LABELS[quantity]
    said = "; ".join(
        label.change(one.size, one.sigma)
        if one.quantity == quantity
        else f"explained by {LABELS[one.quantity].title}"
        for one in found
    )
    title = f"{own[0]['robot']}, {label.title} [{label.unit}]"
    picture = trend(points, [at[one.after] for one in found if not one.is_drift], label)
    return f"<figure><figcaption>{escape(title)}{': ' if said else ''}{said}</figcaption>{picture}</figure>"


def _maps(fleet: Fleet) -> str:
    """Draw the changes of each building, by the number of logs that show them."""
    parts = []
    for place, walls in fleet.walls.items():
        own = [row for row in fleet.rows if row["place"] == place]
        cells = {
            kind: _counted([row["changes"].get(kind, []) for row in own if row.get("changes")])
            for kind in ("new", "gone")
        }
        if own:
            parts.append(
                f"<figure>{change_map(walls, cells)}<figcaption>{escape(place)}, {len(own)} logs: "
                f"{_cells(cells['new'])} with something new (orange), {_cells(cells['gone'])} where a wall is "
                "gone (blue); the more logs show a cell, the darker it is.</figcaption></figure>"
            )
    return f"<h2>Changes of the building</h2>{''.join(parts)}" if parts else ""


def _cells(some: Mapping[tuple[float, float], int]) -> str:
    return f"{len(some)} cell{'s' * (len(some) != 1)}"


def _counted(cells: Sequence[Sequence[Sequence[float]]]) -> dict[tuple[float, float], int]:
    out: dict[tuple[float, float], int] = {}
    for log in cells:
        for x, y in log:
            out[x, y] = out.get((x, y), 0) + 1
    return {cell: n for cell, n in out.items() if n > 1}


def _failures(fleet: Fleet) -> str:
    lines = [
        *((log, f"the same content as {other}, counted once") for log, other in fleet.same), *fleet.failures,
    ]  # fmt: skip
    if not lines:
        return ""
    rows = "".join(
        f"<tr><td>{escape(Path(log).name)}</td><td>{escape(reason)}</td></tr>" for log, reason in lines
    )
    return f"<h2>Logs that failed</h2><table class='pairs'><tr><th>log</th><th>reason</th></tr>{rows}</table>"


def _table(fleet: Fleet) -> str:
    names = quantities_of(fleet.rows)
    head = "".join(f"<th class='n'>{LABELS[name].title}</th>" for name in names)
    rows = []
    for row in fleet.rows:
        cells = "".join(f'<td class="n">{_two_lines(row["quantities"], name)}</td>' for name in names)
        changed = row.get("changes") or {}
        rows.append(
            f"<tr><td>{escape(str(row['robot']))}</td><td class='day'>{escape(str(row['day']))}</td>"
            f'<td><a href="logs/{row["key"]}.html">{escape(Path(str(row["log"])).name)}</a></td>'
            f'<td class="n">{_length(float(row["length_s"]))}</td><td>{escape(str(row["place"] or "own map"))}</td>'
            f'<td class="n">{_percent(float(row["ok_share"]))}</td>{cells}'
            f'<td class="n">{len(changed.get("new", ()))} / {len(changed.get("gone", ()))}</td></tr>'
        )
    return (
        f"<h2>Logs</h2><div class='scroll'><table><tr><th>robot</th><th>day</th><th>log</th><th class='n'>length</th>"
        f"<th>place</th><th class='n'>located</th>{head}<th class='n'>new / gone</th></tr>{''.join(rows)}</table></div>"
    )


def _two_lines(quantities: Mapping[str, Sequence[float]], name: str) -> str:
    """Return a value and, below it, its standard error; the table has many columns."""
    return LABELS[name].shown(*quantities[name]).replace(" ± ", "<br>± ") if name in quantities else ""


def log_page(row: Mapping[str, Any]) -> str:
    """Return the page of one log."""
    lines = "".join(f"<li>{escape(str(line).strip())}</li>" for line in row.get("lines", ()))
    notes = "".join(f"<li>{escape(str(line))}</li>" for line in (*row["warnings"], *row["location_notes"]))
    uses = "".join(f"<tr><td>{escape(k)}</td><td>{escape(str(v))}</td></tr>" for k, v in row["use"].items())
    return page_shell(
        headline=f"{row['robot']}, {row['day']}: {Path(str(row['log'])).name}",
        lead=[
            f"{_length(float(row['length_s']))}, {float(row['way_m']):.0f} m, {row['n_scans']} scans of {row['kind']}; "
            f"{_percent(float(row['ok_share']))} located in {row['place'] or 'a new map'}."
        ],
        eyebrow=f"sensorgraph fleet {__version__}",
        kind="found" if row.get("effects") else "",
        sections=[
            f"<h2>Wheels and mount</h2><ul>{lines}</ul>",
            f"<h2>What the log can be used for</h2><table>{uses}</table>",
            f"<h2>Notes</h2><ul>{notes}</ul>" if notes else "",
            f"<p class='note'>{escape(str(row['log']))}</p>",
        ],
    )


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share < 0.995 or share == 1 else f"{100 * share:.1f} %"


def _length(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"
