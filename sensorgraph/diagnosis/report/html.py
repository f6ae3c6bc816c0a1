"""Write report.html: one self-contained page for a first-time reader."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

from sensorgraph.diagnosis.finding import Finding
from sensorgraph.diagnosis.motion.calibration.driving import DrivingFinding, source_of
from sensorgraph.diagnosis.report.considered import considered_section
from sensorgraph.diagnosis.report.data import plain
from sensorgraph.diagnosis.report.quantities import (
    deviation_text,
    minus,
    parameters,
    percent,
    place_text,
    title_of,
)
from sensorgraph.diagnosis.report.summary import main_channel, summarise, undecided_rivals
from sensorgraph.diagnosis.result import ChannelResult
from sensorgraph.effects import Amendment
from sensorgraph.show.page_shell import page_shell, picture, warnings, without_breaks

CHANNELS = {
    "scan": "scan against map and pose",
    "odometry": "odometry against pose",
    "drive": "odometry against command",
}
FILES = {
    "report.json": "all numbers, SI units",
    "effects.yaml": "the effects found; pass it to record, evaluate and diagnose with --effects",
    "review.rrd": "measured, nominal and amended scans on one timeline; open with: rerun review.rrd",
}


def page(
    finding: Finding,
    pictures: Mapping[str, Path],
    *,
    title: str,
    settings: Mapping[str, Any],
    next_run: Mapping[str, Any] | None = None,
) -> str:
    """Return the page.

    Parameters
    ----------
    pictures : name -> PNG file, put into the page
    title : name of the run
    settings : configuration, listed at the end
    """
    summary = summarise(finding)
    body = [
        _arena_section(finding, pictures),
        _gap_section(finding, pictures),
        _effects_section(finding),
        _profile_section(pictures),
        _rivals_section(finding),
    ]
    sections = [
        *(body if main_channel(finding) == "scan" else [*body[1:], body[0]]),
        considered_section(finding.ledger),
        _deviations_section(finding, pictures),
        _channels_section(finding),
        _driving_section(finding, pictures),
        _next_run_section(next_run, pictures),
        _settings_section(finding, settings),
    ]
    return page_shell(
        headline=summary.headline,
        lead=[*summary.details, *warnings(finding.intake.get("log_notes", ()))],
        eyebrow=f"sensorgraph diagnose: {title}",
        kind=summary.outcome,
        sections=sections,
    )


def _arena_section(finding: Finding, pictures: Mapping[str, Path]) -> str:
    if "arena" not in pictures:
        return ""
    amended = any(a.effect.channel == "scan" for a in finding.effects)
    caption = (
        "The arena from above. Each dot is the end of a measured ray, offset from its simulated end: red where the "
        "measured range is longer, blue where it is shorter. Grey line: the path of the robot."
    )
    if amended:
        caption += " With a correct model, an even, narrow band of noise remains along every wall."
    title = "Where they differ" if main_channel(finding) == "scan" else "The scans in the arena"
    return f"<h2>{title}</h2>{picture(pictures['arena'], 'Residuals in the arena', caption)}"


def _gap_section(finding: Finding, pictures: Mapping[str, Path]) -> str:
    gap = finding.channels["scan"].gap if "scan" in finding.channels else None
    rays = f" ({gap.n_rays:,} rays)" if gap is not None else ""
    caption = (
        f"Measured on held-out readings{rays}; map and poses may shift within their tolerances, before and after. "
        "Noise floor: the gap of readings drawn from the amended model. Right: negative log-likelihood in nats per reading, "
        "less that of the noise floor; smaller is better."
    )
    shown = picture(pictures.get("gap"), "Gap before, after, noise floor", caption)
    return f"<h2>Size of the gap</h2>{shown}" if shown else ""


def _effects_section(finding: Finding) -> str:
    if not finding.effects:
        return ""
    return "<h2>Effects found</h2>" + "".join(_effect(a) for a in finding.effects)


def _profile_section(pictures: Mapping[str, Path]) -> str:
    caption = (
        "Fitted together with poses, map, mount and noise. The mean over all rays is removed, because it equals a mounting "
        "yaw or a bias. Band: two standard errors, from the differences between parts of the run. Numbers: unknown.profile in "
        "report.json."
    )
    shown = picture(pictures.get("profile"), "Error over bearing or range", caption)
    return f"<h2>Unexplained error</h2>{shown}" if shown else ""


def _effect(a: Amendment) -> str:
    numbers = ", ".join(f"<b>{_with_subscripts(text)}</b>" for text in parameters(a))
    equation = _with_subscripts(a.effect.equation)
    joined = "<br>".join(filter(None, [equation, numbers]))
    facts = {
        "probability": percent(a.probability),
        "log Bayes factor": "–" if a.evidence is None else f"{a.evidence:,.0f} nats",
        "size": f"{a.ratio:.1f} × the tolerance" if a.ratio != float("inf") else "",
        "place": place_text(a),
        "channel": CHANNELS[a.effect.channel],
    }
    return (
        f'<section class="effect"><h3>{escape(a.effect.title)}<code>{escape(a.name)}</code></h3>'
        f"<p>{escape(a.effect.physics)}</p>"
        + (f'<p class="equation">{joined}</p>' if joined else "")
        + f'{_grid(facts)}<p class="note">Its residual varies with {escape(a.effect.varies)}. Source: {escape(a.effect.source)}.</p></section>'
    )


def _grid(facts: Mapping[str, str]) -> str:
    """Return labels with their values, without empty ones."""
    cells = "".join(f"<div><span>{k}</span>{escape(v)}</div>" for k, v in facts.items() if v)
    return f'<div class="facts">{cells}</div>' if cells else ""


def _with_subscripts(text: str) -> str:
    """Write `α_max` with a subscript."""
    return re.sub(r"_([a-z]+)", r"<sub>\1</sub>", escape(text))


def _rivals_section(finding: Finding) -> str:
    rivals = [rival for result in finding.channels.values() for rival in result.rivals]
    if not rivals:
        return ""
    rows = []
    evidence = {a.name: a.evidence or 0.0 for a in finding.effects}
    for rival in rivals:
        behind = evidence.get(rival.instead_of, 0.0) - rival.evidence_nats
        rows.append(
            f"<tr><td>{escape(title_of(rival.instead_of))}</td><td>{escape(title_of(rival.name))}</td>"
            f'<td class="n">{minus(f"{behind:,.0f}")}</td><td>{escape(rival.separates)}</td></tr>'
        )
    head = (
        "<tr><th>found</th><th>runner-up</th><th class='n'>log Bayes factor between them [nats]</th>"
        "<th>what would distinguish them</th></tr>"
    )
    close = undecided_rivals(finding)
    lead = "<p>The data do not decide between the best two.</p>" if close else ""
    return f"<h2>Second-best explanations</h2>{lead}<table>{head}{''.join(rows)}</table>"


def _deviations_section(finding: Finding, pictures: Mapping[str, Path]) -> str:
    scan = finding.channels.get("scan")
    found = [] if scan is None else list(scan.deviations)
    if not found and "residuals" not in pictures:
        return ""
    rows = "".join(f"<li>{escape(deviation_text(w))}</li>" for w in found[:6])
    rest = "".join(f"<li>{escape(deviation_text(w))}</li>" for w in found[6:])
    more = f"<details><summary>{len(found) - 6} more</summary><ul>{rest}</ul></details>" if rest else ""
    text = (
        f"<p>Significant, and larger than the tolerances of map, mount, poses and clock:</p><ul>{rows}</ul>{more}"
        if found
        else "<p>No part of the data deviates by more than the tolerances of map, mount, poses and clock.</p>"
    )
    caption = (
        "Residuals at the reference poses, without the corrections of the list above, over the quantities they may depend on; "
        "before: the bare simulator, after: with the effects found; bands: two standard errors. Upper row: mean of measured − "
        "simulated. Lower row: scatter, or the share of missing returns, unexpected returns and outliers."
    )
    return f"<h2>Deviations before any effect</h2><p>Residuals after map, mount, clocks and poses are corrected within their tolerances.</p>{text}{picture(pictures.get('residuals'), 'Residuals by bearing, range, incidence, time, turn rate, speed', caption)}"


def _channels_section(finding: Finding) -> str:
    rows = "".join(
        f"<tr><td>{escape(CHANNELS.get(name, name))}</td><td>{escape(_channel_text(result))}</td></tr>"
        for name, result in finding.channels.items()
    )
    return f"<h2>Channels</h2><table class='pairs'>{rows}</table>"


def _driving_section(finding: Finding, pictures: Mapping[str, Path]) -> str:
    if finding.driving is None:
        return ""
    heading = "Wheels and mount from driving alone"
    return driving_section(finding.driving, pictures.get("calibration"), heading=heading)


def driving_section(finding: DrivingFinding, drawn: Path | None, *, heading: str) -> str:
    """Return the calibration of each run as HTML, with the picture of its parts."""
    caption = (
        "Line and band: the whole run with two standard errors. Dots: eighths of the run with one standard error, for "
        "independent windows."
    )
    parts = [f"<h2>{escape(heading)}</h2>"] if heading else []
    for name, found in finding.runs.items():
        said = "".join(f"<li>{without_breaks(line)}</li>" for line in finding.lines_of(name))
        parts.append(f"<p>{escape(name)}, {without_breaks(source_of(found))}:</p><ul>{said}</ul>")
    return "\n".join([*parts, picture(drawn, "parameters along the runs", caption)])


def _channel_text(result: ChannelResult) -> str:
    if result.skipped:
        return f"not evaluated: {result.skipped}"
    out = []
    if result.effects:
        out.append("found: " + ", ".join(a.effect.title for a in result.effects))
    if result.unknown is not None:
        out.append(result.unknown.statement)
    gap = result.gap
    if gap is not None and gap.noise_floor.normalised > 0:
        floor = gap.noise_floor.normalised
        before, after = f"{gap.before.normalised / floor:.2f}", f"{gap.after.normalised / floor:.2f}"
        size = f"from {before} to {after}" if result.effects else after
        out = out or ["nothing material"]
        out.append(f"gap {size} times the noise floor")
    return "; ".join(out) if out else "nothing material"


def _next_run_section(plan: Mapping[str, Any] | None, pictures: Mapping[str, Path]) -> str:
    if not plan:
        return ""
    facts = {
        "expected log Bayes factor [nats]": f"{plan['expected_nats']:,.0f}",
        "of a median random run": f"{plan['median_random_run_nats']:,.0f}",
        "duration": f"{plan['duration_s']:.0f} s",
        "path": f"{plan['path_m']:.1f} m",
    }
    others = "".join(f"<li>{escape(question)}?</li>" for question in plan["questions"][1:])
    asked = f"<p>It also helps to answer:</p><ul>{others}</ul>" if others else ""
    n = len(plan["steps"])
    head = "".join(f"<th>{name}</th>" for name in ("step", "place [m]", "heading", "way [m]"))
    rows = "".join(
        f"<tr><td>{escape(step['kind'])}</td><td>{_value(step['place'])}</td>"
        f"<td>{_value(math.degrees(step['heading']))}°</td><td>{_value(step['way_m'])}</td></tr>"
        for step in plan["steps"]
    )
    return (
        f"<h2>The next run</h2><p>{escape(plan['why'])}</p>{asked}"
        + _grid(facts)
        + picture(pictures.get("next_run"), "Path of the next run", "")
        + f"<details><summary>{n} step{'s' * (n != 1)}</summary><table><tr>{head}</tr>{rows}</table></details>"
    )


def _value(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(_value(v) for v in value)
    return minus(escape(f"{value:.3g}" if isinstance(value, float) else str(value)))


def _settings_section(finding: Finding, settings: Mapping[str, Any]) -> str:
    """Return input and settings, as in report.json."""
    data = json.dumps(plain({"intake": finding.intake, "settings": settings}), indent=1, ensure_ascii=False)
    files = "".join(f"<li><code>{name}</code> {escape(what)}</li>" for name, what in FILES.items())
    return (
        f"<h2>Input and settings</h2><details><summary>as in report.json, SI units</summary><pre>{escape(data)}</pre>"
        f"</details><footer><p>In the same folder:</p><ul>{files}</ul></footer>"
    )
