"""Common and different effects in a log of the robot and a log of the user's own simulator.

Both are diagnosed against the same arena and robot file, which therefore cancel:

- An effect that both show is already part of the user's simulator.
- An effect that only the robot shows is missing in the simulator.
- An effect that only the simulation shows is wrong.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sensorgraph.diagnosis.engine.verdict import Objection
from sensorgraph.diagnosis.result import ChannelResult, Unknown
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment
from sensorgraph.effects.effect import size_ratio
from sensorgraph.robust import robust_sigma

MAX_STDERRS = 3.0
"""Minimum difference between two sizes of an effect, in standard errors, to be called different."""
MAX_SHARE = 0.1
"""Minimum relative difference of a parameter without materiality, to be called different."""


@dataclass(frozen=True, kw_only=True)
class LaserNoise:
    """Noise of a laser, as one log shows it."""

    scatter: float
    """[m] robust standard deviation of the readings about the model."""
    lost: float
    """Share of the rays with a missing return."""
    stray: float
    """Share of the returns that are outliers."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulationComparison:
    """Differences between the log of a robot and that of a simulator."""

    name: str
    """Of the simulator's log."""
    shared: tuple[Amendment, ...] = ()
    """Effects that both show, with the parameters of the simulation."""
    changed: tuple[tuple[Amendment, Amendment], ...] = ()
    """Effects that both show with different sizes: the robot's, the simulation's."""
    only_in_simulation: tuple[Amendment, ...] = ()
    """Effects that the robot does not show."""
    not_observable: Mapping[str, str] = field(default_factory=dict)
    """Effect of `only_in_simulation` -> reason why the robot's log could not have shown it."""
    unknown: Unknown | None = None
    """Unmodelled structure in the simulation."""
    shares_unknown: bool = False
    """Whether the robot's log shows the same structure, so that it is not a difference."""
    robot_noise: LaserNoise | None = None
    simulated_noise: LaserNoise | None = None


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


def counterpart(a: Amendment, others: Sequence[Amendment]) -> Amendment | None:
    """Return the effect with the same name and place, if it is among the others."""
    return next((b for b in others if b.name == a.name and _is_same_place(a, b)), None)


def _is_same_place(a: Amendment, b: Amendment) -> bool:
    if a.effect.place == "spot":
        return bool(np.hypot(a["x"] - b["x"], a["y"] - b["y"]) <= a["r"] + b["r"])
    if a.effect.place == "sector":
        return max(a["theta1"], b["theta1"]) <= min(a["theta2"], b["theta2"])
    return a.place == b.place


def is_same_size(a: Amendment, b: Amendment) -> bool:
    """Tell whether two sizes of one effect differ by less than their materiality or their standard errors."""
    off = {k: a[k] - b[k] for k in a.parameters if k in b.parameters}
    error = {k: float(np.hypot(a.stderr.get(k, 0.0), b.stderr.get(k, 0.0))) for k in off}
    clear = {k: d for k, d in off.items() if abs(d) > MAX_STDERRS * error[k]}
    sizes = {k: d for k, d in clear.items() if k in a.effect.sizes}
    if sizes and size_ratio(a.effect, sizes) >= 1.0:
        return False
    places = {"x", "y", "a", "b", "theta1", "theta2"}  # compared as the place
    rest = {k: d for k, d in clear.items() if k not in a.effect.sizes and k not in places}
    return all(abs(d) <= MAX_SHARE * max(abs(a[k]), abs(b[k])) for k, d in rest.items())


def shared_with(result: ChannelResult, simulated: Sequence[Amendment]) -> tuple[Amendment, ...]:
    """Return the effects of a simulation that a channel of the robot names with the same size."""
    pairs = [(a, counterpart(a, simulated)) for a in result.effects]
    return tuple(b for a, b in pairs if b is not None and is_same_size(a, b))


def without_shared(result: ChannelResult, simulated: Sequence[Amendment]) -> ChannelResult:
    """Remove the effects that robot and simulation share."""
    shared = shared_with(result, simulated)
    why = Objection("in_the_simulation", "the simulation shows it with the same size")
    return result.without(
        {i: why for i, a in enumerate(result.effects) if counterpart(a, shared) is not None}
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
