"""Interfaces between diagnosis and the functions of an effect.

The functions of an effect search for it in residuals, and decide whether a run could show it. They take the views
below, which `sensorgraph.diagnosis.scan` implements.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from logs.run import RangeSensor
from planners.arena import Arena
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.beams import Beams


@dataclass(frozen=True, kw_only=True, eq=False)
class Proposal:
    """Start values of an effect that should be fitted."""

    values: Mapping[str, float]
    gain: float
    """[nats] Expected gain with fixed nuisances."""
    place: str = ""
    """Name of the wall or obstacle."""
    xy: Floats | tuple[float, float] | None = None
    """[m, map] Point of the effect."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CornerShift:
    """An effect at one place of the map, as a shift of the map's corners."""

    shift: Floats
    """(n_corners, 2, k) [m per unit] Shift of each corner per unit of each smooth parameter."""
    place: str = ""
    xy: Floats | None = None


class Present(Protocol):
    """An effect in the model of the fit."""

    @property
    def name(self) -> str:
        """Canonical name of the effect."""
        ...

    @property
    def place(self) -> str:
        """Name of the wall or obstacle."""
        ...

    @property
    def parameters(self) -> Mapping[str, float]:
        """Parameter values."""
        ...


class Residuals(Protocol):
    """Expected and measured readings of a fit; arrays (n_scans, n_rays)."""

    arena: Arena
    sensor: RangeSensor
    model: Sequence[Present]
    """Effects of the fit."""
    walls: Floats
    """(n_walls, 2, 2) [m] Walls in the fit."""
    beams: Beams
    z: Floats
    """[m] Measured readings; +inf without a return, -inf if too near."""
    mu: Floats
    """[m] Expected readings."""
    residual: Floats
    """[m] Measured minus expected; 0 if one of them is missing."""
    weight: Floats
    """[1/m²] Weight of the residual in the fit; 0 for outliers."""
    sigma: Floats
    """[m] Fitted standard deviation of the core of the noise."""
    nominal_sigma: Floats
    """[m] Standard deviation of the core of the noise from robot.yaml."""
    stray: Floats
    """Probability that a reading is an outlier."""
    log_p: Floats
    """[nats] Log-likelihood of each reading."""
    tail: float
    """Share of returns in the wide part of the noise."""
    loss: float
    """Probability of a missing return where a return is expected."""
    returned: Bools
    lost: Bools
    near: Bools
    """The reading is too near to be measured."""
    aimed: Bools
    """The fit expects a return."""
    strange: Bools
    """The fit classifies the return as an outlier."""
    short: Bools
    """The return is an outlier and clearly shorter than expected."""
    long: Bools
    """The return is an outlier and clearly longer than expected."""
    valid: Bools
    """The residual depends smoothly on poses and map."""

    @property
    def certain_loss(self) -> Floats:
        """[nats] Gain of the hypothesis that a ray cannot return."""
        ...

    @property
    def along(self) -> Floats:
        """[m] Distance of the hit from the first end of its wall; nan if no wall is hit."""
        ...

    @property
    def incidence(self) -> Floats:
        """[rad] Incidence; nan if nothing is hit."""
        ...

    def ends(self, some: Bools) -> Floats:
        """Return the end points (n, 2) [m, map] of the measured rays `some`."""
        ...

    def likely(self, mu: Floats, some: Bools | None = None) -> Floats:
        """Return log-likelihoods [nats] for other expected readings; arrays (n_scans, n_rays), or (n,) of `some`."""
        ...


class Exposure(Protocol):
    """The surfaces that the rays of a run hit, from which its observable effects follow; arrays (n_scans, n_rays)."""

    arena: Arena
    sensor: RangeSensor
    twists: Floats
    """(n_scans, 3) [m/s, m/s, rad/s]"""
    span: float
    """[s] Duration of the run."""
    beams: Beams
    seen: Bools
    """A return is expected."""
    n_seen: int
    valid: Bools
    """The reading depends smoothly on poses and map."""
    reading: Floats
    """[m] Expected reading; may be inf."""
    range: Floats
    """[m] Expected reading; 0 if no return is expected."""
    incidence: Floats
    """[rad] Incidence; 0 if no return is expected."""
    wall: Ints
    """Index of the wall that is hit; negative if no wall is hit."""
    loss: float
    """Maximum probability of a missing return without an effect."""
    stray: float
    """Maximum share of outliers without an effect."""
    core: tuple[float, float]
    """Lower and upper limit of the scale of the nominal noise without an effect."""

    def lost(self, chance: Floats | float, some: Bools) -> float:
        """Return the expected evidence [nats] if rays `some` return with probability `chance`, losses refitted."""
        ...

    def nats_of_columns(self, columns: Floats, size: float) -> list[float]:
        """Return the expected evidence [nats] of each of several smooth changes of the readings, nuisances refitted.

        Parameters
        ----------
        columns : (n_scans, k, n_rays) Change of the readings per unit.
        size : Size of the change, in units.
        """
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class DrivenMotion:
    """Motion that an effect of wheels or motors changes; arrays (n,).

    Of the wheels: between two averages of the reference pose. Of the simulated motors: per second.
    """

    distance: Floats
    """[m or m/s] Distance along the heading."""
    turn: Floats
    """[rad or rad/s] Turn."""
    path: Floats
    """[m or m/s] Length of the path."""
    base: float
    """[m] Wheelbase."""


@dataclass(frozen=True, kw_only=True)
class Regressor:
    """Column of an error in the regression of the reference on the wheels, or of the odometry on the simulated motors."""

    column: Callable[[DrivenMotion], tuple[Floats, Floats]]
    """Return the change of distance (n,) and of turn (n,) of the measured side per unit of the coefficient."""
    tolerance: float
    """Standard deviation of the coefficient in a careful setup."""
    size: Callable[[float, float], float] = lambda coefficient, gain: coefficient
    """Return the parameter of the effect from its coefficient and the gain of both wheels (true over measured)."""
    stderr: Callable[[float, float], float] = lambda error, gain: error
    """Return the standard error of the parameter from that of the coefficient and the gain."""
