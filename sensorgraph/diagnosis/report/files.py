"""The report of a diagnosis: report.json, report.html, effects.yaml, review.rrd and pictures in one folder."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from sensorgraph.diagnosis.diagnose import Finding
from sensorgraph.diagnosis.report.comparison import bare_gap, compare, sections
from sensorgraph.diagnosis.report.phrases import (
    deviation,
    main_channel,
    parameters,
    percent,
    place_words,
    said,
)
from sensorgraph.diagnosis.result import ChannelResult, Deviation, Gap, Unknown
from sensorgraph.effects import Amendment, effects_file
from sensorgraph.files import whole
from sensorgraph.types import Progress
from sensorgraph.version import __version__

PICTURES = ("arena", "residuals", "gap", "ranking", "next_run")
NEXT_RUN = ("trajectory.csv", "arena.geojson", "robot.yaml", "plan.json")
PARTS = 5  # report.json, effects.yaml, pictures, report.html, review.rrd


def save(
    finding: Finding,
    folder: Path,
    *,
    name: str = "run",
    settings: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> list[Path]:
    """Write everything that a diagnosis has to say; return the files. Each is whole or not there.

    Parameters
    ----------
    name : what to call the run
    settings : configuration, kept in the report; the version is added
    progress : told how many of the parts are done
    """
    from sensorgraph.diagnosis.report import figures
    from sensorgraph.diagnosis.report import rerun_view as view_diagnosis
    from sensorgraph.diagnosis.report.html import page

    def done(count: int) -> None:
        if progress is not None:
            progress(count, PARTS)

    folder.mkdir(parents=True, exist_ok=True)
    kept = {"version": __version__, **(settings or {})}
    report = plain({**to_dict(finding), "settings": kept})
    files = {key: folder / key for key in ("report.json", "effects.yaml", "report.html", "review.rrd")}
    with whole(files["report.json"]) as part:
        part.write_text(json.dumps(report, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    done(1)
    effects_file.write(finding.effects, files["effects.yaml"])
    done(2)
    compared = compare(finding)
    pictures = figures.draw(finding, compared, folder)
    done(3)
    html = page(finding, pictures, title=name, settings=kept, next_run=report["next_run"])
    with whole(files["report.html"]) as part:
        part.write_text(html, encoding="utf-8")
    done(4)
    if compared is None:
        del files["review.rrd"]
    else:
        view_diagnosis.write(
            compared,
            files["review.rrd"],
            report=markdown(finding, name),
            marks=marks(finding),
            walls=[wall for a in finding.effects for wall in sections(compared.arena, a)],
        )
    done(5)
    return [*files.values(), *pictures.values()]


def clear(folder: Path) -> None:
    """Remove what an earlier report left and a later one may lack: pictures, review and next run."""
    for name in ("review.rrd", *(f"{picture}.png" for picture in PICTURES)):
        (folder / name).unlink(missing_ok=True)
    plan = folder / "next_run"
    for name in NEXT_RUN:
        (plan / name).unlink(missing_ok=True)
    if plan.is_dir() and not any(plan.iterdir()):
        plan.rmdir()


def next_run(finding: Finding) -> dict[str, Any] | None:
    """Return the next run as plain data, where one is planned."""
    plan = getattr(finding, "next_run", None)
    if plan is None:
        return None
    return dict(plan.to_dict()) if hasattr(plan, "to_dict") else dict(plan)


def marks(finding: Finding) -> list[tuple[str, tuple[float, float]]]:
    """Return words and points (x, y) [m, map] of what sits somewhere."""
    out = [(a.effect.title, xy) for a in finding.effects if (xy := spot(a)) is not None]
    unknown = finding.unknown
    if unknown is not None and unknown.deviation is not None and unknown.deviation.xy is not None:
        out.append(("unknown", unknown.deviation.xy))
    return out


def spot(a: Amendment) -> tuple[float, float] | None:
    """Return the point where an effect sits, if it has one."""
    if a.effect.place == "spot" and {"x", "y"} <= set(a.parameters):
        return float(a["x"]), float(a["y"])
    return None if a.location is None else a.location.xy


def markdown(finding: Finding, name: str) -> str:
    """Return the report in few words, in markdown."""
    what = said(finding)
    lines = [f"# {what.headline}", "", *(f"{text}\n" for text in what.details)]
    for a in finding.effects:
        lines += [
            f"**{a.effect.title}** `{a.name}`: {a.effect.physics}",
            "",
            f"{a.effect.equation}: {', '.join(parameters(a))}" if a.parameters else a.effect.equation,
            "",
            f"probability {percent(a.probability)}"
            + (f", evidence {a.evidence:,.0f} nats" if a.evidence is not None else "")
            + (f", at {place_words(a)}" if place_words(a) else ""),
            "",
        ]
    scan = finding.channels.get("scan")
    if scan is not None and scan.deviations:
        lines += ["Before any name:", "", *(f"- {deviation(w)}" for w in scan.deviations[:4]), ""]
    lines += [f"*{name}. Gap and residuals here are the bare simulator's, at the reference poses.*"]
    return "\n".join(lines)


def plain(data: Any) -> Any:
    """Return data that JSON can hold: numpy becomes Python, what is not finite becomes None."""
    if isinstance(data, Mapping):
        return {str(k): plain(v) for k, v in data.items()}
    if isinstance(data, list | tuple):
        return [plain(v) for v in data]
    if hasattr(data, "tolist"):
        return plain(data.tolist())
    if isinstance(data, float):
        return data if math.isfinite(data) else None
    if data is None or isinstance(data, str | bool | int):
        return data
    return str(data)


def to_dict(finding: Finding) -> dict[str, Any]:
    """Return the report as plain data; `gap`, `where` and `runner_up` begin with what the headline is about."""
    main = main_channel(finding)
    results = dict(sorted(finding.channels.items(), key=lambda item: item[0] != main))
    unknown = finding.unknown
    bare = bare_gap(finding)
    rivals = [asdict(r) for result in results.values() for r in result.rivals]
    return {
        "effects": [effect_dict(a) for a in finding.effects],
        "undecided": [effect_dict(a) for a in finding.undecided],
        "unknown": None if unknown is None else unknown_dict(unknown),
        "where": [where_dict(w) for result in results.values() for w in result.deviations],
        "runner_up": runner_up(finding, rivals),
        "rivals": rivals,
        "gap": next((gap_dict(one.gap, name) for name, one in results.items() if one.gap is not None), None),
        "gap_bare_simulator": None if bare is None else gap_dict(bare),
        "gap_second_run": None if finding.second_gap is None else gap_dict(finding.second_gap),
        "within_tolerance": [effect_dict(a) for result in results.values() for a in result.within_tolerance],
        "not_observable": [
            {"name": name, "why": why}
            for result in results.values()
            for name, why in result.not_observable.items()
        ],
        "next_run": next_run(finding),
        "intake": finding.intake,
        "channels": {name: channel_dict(result) for name, result in finding.channels.items()},
        "cpu_s": finding.seconds,
    }


def effect_dict(a: Amendment) -> dict[str, Any]:
    """Return one effect as plain data."""
    location = None
    if a.location is not None:
        location = {"name": a.location.name, "xy": None if a.location.xy is None else list(a.location.xy)}
    return {
        "name": a.name,
        "parameters": {k: float(v) for k, v in a.parameters.items()},
        "stderr": {k: float(v) for k, v in a.stderr.items()},
        "location": location,
        "probability": a.probability,
        "evidence_nats": a.evidence,
        "channel": a.effect.channel,
    }


def runner_up(finding: Finding, rivals: Sequence[Mapping[str, Any]]) -> Mapping[str, Any] | None:
    """Return the rival of the first-named effect; where it has none, the first rival of another."""
    first = next((a.name for a in (*finding.effects, *finding.undecided)), "")
    return next((r for r in rivals if r["instead_of"] == first), rivals[0] if rivals else None)


def where_dict(where: Deviation) -> dict[str, Any]:
    """Return one deviation as plain data."""
    return {**asdict(where), "statement": where.sentence()}


def unknown_dict(unknown: Unknown) -> dict[str, Any]:
    """Return what no effect explains as plain data."""
    return {
        "statement": unknown.statement,
        "where": None if unknown.deviation is None else asdict(unknown.deviation),
        "statistic": unknown.statistic,
        "threshold": unknown.threshold,
    }


def gap_dict(gap: Gap, channel: str = "scan") -> dict[str, Any]:
    """Return a gap as plain data, with its channel and the unit of `rmse_m` (m/s but for scans)."""
    return {"channel": channel, "unit": "m" if channel == "scan" else "m/s", **asdict(gap)}


def channel_dict(result: ChannelResult) -> dict[str, Any]:
    """Return what one channel says."""
    return {
        "effects": [a.name for a in result.effects],
        "within_tolerance": [a.name for a in result.within_tolerance],
        "unknown": None if result.unknown is None else result.unknown.statement,
        "skipped": result.skipped,
        "gap": None if result.gap is None else gap_dict(result.gap, result.channel),
        "where": [where_dict(w) for w in result.deviations],
        "notes": dict(result.notes),
    }
