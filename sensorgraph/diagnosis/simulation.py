"""What a log of the robot and one of the user's own simulator have in common, and where they differ.

Both are diagnosed against the same arena and robot file, which so drop out: an effect that both show is part of the
user's simulator already, one that only the robot shows is missing there, one that only the simulation shows is wrong.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sensorgraph.diagnosis.result import ChannelResult, Unknown
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.effects import Amendment
from sensorgraph.effects.effect import size_ratio

MAX_STDERRS = 3.0
"""Standard errors by which two sizes of an effect must differ at least to be called different."""
MAX_SHARE = 0.1
"""The same of a parameter that has no materiality, as a share of it."""
MAX_DISTANCE = 0.3
"""[m] between two spots that are the same."""
NOISE_RATIO = 1.25
"""Of the scatter of two lasers, above which they are called different."""


@dataclass(frozen=True, kw_only=True)
class LaserNoise:
    """What a laser does to its readings, as one log shows it."""

    scatter: float
    """[m] robust standard deviation of the readings about the model."""
    lost: float
    """Share of the rays that should have returned, and did not."""
    stray: float
    """Share of the returns that are from elsewhere."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulationComparison:
    """How the log of a robot differs from that of a simulator."""

    name: str
    """Of the simulator's log."""
    shared: tuple[Amendment, ...] = ()
    """Effects that both show, as the simulation has them."""
    changed: tuple[tuple[Amendment, Amendment], ...] = ()
    """Effects that both show with different sizes: the robot's, the simulation's."""
    only_in_simulation: tuple[Amendment, ...] = ()
    """Effects that the robot does not show."""
    not_observable: Mapping[str, str] = field(default_factory=dict)
    """Of these, the ones that the robot's log could not have shown -> why."""
    unknown: Unknown | None = None
    """What the simulation has that no effect explains."""
    shares_unknown: bool = False
    """The robot's log shows the same, so that it is no difference."""
    robot_noise: LaserNoise | None = None
    simulated_noise: LaserNoise | None = None


def laser_noise(fitted: Fitted) -> LaserNoise:
    """Return scatter, losses and strays about an accepted model."""
    view = FitResiduals(fitted.solver.data, fitted)
    clear = view.returned & view.aimed & view.valid & ~view.strange
    off = view.residual[clear]
    scatter = 1.4826 * float(np.median(np.abs(off - np.median(off)))) if len(off) else 0.0
    due = view.aimed & ~np.isnan(view.z)
    return LaserNoise(
        scatter=scatter,
        lost=float(view.lost[due].mean()) if due.any() else 0.0,
        stray=float(view.strange.sum() / max(view.returned.sum(), 1)),
    )


def counterpart(a: Amendment, others: Sequence[Amendment]) -> Amendment | None:
    """Return the effect of the same name at the same place, if it is among others."""
    return next((b for b in others if b.name == a.name and _is_same_place(a, b)), None)


def _is_same_place(a: Amendment, b: Amendment) -> bool:
    if a.effect.place == "spot":
        return bool(
            np.hypot(a["x"] - b["x"], a["y"] - b["y"]) <= max(MAX_DISTANCE, a.parameters.get("r", 0.0))
        )
    if a.effect.place == "sector":
        return max(a["theta1"], b["theta1"]) <= min(a["theta2"], b["theta2"])
    return a.place == b.place


def is_same_size(a: Amendment, b: Amendment) -> bool:
    """Tell whether two effects of one name differ by less than a user would mind, or than anyone can tell."""
    off = {k: a[k] - b[k] for k in a.parameters if k in b.parameters}
    error = {k: float(np.hypot(a.stderr.get(k, 0.0), b.stderr.get(k, 0.0))) for k in off}
    clear = {k: d for k, d in off.items() if abs(d) > MAX_STDERRS * error[k]}
    sizes = {k: d for k, d in clear.items() if k in a.effect.sizes}
    if sizes and size_ratio(a.effect, sizes) >= 1.0:
        return False
    places = {"x", "y", "a", "b", "theta1", "theta2"}  # told by the place
    rest = {k: d for k, d in clear.items() if k not in a.effect.sizes and k not in places}
    return all(abs(d) <= MAX_SHARE * max(abs(a[k]), abs(b[k])) for k, d in rest.items())


def shared_with(result: ChannelResult, simulated: Sequence[Amendment]) -> tuple[Amendment, ...]:
    """Return those of a simulation's effects that a channel of the robot names with the same size."""
    pairs = [(a, counterpart(a, simulated)) for a in result.effects]
    return tuple(b for a, b in pairs if b is not None and is_same_size(a, b))


def without_shared(result: ChannelResult, simulated: Sequence[Amendment]) -> ChannelResult:
    """Leave out what is no difference."""
    shared = shared_with(result, simulated)
    kept = tuple(a for a in result.effects if counterpart(a, shared) is None)
    return result if len(kept) == len(result.effects) else replace(result, effects=kept)


def is_same_unknown(a: Unknown | None, b: Unknown | None) -> bool:
    """Tell whether two doubts are of the same kind, at the same place, of a similar size."""
    if a is None or b is None or a.deviation is None or b.deviation is None:
        return False
    one, other = a.deviation, b.deviation
    if (one.channel, one.family, one.partition) != (other.channel, other.family, other.partition):
        return False
    if one.xy is not None and other.xy is not None:
        near = bool(np.hypot(one.xy[0] - other.xy[0], one.xy[1] - other.xy[1]) <= 2 * MAX_DISTANCE)
    else:
        near = one.label == other.label
    return near and one.size * other.size >= 0 and 0.5 <= abs(one.size) / max(abs(other.size), 1e-12) <= 2.0
