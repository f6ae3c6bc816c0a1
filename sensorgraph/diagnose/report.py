"""report.json of a diagnosis: plain data, as INTERFACE promises it."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from sensorgraph.diagnose.diagnose import Finding, sentence
from sensorgraph.diagnose.finding import Gap, Ledger
from sensorgraph.effects import Amendment


def to_dict(finding: Finding) -> dict[str, Any]:
    """Return the report as plain data."""
    ledgers = finding.ledgers
    unknown = finding.unknown
    gap = ledgers["scan"].gap
    rivals = [asdict(r) for ledger in ledgers.values() for r in ledger.rivals]
    return {
        "effects": [effect_dict(a) for a in finding.effects],
        "unknown": None if unknown is None else asdict(unknown),
        "where": [{**asdict(w), "statement": sentence(w)} for w in ledgers["scan"].where],
        "runner_up": rivals[0] if rivals else None,
        "rivals": rivals,
        "gap": None if gap is None else gap_dict(gap),
        "gap_second_run": None if finding.second_gap is None else gap_dict(finding.second_gap),
        "within_tolerance": [effect_dict(a) for ledger in ledgers.values() for a in ledger.within_tolerance],
        "not_observable": [
            {"name": name, "why": why}
            for ledger in ledgers.values()
            for name, why in ledger.not_observable.items()
        ],
        "next_run": None,
        "intake": finding.intake,
        "channels": {name: channel_dict(ledger) for name, ledger in ledgers.items()},
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


def gap_dict(gap: Gap) -> dict[str, Any]:
    """Return a gap as plain data."""
    return asdict(gap)


def channel_dict(ledger: Ledger) -> dict[str, Any]:
    """Return what one channel says."""
    return {
        "effects": [a.name for a in ledger.effects],
        "within_tolerance": [a.name for a in ledger.within_tolerance],
        "unknown": None if ledger.unknown is None else ledger.unknown.statement,
        "skipped": ledger.skipped,
        "gap": None if ledger.gap is None else gap_dict(ledger.gap),
        "notes": dict(ledger.notes),
    }
