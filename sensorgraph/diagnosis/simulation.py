"""Diagnose a run against a log of the user's own simulator: common and different effects.

Both are diagnosed against the same arena and robot file, which therefore cancel:

- An effect that both show is already part of the user's simulator.
- An effect that only the robot shows is missing in the simulator.
- An effect that only the simulation shows is wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from logs.run import Run
from planners.arena import Arena
from sensorgraph.diagnosis.diagnose import diagnose
from sensorgraph.diagnosis.finding import Finding, LaserNoise, SimulationComparison
from sensorgraph.diagnosis.result import Unknown, counterpart
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment
from sensorgraph.errors import SensorgraphError
from sensorgraph.robust import robust_sigma
from sensorgraph.types import ProgressBars, no_progress
from sensorgraph.world.robot import Robot


def diagnose_against_simulation(
    run: Run,
    arena: Arena,
    robot: Robot,
    *,
    simulation: Run,
    name: str = "the simulation",
    known: Sequence[Amendment] = (),
    force: bool = True,
    progress: ProgressBars = no_progress,
    **options: Any,
) -> Finding:
    """Name the effects that a run of the robot shows and a run of the user's simulator does not.

    Parameters
    ----------
    simulation : A run in the user's simulator, in the same arena, along any path.
    name : Of the simulation's log, for messages.
    known : Effects that are already part of the model.
    options : Of `diagnose`.

    Raises
    ------
    SensorgraphError
        A run is too short, has no returns or no poses, has poses that jump, or is of another sensor or place.
    """
    try:
        theirs = diagnose(
            simulation,
            arena,
            robot,
            known=known,
            seed=options.get("seed", 0),
            plan_next=False,
            force=force,
            progress=progress,
        )
    except SensorgraphError as exc:
        raise SensorgraphError(f"{name}: {exc}") from exc
    if theirs.explained is None:
        raise SensorgraphError(
            f"{name}: {theirs.intake['arena']}; give a simulation recorded in the same arena"
        )
    ours = diagnose(
        run, arena, robot, known=known, simulated=theirs.effects, force=force, progress=progress, **options
    )
    read = [*ours.intake["log_notes"], *(f"simulation {note}" for note in theirs.intake["log_notes"])]
    ours = replace(ours, intake={**ours.intake, "log_notes": read})
    return ours if ours.explained is None else _with_comparison(ours, compared_with(ours, theirs, name))


def compared_with(ours: Finding, theirs: Finding, name: str) -> SimulationComparison:
    """Sort the effects of a run and of a simulation by which of the two shows them."""
    assert ours.explained is not None and theirs.explained is not None
    both = [(a, counterpart(a, theirs.effects)) for a in ours.effects]
    changed = [(a, b) for a, b in both if b is not None]
    small = [a for channel in ours.channels.values() for a in (*channel.within_tolerance, *channel.undecided)]
    seen = (*ours.effects, *ours.shared, *small)
    only = [b for b in theirs.effects if counterpart(b, seen) is None]
    unseen = {key: why for channel in ours.channels.values() for key, why in channel.not_observable.items()}
    unknown = theirs.unknown
    return SimulationComparison(
        name=name,
        shared=ours.shared,
        changed=tuple(changed),
        only_in_simulation=tuple(only),
        not_observable={b.name: unseen[b.name] for b in only if b.name in unseen},
        unknown=unknown,
        shares_unknown=any(is_same_unknown(one.unknown, unknown) for one in ours.channels.values()),
        robot_noise=laser_noise(ours.explained.final),
        simulated_noise=laser_noise(theirs.explained.final),
    )


def _with_comparison(finding: Finding, compared: SimulationComparison) -> Finding:
    """Return the finding with its comparison; unmodelled structure that both show is not a difference."""
    channels = {
        name: replace(one, unknown=None) if is_same_unknown(one.unknown, compared.unknown) else one
        for name, one in finding.channels.items()
    }
    return replace(finding, channels=channels, simulation=compared)


def laser_noise(fitted: Fitted) -> LaserNoise:
    """Return scatter, missing returns and outliers with respect to an accepted model."""
    view = FitResiduals(fitted.solver.data, fitted)
    clear = view.returned & view.aimed & view.valid & ~view.strange
    off = view.residual[clear]
    scatter = robust_sigma(off - np.median(off)) if len(off) else 0.0
    due = view.aimed & ~np.isnan(view.z)
    return LaserNoise(
        scatter=scatter,
        lost=float(view.lost[due].mean()) if due.any() else 0.0,
        stray=float(view.strange.sum() / max(view.returned.sum(), 1)),
    )


def is_same_unknown(a: Unknown | None, b: Unknown | None) -> bool:
    """Tell whether two unmodelled structures have the same kind and place, and a similar size."""
    if a is None or b is None or a.deviation is None or b.deviation is None:
        return False
    one, other = a.deviation, b.deviation
    if (one.channel, one.family, one.partition) != (other.channel, other.family, other.partition):
        return False
    if one.xy is not None and other.xy is not None:
        near = bool(np.hypot(one.xy[0] - other.xy[0], one.xy[1] - other.xy[1]) <= SCAN.goodness_of_fit.cell)
    else:
        near = one.label == other.label
    return near and one.size * other.size >= 0 and 0.5 <= abs(one.size) / max(abs(other.size), 1e-12) <= 2.0
