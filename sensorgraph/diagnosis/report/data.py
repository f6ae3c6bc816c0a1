"""Convert a finding to plain data, for report.json."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from sensorgraph.diagnosis.finding import Finding, SimulationComparison
from sensorgraph.diagnosis.motion.calibration.driving import DrivingFinding
from sensorgraph.diagnosis.motion.calibration.estimate import NUISANCES, PARAMETERS, DrivingCalibration
from sensorgraph.diagnosis.report.summary import main_channel
from sensorgraph.diagnosis.result import ChannelResult, Deviation, Gap, Unknown
from sensorgraph.effects import Amendment

UNITS = dict(
    zip(
        (*PARAMETERS, *NUISANCES), ("1", "1", "rad/m", "m", "m", "rad", "s", "m/m", "m/m"), strict=True
    )
)  # fmt: skip
"""Parameter of a calibration from driving alone -> its unit."""


def to_dict(finding: Finding) -> dict[str, Any]:
    """Return the report as plain data; `gap`, `where` and `runner_up` start with the channel of the headline."""
    main = main_channel(finding)
    results = dict(sorted(finding.channels.items(), key=lambda item: item[0] != main))
    unknown = finding.unknown
    rivals = [asdict(r) for result in results.values() for r in result.rivals]
    return {
        "effects": [effect_dict(a) for a in finding.effects],
        "undecided": [effect_dict(a) for a in finding.undecided],
        "unknown": None if unknown is None else unknown_dict(unknown),
        "where": [deviation_dict(d) for result in results.values() for d in result.deviations],
        "runner_up": runner_up(finding, rivals),
        "rivals": rivals,
        "gap": next((gap_dict(one.gap, name) for name, one in results.items() if one.gap is not None), None),
        "gap_second_run": None if finding.second_gap is None else gap_dict(finding.second_gap),
        "simulation": None if finding.simulation is None else simulation_dict(finding.simulation),
        "calibration": [] if finding.driving is None else calibrations(finding.driving),
        **{f"{of}_scale": finding.tolerance_factors.get(of) for of in ("pose", "stamp", "heading", "map")},
        "within_tolerance": [effect_dict(a) for result in results.values() for a in result.within_tolerance],
        "not_observable": [
            {"name": name, "why": why}
            for result in results.values()
            for name, why in result.not_observable.items()
        ],
        "ledger": finding.ledger.to_list(),
        "next_run": None if finding.next_run is None else finding.next_run.to_dict(),
        "intake": finding.intake,
        "channels": {name: channel_dict(result) for name, result in finding.channels.items()},
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


def simulation_dict(compared: SimulationComparison) -> dict[str, Any]:
    """Return the difference between run and simulation as plain data."""
    noises = {"robot": compared.robot_noise, "simulation": compared.simulated_noise}
    return {
        "run": compared.name,
        "shared": [effect_dict(a) for a in compared.shared],
        "changed": [{"robot": effect_dict(a), "simulation": effect_dict(b)} for a, b in compared.changed],
        "only_in_simulation": [effect_dict(a) for a in compared.only_in_simulation],
        "not_observable": [{"name": name, "why": why} for name, why in compared.not_observable.items()],
        "unknown": None if compared.unknown is None else unknown_dict(compared.unknown),
        "shares_unknown": compared.shares_unknown,
        "laser": {key: None if noise is None else asdict(noise) for key, noise in noises.items()},
    }


def runner_up(finding: Finding, rivals: Sequence[Mapping[str, Any]]) -> Mapping[str, Any] | None:
    """Return the rival of the first effect, or else the first rival of another effect."""
    first = next((a.name for a in (*finding.effects, *finding.undecided)), "")
    return next((r for r in rivals if r["instead_of"] == first), rivals[0] if rivals else None)


def deviation_dict(deviation: Deviation) -> dict[str, Any]:
    """Return one deviation as plain data."""
    return {**asdict(deviation), "statement": deviation.sentence()}


def unknown_dict(unknown: Unknown) -> dict[str, Any]:
    """Return an unexplained difference as plain data."""
    return {
        "statement": unknown.statement,
        "where": None if unknown.deviation is None else asdict(unknown.deviation),
        "statistic": unknown.statistic,
        "threshold": unknown.threshold,
        "size": dict(unknown.size),
        "families": list(unknown.families),
        "profile": None if unknown.profile is None else asdict(unknown.profile),
    }


def gap_dict(gap: Gap, channel: str = "scan") -> dict[str, Any]:
    """Return a gap as plain data, with its channel and the unit of `rmse_m` (m for scans, else m/s)."""
    return {"channel": channel, "unit": "m" if channel == "scan" else "m/s", **asdict(gap)}


def channel_dict(result: ChannelResult) -> dict[str, Any]:
    """Return the result of one channel as plain data."""
    return {
        "effects": [a.name for a in result.effects],
        "within_tolerance": [a.name for a in result.within_tolerance],
        "unknown": None if result.unknown is None else result.unknown.statement,
        "skipped": result.skipped,
        "gap": None if result.gap is None else gap_dict(result.gap, result.channel),
        "where": [deviation_dict(d) for d in result.deviations],
        "notes": dict(result.notes),
    }


def calibrations(finding: DrivingFinding) -> list[dict[str, Any]]:
    """Return the parameters of each run, and their change within it, as plain data."""
    return [
        {**_calibration(name, found), "change": _driving_change(finding, name)}
        for name, found in finding.runs.items()
    ]


def _calibration(name: str, found: DrivingCalibration) -> dict[str, Any]:
    return {
        "run": name,
        "way_m": found.way_m,
        "turn_rad": found.turn_rad,
        "duration_s": found.duration_s,
        "stated_mount": found.mount.tolist(),
        "parameters": {
            key: {
                "value": found.of(key)[0],
                "stderr": found.of(key)[1],
                "unit": unit,
                "observable": key not in found.hidden,
                "why": found.hidden.get(key),
            }
            for key, unit in UNITS.items()
        },
    }


def _driving_change(finding: DrivingFinding, name: str) -> dict[str, Any] | None:
    change = finding.changes[name]
    if change is None:
        return None
    one = change.difference
    return {"name": one.name, "difference": one.value, "stderr": one.stderr, "at_s": change.at_s}


def plain(data: Any) -> Any:
    """Return JSON-compatible data: numpy becomes Python, non-finite numbers become None."""
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
