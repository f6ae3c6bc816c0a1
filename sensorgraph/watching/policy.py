"""A policy: limits of a site, learned from good runs, with which `watch` ends in ok, warning or error.

A limit is a level of one measure that good runs exceed by chance at a stated rate per hour. The largest values of each
minute have an exponential tail (Pickands 1975); above their upper quartile u, with the mean excess m,

    P(value of a minute > x) = 0.25 exp(-(x - u) / m).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml
from scipy.special import expit, logit

from logs.files import atomic_file
from sensorgraph.errors import SensorgraphError, suggestion
from sensorgraph.robust import MAJORITY
from sensorgraph.types import Floats
from sensorgraph.watching.evidence import Baseline
from sensorgraph.watching.settings import (
    BELIEF_FAULT,
    DISTANCE_FAULTS,
    LASER_FAULTS,
    MISSING_FAULT,
    FaultPrior,
)
from sensorgraph.watching.status import WatchStatus

Level = Literal["ok", "warning", "error"]
LEVELS: tuple[Level, ...] = ("ok", "warning", "error")
VERSION = 1
RATES = {"warning": 0.1, "error": 0.01}
"""[1/h] False alarms of each limit."""
LEAST_TAIL = 0.25
"""[nats] Least mean excess of a tail: a few minutes do not show a thinner one."""
SHARE_OF_MINUTE = 0.5
"""Share of new evidence in the estimate of a minute, which is of the last one to two periods (`evidence.Pair`)."""
FAULTS = {fault.name: fault for fault in (*DISTANCE_FAULTS, *LASER_FAULTS, BELIEF_FAULT, MISSING_FAULT)}


@dataclass(frozen=True, kw_only=True)
class WatchPolicy:
    """Limits of one site and robot."""

    hours: float = 0.0
    """Duration of the good runs."""
    p_wrong: Mapping[str, float] = field(default_factory=lambda: {"warning": 0.5, "error": 0.9})
    """Level -> probability that the believed pose is off or the robot lost."""
    share_predicted: Mapping[str, float] = field(default_factory=lambda: {"warning": 0.6, "error": 0.3})
    """Level -> least share of the readings that the graph predicts."""
    n_changes: int = 0
    """Number of changes of the place that the good runs show, too; more are a warning."""
    baseline: Mapping[str, Baseline] = field(default_factory=dict)
    """Fault -> size in the good runs."""
    ignored: tuple[str, ...] = ()
    """Faults that are not judged."""

    def level(self, status: WatchStatus) -> tuple[Level, str]:
        """Return the level of a status, and the reason."""
        return max([("ok", ""), *self.reasons(status)], key=lambda reason: LEVELS.index(reason[0]))

    def reasons(self, status: WatchStatus) -> list[tuple[Level, str]]:
        """Return all limits that a status exceeds: the level, and a sentence that begins with pose, place or robot."""
        reasons: list[tuple[Level, str]] = []
        pose, share = status.pose, status.share_predicted
        for level in LEVELS[1:]:
            if pose.p_wrong > self.p_wrong[level]:
                reasons.append((level, f"pose {pose.sentence()}"))
            if share is not None and share < self.share_predicted[level]:
                reasons.append(
                    (
                        level,
                        f"place: {100 * share:.0f} % as the graph predicts, expected {100 * self.share_predicted[level]:.0f} %",
                    )
                )
        if pose.status == "ambiguous":
            reasons.append(("warning", f"pose {pose.sentence()}"))
        if (n := status.n_changes) > self.n_changes:
            reasons.append(
                ("warning", f"place: {n} change{'s' * (n != 1)}, expected at most {self.n_changes}")
            )
        for doubt in status.doubts:
            if doubt.p > MAJORITY and doubt.name not in self.ignored:
                reasons.append(("error" if doubt.p > 0.99 else "warning", f"robot: {doubt.sentence()}"))
        return reasons

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "version": VERSION,
            "hours": round(self.hours, 4),
            "false_alarms_per_hour": RATES,
            "pose": {"p_wrong": {key: round(value, 6) for key, value in self.p_wrong.items()}},
            "place": {
                "share_predicted": {key: round(value, 4) for key, value in self.share_predicted.items()},
                "n_changes": self.n_changes,
            },
            "robot": {
                "baseline": {
                    name: {"value": round(one.value, 6), "tolerance": round(one.tolerance, 6)}
                    for name, one in self.baseline.items()
                },
                "ignore": list(self.ignored),
            },
        }


def learn(runs: Sequence[Iterable[WatchStatus]]) -> WatchPolicy:
    """Learn limits from the statuses of good runs.

    Raises
    ------
    SensorgraphError : There is less than one minute.
    """
    wrong: list[float] = []
    unlike: list[float] = []
    sizes: dict[str, list[tuple[float, float]]] = {name: [] for name in FAULTS}
    hours, n_changes = 0.0, 0
    for run in runs:
        statuses = list(run)
        if not statuses:
            continue
        hours += (statuses[-1].t - statuses[0].t) / 3600.0
        n_changes = max(n_changes, statuses[-1].n_changes)
        for minute in _minutes(statuses):
            wrong.append(max(status.pose.p_wrong for status in minute))
            shares = [1.0 - status.share_predicted for status in minute if status.share_predicted is not None]
            unlike.append(max(shares, default=0.5))
            for doubt in minute[-1].doubts:
                if doubt.name in FAULTS:
                    fault = FAULTS[doubt.name]
                    error = math.sqrt(max(doubt.stderr[fault.parameter] ** 2 - fault.tolerance**2, 0.0))
                    if error < fault.size:  # the drive shows it
                        sizes[doubt.name].append((doubt.parameters[fault.parameter], error))
    if len(wrong) < 1 or hours < 1.0 / 60.0:
        raise SensorgraphError(f"the good runs last {60 * hours:.1f} min together; expected at least 1 min")
    return WatchPolicy(
        hours=hours,
        p_wrong={level: max(_limit(np.array(wrong), rate), 0.5) for level, rate in RATES.items()},
        share_predicted={level: 1.0 - _limit(np.array(unlike), rate) for level, rate in RATES.items()},
        n_changes=n_changes,
        baseline={
            name: healthy(FAULTS[name], *np.array(found).T) for name, found in sizes.items() if len(found) > 1
        },
    )


def _minutes(statuses: Sequence[WatchStatus]) -> list[list[WatchStatus]]:
    """Return the statuses of each minute."""
    numbers = [int((status.t - statuses[0].t) // 60.0) for status in statuses]
    return [
        [one for one, k in zip(statuses, numbers, strict=True) if k == minute]
        for minute in sorted(set(numbers))
    ]


def _limit(values: Floats, per_hour: float) -> float:
    """Return the probability that good minutes exceed at a rate."""
    x = logit(np.clip(values, 1e-6, 1.0 - 1e-6))
    u = float(np.quantile(x, 0.75))
    above = x[x >= u] - u
    m = max(float(above.mean()), LEAST_TAIL)
    return float(np.clip(expit(u + m * math.log(0.25 * 60.0 / per_hour)), 0.001, 0.999))


def healthy(fault: FaultPrior, sizes: Floats, errors: Floats) -> Baseline:
    """Return size and tolerance of a healthy robot from estimates x_i (n,) with their standard errors e_i (n,).

        x_i ~ N(b, t² + e_i²),    b flat,    t half-normal with the tolerance of the fault's prior.

    The posterior is integrated over a grid of t (Gelman 2006, "Prior distributions for variance parameters"). Estimates of
    neighbouring minutes share half of their evidence, so that each counts half. The tolerance contains the uncertainty of b.
    """
    t = fault.tolerance * np.linspace(0.02, 6.0, 300)
    weights = SHARE_OF_MINUTE / (t[:, None] ** 2 + errors**2)
    total = weights.sum(axis=1)
    b = (weights * sizes).sum(axis=1) / total
    log_p = 0.5 * SHARE_OF_MINUTE * np.log(weights).sum(axis=1) - 0.5 * np.log(total)
    log_p -= 0.5 * (weights * (sizes - b[:, None]) ** 2).sum(axis=1) + 0.5 * (t / fault.tolerance) ** 2
    p = np.exp(log_p - log_p.max())
    p /= p.sum()
    middle = float(p @ b)
    variance = float(p @ (t**2 + 1.0 / total + (b - middle) ** 2))
    return Baseline(value=middle, tolerance=math.sqrt(variance))


def save_policy(path: Path, policy: WatchPolicy, topics: Mapping[str, Any] | None = None) -> None:
    """Write a policy as yaml; `topics` are limits for `inspect --policy`."""
    data = {**policy.to_dict(), **({} if topics is None else {"topics": dict(topics)})}
    with atomic_file(path) as part:
        part.write_text(yaml.safe_dump(data, sort_keys=False))


def load_topics(path: Path) -> dict[str, Any]:
    """Read the limits of topics that a policy holds.

    Raises
    ------
    SensorgraphError : The file is no policy, or holds no topics.
    """
    load_policy(path)
    topics = yaml.safe_load(path.read_text()).get("topics")
    if not isinstance(topics, dict):
        raise SensorgraphError(
            f"{path} holds no `topics`; make it again with watch GRAPH --init-policy RUN... -o FILE"
        )
    return topics


def load_policy(path: Path) -> WatchPolicy:
    """Read a policy.

    Raises
    ------
    SensorgraphError : The file is no policy.
    """
    try:
        data = yaml.safe_load(path.read_text())
        if data["version"] != VERSION:
            raise SensorgraphError(
                f"{path} has version {data['version']}, expected {VERSION}; make it again with --init-policy"
            )
        robot = data.get("robot", {})
        unknown = {*robot.get("baseline", {})} - FAULTS.keys()
        if unknown:
            name = str(min(unknown))
            raise SensorgraphError(f"{path}: there is no fault `{name}`; {suggestion(name, FAULTS)}")
        return WatchPolicy(
            hours=float(data["hours"]),
            p_wrong=_shares(path, "p_wrong", data["pose"]["p_wrong"]),
            share_predicted=_shares(path, "share_predicted", data["place"]["share_predicted"]),
            n_changes=int(data["place"]["n_changes"]),
            baseline={
                str(name): Baseline(value=float(one["value"]), tolerance=float(one["tolerance"]))
                for name, one in robot.get("baseline", {}).items()
            },
            ignored=tuple(robot.get("ignore", ())),
        )
    except (KeyError, TypeError, ValueError, yaml.YAMLError, UnicodeDecodeError) as exc:
        if isinstance(exc, SensorgraphError):
            raise
        reason = f"it has no key {exc}" if isinstance(exc, KeyError) else f"{type(exc).__name__}: {exc}"
        raise SensorgraphError(
            f"{path} is no policy of watch ({reason}); make one with watch GRAPH --init-policy RUN... -o FILE"
        ) from exc


def _shares(path: Path, name: str, data: Mapping[str, Any]) -> dict[str, float]:
    """Return the probabilities or shares of both levels.

    Raises
    ------
    SensorgraphError : One is not between 0 and 1, and so would never or always be exceeded.
    """
    values: dict[str, float] = {level: float(data[level]) for level in LEVELS[1:]}
    for level, value in values.items():
        if not 0.0 <= value <= 1.0:
            raise SensorgraphError(f"{path}: `{name}` of {level} is {value:g}, expected 0 to 1")
    return values
