"""Diagnose a run: where simulation and measurement disagree, which effects are missing, how sure that is."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from logs.run import Run
from planners.arena import Arena
from sensorgraph.diagnose.criticise import Verdict, check, deviations
from sensorgraph.diagnose.decide import Explained, explain
from sensorgraph.diagnose.drive import diagnose_drive
from sensorgraph.diagnose.evidence import Evidence, gather
from sensorgraph.diagnose.finding import Gap, Ledger, Rival, Unknown, Where
from sensorgraph.diagnose.model import Fitted, smooth_parameters
from sensorgraph.diagnose.nuisance import DENSE, OWN, Freedom, widths
from sensorgraph.diagnose.odometry import diagnose_odometry
from sensorgraph.diagnose.prove import gap, held_out
from sensorgraph.diagnose.view import View
from sensorgraph.effects import Amendment
from sensorgraph.effects.effect import size_ratio
from sensorgraph.world.robot_file import RobotFile

Progress = Callable[[str], None]
STRIKE = 0.006  # of an effect's evidence; where more than this stays unexplained, its name falls


@dataclass(frozen=True, kw_only=True, eq=False)
class Finding:
    """All that a diagnosis says, channel by channel, and what pictures need."""

    ledgers: dict[str, Ledger]
    """`scan`, `odometry`, `drive`."""
    intake: dict[str, Any]
    """What came in, what was used, what was dropped, what this run excites; plain data."""
    evidence: Evidence
    explained: Explained | None
    verdict: Verdict | None
    second_gap: Gap | None = None
    """On a further run that nothing has seen, where one was given."""
    seconds: dict[str, float] = field(default_factory=dict)
    """[s] of CPU per part."""

    @property
    def effects(self) -> tuple[Amendment, ...]:
        """Named effects of all channels: the scan channel first, each by falling evidence."""
        return tuple(a for ledger in self.ledgers.values() for a in ledger.effects)

    @property
    def unknown(self) -> Unknown | None:
        """What no effect of the library explains."""
        return next((ledger.unknown for ledger in self.ledgers.values() if ledger.unknown), None)


def diagnose(
    run: Run,
    arena: Arena,
    robot: RobotFile,
    *,
    second: Run | None = None,
    known: Sequence[Amendment] = (),
    freedom: Freedom | None = None,
    threshold: float = 12.0,
    seed: int = 0,
) -> Finding:
    """Compare a run with the simulator of its arena and robot, and name what is missing.

    Parameters
    ----------
    second : a further run of the same robot and place, used for nothing but the gap
    known : effects that are part of the model already
    freedom : of the noise; from a commissioning run
    threshold : [nats] of evidence that a name takes
    """
    rng = np.random.default_rng(seed)
    clock = time.process_time()
    seconds: dict[str, float] = {}

    def lap(name: str) -> None:
        nonlocal clock
        now = time.process_time()
        seconds[name] = seconds.get(name, 0.0) + now - clock
        clock = now

    evidence, notes = gather(run, arena, robot)
    held = held_out(evidence)
    train, unseen = evidence.part(~held), evidence.part(held)
    lap("intake")
    explained = explain(train, freedom or Freedom(), threshold=threshold)
    lap("explain")
    where = tuple(deviations(View(train, explained.null)))[:24]
    gained = explained.final.j - explained.null.j
    verdict = check(train, explained.final, gained, explained.gains, rng=rng)
    lap("criticise")
    proof = gap(unseen, explained.null, explained.final, rng=rng)
    second_gap = None
    if second is not None:
        other, _ = gather(second, arena, robot)
        second_gap = gap(other, explained.null, explained.final, rng=rng)
    lap("prove")
    scan = _ledger(train, explained, verdict, where, proof)
    odometry = diagnose_odometry(run, robot, seed=seed)
    drive = diagnose_drive(run, robot, seed=seed, use_clock=odometry.unknown is None)
    lap("odometry and drive")
    return Finding(
        ledgers={"scan": scan, "odometry": odometry, "drive": drive},
        intake={**notes, "rays": int(evidence.ranges.size), "held_out_scans": int(held.sum())},
        evidence=evidence,
        explained=explained,
        verdict=verdict,
        second_gap=second_gap,
        seconds=seconds,
    )


def _ledger(
    evidence: Evidence, explained: Explained, verdict: Verdict, where: tuple[Where, ...], proof: Gap
) -> Ledger:
    """Turn the accepted model into names, sizes within tolerance, doubt and rivals."""
    final = explained.final
    named, small, rivals = [], [], []
    for index, amendment in enumerate(final.model):
        complete = replace(
            amendment,
            stderr=stderr(final, index),
            evidence=explained.gains[index],
            probability=probability(explained, index, verdict),
        )
        material = size_ratio(amendment.effect, amendment.parameters) >= slackness(final, amendment)
        if not material:
            small.append(complete)
            continue
        if _is_struck(explained, index, verdict):
            continue
        named.append(complete)
        if index in explained.rivals:
            rival, short = explained.rivals[index]
            rivals.append(
                Rival(
                    name=rival.name,
                    instead_of=amendment.name,
                    evidence_nats=explained.gains[index] - short,
                    separates=separates(amendment, rival),
                )
            )
    named.sort(key=lambda a: -(a.evidence or 0.0))
    return Ledger(
        channel="scan",
        effects=tuple(named),
        within_tolerance=tuple(small),
        unknown=_unknown(verdict),
        rivals=tuple(rivals),
        where=where,
        gap=proof,
    )


def slackness(fitted: Fitted, amendment: Amendment) -> float:
    """Return how many times its materiality an effect must be: more, where the tolerances proved too tight."""
    return max(1.0, fitted.state.map_scale, fitted.state.pose_scale if amendment.name in OWN else 1.0)


def _is_struck(explained: Explained, index: int, verdict: Verdict) -> bool:
    """Tell whether a name falls because too much of its own feature is left unexplained."""
    if index in verdict.failed:
        return True
    return verdict.doubted and verdict.misfit > STRIKE * explained.gains[index]


def stderr(fitted: Fitted, index: int) -> dict[str, float]:
    """Return standard errors of an effect's smooth parameters, from the curvature with all nuisances free.

    What a careful set-up may hide of the same kind (a mount within its tolerance) adds to the error.
    """
    k, out = 0, {}
    variance = np.diag(fitted.solution.covariance)
    for i, amendment in enumerate(fitted.model):
        for name in smooth_parameters(amendment):
            if i == index:
                own = widths_of(fitted, amendment.name).get(name, 0.0)
                out[name] = float(np.sqrt(max(variance[k], 0.0) + own**2))
            k += 1
    return out


def widths_of(fitted: Fitted, name: str) -> dict[str, float]:
    """Return the tolerance of a set-up of the same kind as an effect, by parameter."""
    tau = dict(zip(DENSE, widths(fitted.solver.evidence.tolerances), strict=True))
    return {parameter: float(tau[copy]) for parameter, copy in OWN_PARAMETERS.get(name, {}).items()}


OWN_PARAMETERS = {
    "mount_xy": {"dx": "mount_x", "dy": "mount_y"},
    "mount_yaw": {"delta": "mount_yaw"},
    "range_bias": {"b": "bias"},
    "range_scale": {"s": "scale"},
    "range_drift": {"b1": "drift"},
    "latency": {"tau": "latency"},
    "scan_skew": {"T": "skew"},
}


def probability(explained: Explained, index: int, verdict: Verdict) -> float:
    """Return the chance that a name is right, calibrated on development cases."""
    gain = explained.gains[index]
    margin = explained.rivals[index][1] if index in explained.rivals else gain
    score = 0.15 * min(gain, margin)
    p = 1 / (1 + np.exp(-score))
    if verdict.doubted:
        p *= 0.5
    return float(p)


def separates(a: Amendment, rival: Amendment) -> str:
    """Say what would tell two effects apart."""
    return (
        a.effect.rivals.get(rival.name)
        or rival.effect.rivals.get(a.name)
        or (f"{a.name} varies with {a.effect.varies}; {rival.name} with {rival.effect.varies}")
    )


def _unknown(verdict: Verdict) -> Unknown | None:
    if not verdict.doubted:
        return None
    return Unknown(
        statement=f"something no effect of the library explains: {verdict.statement}",
        where=verdict.where,
        statistic=verdict.statistic,
        threshold=verdict.threshold,
    )


def sentence(where: Where) -> str:
    """Say one deviation in words."""
    return where.sentence()
