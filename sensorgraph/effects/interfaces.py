"""What diagnosis shows to the functions of an effect, and what these give back.

An effect knows how it would show in residuals, and what a run must have seen to show it. Its functions take the views
below; `sensorgraph.diagnosis.scan` implements them.
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
    """Start values of an effect that is worth fitting."""

    values: Mapping[str, float]
    gain: float
    """[nats] that the frozen nuisances promise."""
    place: str = ""
    """Name of the wall or obstacle."""
    xy: Floats | tuple[float, float] | None = None
    """[m, map]"""


@dataclass(frozen=True, kw_only=True, eq=False)
class CornerShift:
    """An effect at one place of the map, as a shift of the map's corners."""

    shift: Floats
    """(n_corners, 2, k) [m per unit] of each corner by each of the effect's smooth parameters."""
    place: str = ""
    xy: Floats | None = None


class Present(Protocol):
    """An effect that is in the model already."""

    @property
    def name(self) -> str:
        """The effect's canonical name."""
        ...

    @property
    def place(self) -> str:
        """Name of the wall or obstacle."""
        ...

    @property
    def parameters(self) -> Mapping[str, float]:
        """Its values."""
        ...


class Residuals(Protocol):
    """What a fit expects of every reading, and what was measured instead; arrays (n_scans, n_rays)."""

    arena: Arena
    sensor: RangeSensor
    model: Sequence[Present]
    """Effects of the fit."""
    walls: Floats
    """(n_walls, 2, 2) [m] as the fit has them."""
    beams: Beams
    z: Floats
    """[m] measured; +inf nothing seen, -inf too near."""
    reached: Floats
    """[m] how far the rays went: as measured, or to where the map ends; nan broken."""
    mu: Floats
    """[m] expected."""
    residual: Floats
    """[m] measured minus expected; 0 where either is missing."""
    weight: Floats
    """[1/m²] of the residual in the fit; 0 for strays."""
    sigma: Floats
    """[m] standard deviation of the core of the noise, as fitted."""
    nominal_sigma: Floats
    """[m] the same as robot.yaml has it."""
    stray: Floats
    """Chance that a reading comes from anywhere."""
    log_p: Floats
    """[nats] log-likelihood of every reading."""
    tail: float
    """Share of returns in the wide part of the noise."""
    loss: float
    """Chance that a ray which should return does not."""
    returned: Bools
    lost: Bools
    near: Bools
    """Too near to be measured."""
    aimed: Bools
    """The fit expects a return."""
    strange: Bools
    """Returns that the fit takes for strays."""
    short: Bools
    """Strange, and clearly shorter than expected."""
    long: Bools
    """Strange, and clearly longer than expected."""
    valid: Bools
    """Residuals here follow smoothly from poses and map."""

    @property
    def certain_loss(self) -> Floats:
        """[nats] gained by the claim that a ray cannot return."""
        ...

    @property
    def along(self) -> Floats:
        """[m] from the first end of the wall that is hit; nan off the walls."""
        ...

    @property
    def incidence(self) -> Floats:
        """[rad] nan where nothing is hit."""
        ...

    def ends(self, some: Bools) -> Floats:
        """Return where the measured rays end, (n, 2) [m, map]."""
        ...

    def likely(self, mu: Floats, some: Bools | None = None) -> Floats:
        """Return log-likelihoods [nats] under other expected readings; arrays (n_scans, n_rays) or (n,) of `some`."""
        ...


class Exposure(Protocol):
    """What the rays of a run have met, and so could have shown; arrays (n_scans, n_rays)."""

    arena: Arena
    sensor: RangeSensor
    twists: Floats
    """(n_scans, 3) [m/s, m/s, rad/s]"""
    span: float
    """[s] length of the run."""
    beams: Beams
    seen: Bools
    """A return is expected."""
    n_seen: int
    valid: Bools
    """Readings here follow smoothly from poses and map."""
    reading: Floats
    """[m] expected; may be inf."""
    range: Floats
    """[m] expected; 0 where none is."""
    incidence: Floats
    """[rad] 0 where nothing is seen."""
    wall: Ints
    """Index of the wall that is hit; negative off the walls."""
    loss: float
    """Chance of a lost ray, at most, that needs no effect."""
    stray: float
    """Share of readings from anywhere, at most, that needs no effect."""
    core: tuple[float, float]
    """Scales that the nominal noise may have without an effect."""

    def lost(self, chance: Floats | float, some: Bools) -> float:
        """Return the evidence [nats] expected if rays `some` return by `chance` only, losses refitted."""
        ...

    def nats_of_columns(self, columns: Floats, size: float) -> list[float]:
        """Return the evidence [nats] expected of each of several smooth changes of the readings, nuisances refitted.

        Parameters
        ----------
        columns : (n_scans, k, n_rays) change of the readings per unit
        size : of the change, in units
        """
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class WheelMotion:
    """What the wheels say between two averages of the reference; arrays (n,)."""

    distance: Floats
    """[m] along the heading of the reference."""
    turn: Floats
    """[rad]"""
    path: Floats
    """[m] along the path."""
    base: float
    """[m] wheelbase."""


@dataclass(frozen=True, kw_only=True)
class WheelRegressor:
    """How an error of the wheels enters the regression of what the reference did on what the wheels say."""

    column: Callable[[WheelMotion], tuple[Floats, Floats]]
    """Return the change of distance (n,) [m] and of turn (n,) [rad] of the reference per unit of the coefficient."""
    tolerance: float
    """Standard deviation of the coefficient in a careful set-up."""
    size: Callable[[float, float], float]
    """Return the effect's parameter from its coefficient and the gain of both wheels (true over measured)."""
    stderr: Callable[[float, float], float] = lambda error, gain: error
    """Return the parameter's standard error from that of the coefficient, and the gain."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MotorMotion:
    """What the simulated motors do between two stamps of the odometry; arrays (n,)."""

    v: Floats
    """[m/s] mean speed."""
    omega: Floats
    """[rad/s] mean turn rate."""
    duration: Floats
    """[s] between the stamps."""


@dataclass(frozen=True, kw_only=True)
class MotorRegressor:
    """How an error of the motors enters the regression of odometry on simulated motors.

    The coefficient is the effect's one parameter.
    """

    column: Callable[[MotorMotion], tuple[Floats, Floats]]
    """Return the change of speed (n,) [m/s] and of turn rate (n,) [rad/s] per unit of the parameter."""
    tolerance: float
    """Standard deviation of the parameter in a careful set-up."""
