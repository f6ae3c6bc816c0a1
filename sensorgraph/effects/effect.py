"""Effect: one piece of physics that a bare ray caster lacks; Amendment: an effect with parameter values.

An `Effect` contains its physics, the fit of each of its parameters (`Parameter`), and the functions with which
diagnosis proposes it, evaluates it, and decides whether a run could show it (`Diagnostics`). A new effect is one
file and one line in `sensorgraph.effects.EFFECTS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from planners.arena import Arena
from sensorgraph.effects.interfaces import (
    CornerShift,
    Exposure,
    Proposal,
    Regressor,
    Residuals,
)
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.effects.set_up import SetUp
from sensorgraph.errors import SensorgraphError, refuse_wrong_types
from sensorgraph.types import Floats, Ints

Channel = Literal["scan", "odometry", "drive"]
Place = Literal["wall", "obstacle", "spot", "sector"]

JUMP = 25.0
"""[m per unit] Change of a reading with a parameter above which the ray jumps to another surface."""


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One parameter of an effect, and its settings in a fit."""

    name: str
    unit: str
    doc: str
    neutral: float | None = 0.0
    """Value without influence; None if there is no such value."""
    materiality: float | None = None
    """Size below which the effect is within the tolerance of a careful setup; None if this parameter is not a size."""
    low: float = -float("inf")
    high: float = float("inf")
    absent_at_zero: bool = False
    """The parameter is absent at 0: it is then neither fitted nor counted as a parameter."""

    step: float | None = None
    """Step of the difference quotient in Gauss-Newton; None if readings do not depend on it smoothly."""
    jump: float = JUMP
    """[m per unit] Difference quotient above which the ray jumps to another surface."""
    search_step: float | None = None
    """First step of the search along the likelihood; None if it is not searched."""
    refit: bool = False
    """Refit the smooth parameters at each value of the likelihood profile, because they compensate most of a change."""
    typical: float | None = None
    """Value at which the effect should be visible, for parameters without a materiality."""
    nuisance: Nuisance | None = None
    """Nuisance parameter of the same kind in each fit; it is 0 while the effect is in the model."""
    hidden: Callable[[SetUp], float] | None = None
    """Function of the setup that returns the error of this parameter, in its unit; None: only its nuisance."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Diagnostics:
    """Properties of an effect that diagnosis needs in addition to its physics; a smooth effect needs none of them.

    The first group defines the search for the effect. Without them, an effect of the scan channel with smooth
    parameters is detected by a score test on its own columns.
    """

    propose: Callable[[Residuals], Sequence[Proposal]] | None = None
    """Search for the effect in the residuals of a fit."""
    sweep: Callable[[Residuals], Sequence[Sequence[Mapping[str, float]]]] | None = None
    """Return groups of start values, weakest first in each group; the best of each group, by casting, is proposed."""
    corner_shifts: Callable[[Arena, Floats, Ints], Sequence[CornerShift]] | None = None
    """Express the effect at each of its places as a shift of the map's corners, whose columns each fit has.

    Takes the arena, the walls of the fit (n_walls, 2, 2) [m], and the corners at the ends of each wall (n_walls, 2).
    """
    second_start: Callable[[float], Mapping[str, float]] | None = None
    """Return values of a second start of the fit, for a run of this length [s]."""
    site_start: Mapping[str, float] | None = None
    """Start values for the fit of a good run, if the effect may belong to a site or its map; None: never in a baseline."""

    wide_beam: bool = False
    """A reading depends on more than one thin ray, so that depth edges are not where that ray passes them."""
    explains: Literal["", "short readings", "strays"] = ""
    """The effect explains single readings anywhere, so that their pattern must be checked."""
    at_edges: bool = False
    """The effect acts at true depth edges, which a fragmentary map does not have."""
    is_lattice: bool = False
    """All readings are on a lattice, independently of other effects."""

    regressor: Regressor | None = None
    """Regressor in the odometry or drive channel; None if the effect has no separate column."""

    leftover_share: float = 0.0
    """Share of the gain of this coarse model below which a further candidate is a remainder of it."""
    leftovers: Mapping[str, float] = field(default_factory=dict)
    """Name of a further candidate -> its share, if larger than `leftover_share`."""
    misfit_share: float | None = None
    """Share of the gain of this coarse model below which a misfit is not reported; None: the share of exact models."""

    tolerance: str = ""
    """Key in the tolerances of robot.yaml that covers the effect without reporting it."""
    hidden_by_slam: bool = False
    """Poses estimated from the same scans absorb the effect."""
    unobservable: Callable[[Exposure, Mapping[str, float], float], str] | None = None
    """Return why a run cannot show the effect at typical values with the needed evidence [nats]; empty if it can.

    A text that starts with places has a colon after them, and no other text has a colon.
    """
    why_unseen: str | Callable[[Exposure], str] = ""
    """Property that a run lacks if it cannot show a smooth effect."""

    is_forecast: bool = True
    """The design of a next run can compare models with and without the effect."""
    question_rank: int | None = None
    """Rank among the effects for which a next run searches if no question is open, lowest first; None: not searched."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Effect:
    """One physical effect: its change of the simulator, its parameters, and its diagnostics."""

    name: str
    """Canonical name, the same in every file and report."""
    title: str
    """Noun phrase for reports, without an article."""
    channel: Channel
    stage: str
    """Stage of the simulator that it changes (`sensorgraph.world.scene.STAGES`, `wheels`, `motors`)."""
    physics: str
    """Physics in one sentence."""
    source: str
    """Source of the physics."""
    varies: str
    """Quantities on which its residual depends; completes "it varies with ..."."""
    rivals: Mapping[str, str]
    """Effect with which it may be confused -> experiment or property that distinguishes them."""
    parameters: tuple[Parameter, ...]
    transform: Callable[[Any, Amendment], None]
    """Change a Scene (channel scan) or a Drivetrain (odometry, drive) in place."""
    place: Place | None = None
    """Kind of its location."""
    equation: str = ""
    """Physics in symbols: r ideal range, z measured, θ bearing, α incidence, t time."""
    absorber: bool = False
    """The effect widens or mixes the distribution and so fits a little of everything; other effects are preferred."""
    diagnostics: Diagnostics = field(default_factory=Diagnostics)

    def __repr__(self) -> str:
        return f"Effect({self.name}: {self.physics})"

    def __call__(self, **values: float) -> Amendment:
        """Return the effect with these parameter values; `.at` sets its location.

        Raises
        ------
        SensorgraphError
            The effect has no parameter of this name, or a value is not a number.
        """
        known = [parameter.name for parameter in self.parameters]
        wrong = next((name for name in values if name not in known), None)
        if wrong is not None:
            raise SensorgraphError(
                f"{self.name} has no parameter `{wrong}`; expected {', '.join(known) or 'none'}"
            )
        refuse_wrong_types(values, dict.fromkeys(values, float))
        return Amendment(effect=self, parameters=values)

    def parameter(self, name: str) -> Parameter:
        """Return the parameter with this name.

        Raises
        ------
        KeyError
            The effect has no such parameter.
        """
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)

    @property
    def sizes(self) -> dict[str, float]:
        """Parameters with a materiality -> their materiality."""
        return {p.name: p.materiality for p in self.parameters if p.materiality is not None}

    @property
    def steps(self) -> dict[str, float]:
        """Parameters of Gauss-Newton -> step of their difference quotient."""
        return {p.name: p.step for p in self.parameters if p.step is not None}

    @property
    def search_steps(self) -> dict[str, float]:
        """Parameters that are searched -> first step of the search."""
        return {p.name: p.search_step for p in self.parameters if p.search_step is not None}

    @property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """Nuisances of its parameters, in the order of the parameters."""
        return tuple(p.nuisance for p in self.parameters if p.nuisance is not None)

    @property
    def on_part_of_wall(self) -> bool:
        """Whether it acts on a wall from `a` to `b` [m from the wall's first end]."""
        return self.place == "wall" and {"a", "b"} <= {p.name for p in self.parameters}

    @property
    def has_own_columns(self) -> bool:
        """Whether it is smooth and detected only by its own difference quotients."""
        d = self.diagnostics
        looked_for = d.propose or d.sweep or d.corner_shifts
        return self.channel == "scan" and bool(self.steps) and not (looked_for or self.nuisances)

    def at_neutral(self) -> Amendment:
        """Return the effect with its neutral values."""
        return self(**{p.name: p.neutral for p in self.parameters if p.neutral is not None})

    def typical(self, times: float) -> dict[str, float]:
        """Return values at which a run should show it: `times` the materiality, else typical, else neutral values."""
        out = {}
        for p in self.parameters:
            value = p.neutral if p.typical is None else p.typical
            value = value if p.materiality is None else times * p.materiality
            if value is not None:
                out[p.name] = value
        return out


@dataclass(frozen=True, kw_only=True)
class Location:
    """Location of an effect: the name of a wall or obstacle, and a point."""

    name: str = ""
    xy: tuple[float, float] | None = None
    """[m, map] Point."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Amendment:
    """An effect with parameter values, which is added to the model of a robot in its arena."""

    effect: Effect
    parameters: Mapping[str, float]
    stderr: Mapping[str, float] = field(default_factory=dict)
    location: Location | None = None
    probability: float | None = None
    evidence: float | None = None
    """[nats] Log Bayes factor of the model with the effect over the model without it."""

    def __repr__(self) -> str:
        numbers = ", ".join(
            f"{k}={v:.4g}" + (f" ± {self.stderr[k]:.2g}" if k in self.stderr else "")
            for k, v in self.parameters.items()
        )
        where = f" at {self.place}" if self.place else ""
        percent = f", {100 * self.probability:.0f} %" if self.probability is not None else ""
        return f"{self.name}({numbers}){where}{percent}"

    @property
    def name(self) -> str:
        """Canonical name of the effect."""
        return self.effect.name

    @property
    def stage(self) -> str:
        """Stage of the simulator that it changes."""
        return self.effect.stage

    @property
    def key(self) -> tuple[object, ...]:
        """Sort key among the amendments of one stage."""
        return (self.name, self.place, *sorted(self.parameters.items()))

    @property
    def place(self) -> str:
        """Name of its wall or obstacle; empty without one."""
        return self.location.name if self.location is not None else ""

    @property
    def steps(self) -> dict[str, float]:
        """Parameters of Gauss-Newton at these values -> step of their difference quotient."""
        return {
            p.name: p.step
            for p in self.effect.parameters
            if p.step is not None and not (p.absent_at_zero and self.parameters.get(p.name, 0.0) <= 0)
        }

    @property
    def search_steps(self) -> dict[str, float]:
        """Its searched parameters -> first step of the search."""
        return {k: step for k, step in self.effect.search_steps.items() if k in self.parameters}

    def __getitem__(self, name: str) -> float:
        return self.parameters[name]

    def __call__(self, target: Any) -> None:
        """Apply it to a Scene (channel scan) or a Drivetrain (odometry, drive)."""
        self.effect.transform(target, self)

    def at(self, name: str = "", xy: Floats | tuple[float, float] | None = None) -> Amendment:
        """Return the amendment with a location."""
        point = None if xy is None else (float(xy[0]), float(xy[1]))
        return replace(self, location=Location(name=name, xy=point))

    def moved_to(self, values: Mapping[str, float]) -> Amendment:
        """Return the amendment with some parameters replaced."""
        return replace(self, parameters={**self.parameters, **values})

    def moved_within_bounds(self, values: Mapping[str, float]) -> Amendment:
        """Return the amendment with some parameters replaced, each limited to its allowed range."""
        allowed = {name: self.effect.parameter(name) for name in values}
        return self.moved_to(
            {
                name: float(min(max(value, allowed[name].low), allowed[name].high))
                for name, value in values.items()
            }
        )

    @property
    def ratio(self) -> float:
        """Size over materiality; inf for an effect without materiality."""
        return size_ratio(self.effect, self.parameters)


def without(model: Sequence[Amendment], *indices: int) -> tuple[Amendment, ...]:
    """Return the other effects of a model."""
    return tuple(a for k, a in enumerate(model) if k not in indices)


def size_ratio(effect: Effect, values: Mapping[str, float]) -> float:
    """Return the ratio of an effect's size to its materiality; several sizes add as a vector."""
    sizes = {k: m for k, m in effect.sizes.items() if k in values}
    if not sizes:
        return float("inf")
    return float(sum((values[k] / m) ** 2 for k, m in sizes.items()) ** 0.5)
