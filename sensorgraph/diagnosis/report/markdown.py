"""Short report in markdown, shown next to the scans in the viewer."""

from __future__ import annotations

from sensorgraph.diagnosis.finding import Finding
from sensorgraph.diagnosis.report.quantities import (
    deviation_text,
    parameters,
    percent,
    place_text,
)
from sensorgraph.diagnosis.report.summary import summarise


def markdown(finding: Finding, name: str) -> str:
    """Return a short report in markdown."""
    summary = summarise(finding)
    lines = [f"# {summary.headline}", "", *(f"{text}\n" for text in summary.details)]
    for a in finding.effects:
        lines += [
            f"**{a.effect.title}** `{a.name}`: {a.effect.physics}",
            "",
            f"{a.effect.equation}: {', '.join(parameters(a))}" if a.parameters else a.effect.equation,
            "",
            f"probability {percent(a.probability)}"
            + (f", log Bayes factor {a.evidence:,.0f}" if a.evidence is not None else "")
            + (f", at {place_text(a)}" if place_text(a) else ""),
            "",
        ]
    scan = finding.channels.get("scan")
    if scan is not None and scan.deviations:
        lines += [
            "Deviations before any effect:",
            "",
            *(f"- {deviation_text(w)}" for w in scan.deviations[:4]),
            "",
        ]
    lines += [f"*{name}. Gap and residuals are those of the bare simulator at the reference poses.*"]
    return "\n".join(lines)
