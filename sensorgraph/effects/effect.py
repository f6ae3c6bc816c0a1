"""Effect: one piece of physics that a bare ray caster lacks; Amendment: an effect with its numbers.

Everything that is known about an effect stands on it: its physics, how a fit finds each of its parameters
(`Parameter`), and what diagnosis must know to propose it, to judge it, and to say when it cannot be seen
(`Diagnostics`). A further effect is one file and one line in `sensorgraph.effects.EFFECTS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from planners.arena import Arena
from sensorgraph.effects.interfaces import (
    CornerShift,
    Exposure,
    MotorRegressor,
    Proposal,
    Residuals,
    WheelRegressor,
)
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.effects.set_up import SetUp
from sensorgraph.types import Floats, Ints

Channel = Literal["scan", "odometry", "drive"]
Place = Literal["wall", "obstacle", "spot", "sector"]

JUMP = 25.0
"""[m per unit] a larger change of a reading with a parameter is a jump to another surface."""


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One number of an effect, and how a fit finds it."""

    name: str
    unit: str
    doc: str
    neutral: float | None = 0.0
    """The value that changes nothing; None: no single value does."""
    materiality: float | None = None
    """A smaller size is within the tolerance of a careful set-up; None: the size is not this number's."""
    low: float = -float("inf")
    high: float = float("inf")
    absent_at_zero: bool = False
    """0 says that there is no such thing: it is neither fitted then, nor does it count as a parameter."""

    step: float | None = None
    """Of the difference quotient by which Gauss-Newton solves for it; None: readings do not follow it smoothly."""
    jump: float = JUMP
    """[m per unit] a larger difference quotient is a jump to another surface."""
    search_step: float | None = None
    """First step of the search along the likelihood; None: it is not searched."""
    refit: bool = False
    """Its likelihood profile takes a fit at every value, since smooth parameters make up for most of a change."""
    typical: float | None = None
    """A value at which the effect should show, for parameters without a materiality."""
    nuisance: Nuisance | None = None
    """Its tolerance-sized copy in every fit, held at 0 while the effect is in the model."""
    hidden: Callable[[SetUp], float] | None = None
    """What a careful set-up, or the spacing of the rays, hides of it, in its unit; None: no more than its nuisance."""


@dataclass(frozen=True, kw_only=True)
class Telltale:
    """Effects that cast doubt on themselves where several of them are found in one run.

    Effects that share one such object are counted together.
    """

    least: int
    """So many of them are suspect."""
    statement: str
    """What they point to."""
    distinct: bool = False
    """Different effects are counted, not places of the same one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Diagnostics:
    """What diagnosis knows of an effect beyond its physics. A plain smooth effect needs none of it.

    The first group tells how the effect is looked for. Without any of it, an effect of the scan channel with smooth
    parameters is looked for by the score test on its own columns.
    """

    propose: Callable[[Residuals], Sequence[Proposal]] | None = None
    """Look for the effect in the residuals of a fit."""
    sweep: Callable[[Residuals], Sequence[Sequence[Mapping[str, float]]]] | None = None
    """Return groups of start values, in each the weakest first; the best of each group, by casting them, is proposed."""
    corner_shifts: Callable[[Arena, Floats, Ints], Sequence[CornerShift]] | None = None
    """Express the effect at each of its places as a shift of the map's corners, of which every fit has the columns.

    Takes the arena, the walls of the fit (n_walls, 2, 2) [m], and which corner each wall ends at (n_walls, 2).
    """
    second_start: Callable[[float], Mapping[str, float]] | None = None
    """Return values of a further start of the fit, for a run of this length [s]."""
    site_start: Mapping[str, float] | None = None
    """A site or its map may always show it: where the fit of a good run starts; None: it is never part of a baseline."""

    wide_beam: bool = False
    """A reading is not that of one thin ray, so that edges in depth are not where that ray passes them."""
    explains: Literal["", "short readings", "strays"] = ""
    """It explains readings one by one, wherever they are, and so must be checked against their pattern."""
    at_edges: bool = False
    """It shows at true edges in depth, which a map made of scraps does not have."""
    is_lattice: bool = False
    """Every reading lies on its lattice, whatever else is amiss."""

    wheel_regressor: WheelRegressor | None = None
    """How the odometry channel fits the effect; None: not by a column of its own."""
    motor_regressor: MotorRegressor | None = None
    """How the drive channel fits the effect; None: not by a column of its own."""

    leftover_share: float = 0.0
    """Its model is coarse: what is left gains less than this share of the model's gain, and is no further effect."""
    leftovers: Mapping[str, float] = field(default_factory=dict)
    """The same by the name of the further effect, where that is more."""
    misfit_share: float | None = None
    """The model is coarse: a misfit below this share of the model's gain is no doubt; None: as for exact models."""
    telltale: Telltale | None = None
    stands_back: Callable[[Amendment], float] | None = None
    """Return by how much [m] its part of a wall stands back, if it is not surely more than that; inf: it is more."""

    tolerance: str = ""
    """The key in robot.yaml's tolerances that takes the effect along without a name."""
    hidden_by_slam: bool = False
    """Poses that were estimated from the same scans have taken it along."""
    unobservable: Callable[[Exposure, Mapping[str, float], float], str] | None = None
    """Say why a run cannot show the effect at typical values that take so many nats; empty: it can."""
    why_unseen: str | Callable[[Exposure], str] = ""
    """What a run lacks that cannot show a smooth effect."""
    look_alike: Callable[[Exposure], tuple[str, str] | None] | None = None
    """Return the effect that this run cannot tell from it, and why; None: there is none."""

    is_forecast: bool = True
    """The design of a next run can compare models with it and without it."""
    question_rank: int | None = None
    """Where nothing is open, a next run looks for the effects that have a rank, the lowest first."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Effect:
    """One physical effect: what it does to the simulator, and what is known about it."""

    name: str
    """Canonical; the same in every file and report."""
    title: str
    channel: Channel
    stage: str
    """Which stage of the simulator it changes (`sensorgraph.world.scene.STAGES`, `wheels`, `motors`)."""
    physics: str
    """One sentence."""
    source: str
    """Where the physics is from."""
    varies: str
    """What its residual varies with."""
    rivals: Mapping[str, str]
    """Effects it may be confused with -> what tells them apart."""
    parameters: tuple[Parameter, ...]
    transform: Callable[[Any, Amendment], None]
    """Change a Scene (channel scan) or a Machine (odometry, drive) in place."""
    place: Place | None = None
    """What its location names."""
    equation: str = ""
    """The physics in symbols: r ideal range, z measured, θ bearing, α incidence, t time."""
    absorber: bool = False
    """It widens or mixes the distribution, so that it fits a little of everything; second class when naming."""
    diagnostics: Diagnostics = field(default_factory=Diagnostics)

    def __repr__(self) -> str:
        return f"Effect({self.name}: {self.physics})"

    def __call__(self, **values: float) -> Amendment:
        """Return the effect with these parameter values; `place` is set with `.at`."""
        return Amendment(effect=self, parameters=values)

    def parameter(self, name: str) -> Parameter:
        """Return the parameter of this name.

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
        """Parameters that have a materiality -> that materiality."""
        return {p.name: p.materiality for p in self.parameters if p.materiality is not None}

    @property
    def steps(self) -> dict[str, float]:
        """Parameters that Gauss-Newton solves for -> step of their difference quotient."""
        return {p.name: p.step for p in self.parameters if p.step is not None}

    @property
    def search_steps(self) -> dict[str, float]:
        """Parameters that are searched -> first step of the search."""
        return {p.name: p.search_step for p in self.parameters if p.search_step is not None}

    @property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """Tolerance-sized copies of its parameters, in the order of the parameters."""
        return tuple(p.nuisance for p in self.parameters if p.nuisance is not None)

    @property
    def on_part_of_wall(self) -> bool:
        """It sits on a wall from `a` to `b` [m from the wall's first end]."""
        return self.place == "wall" and {"a", "b"} <= {p.name for p in self.parameters}

    @property
    def has_own_columns(self) -> bool:
        """It is smooth, and nothing but its own difference quotients tells of it."""
        d = self.diagnostics
        looked_for = d.propose or d.sweep or d.corner_shifts
        return self.channel == "scan" and bool(self.steps) and not (looked_for or self.nuisances)

    def at_neutral(self) -> Amendment:
        """Return it with the values that change nothing."""
        return self(**{p.name: p.neutral for p in self.parameters if p.neutral is not None})

    def typical(self, times: float) -> dict[str, float]:
        """Return values at which a run should show it: so many materialities, else typical, else neutral ones."""
        out = {}
        for p in self.parameters:
            value = p.neutral if p.typical is None else p.typical
            value = value if p.materiality is None else times * p.materiality
            if value is not None:
                out[p.name] = value
        return out


@dataclass(frozen=True, kw_only=True)
class Location:
    """Where an effect sits: the name of a wall or obstacle, and a point."""

    name: str = ""
    xy: tuple[float, float] | None = None
    """[m, map]"""


@dataclass(frozen=True, kw_only=True, eq=False)
class Amendment:
    """An effect with its numbers: what is added to the model of a robot in its arena."""

    effect: Effect
    parameters: Mapping[str, float]
    stderr: Mapping[str, float] = field(default_factory=dict)
    location: Location | None = None
    probability: float | None = None
    evidence: float | None = None
    """[nats] by which the data prefer the model with it."""

    def __repr__(self) -> str:
        numbers = ", ".join(
            f"{k}={v:.4g}" + (f" ± {self.stderr[k]:.2g}" if k in self.stderr else "")
            for k, v in self.parameters.items()
        )
        where = f" at {self.place}" if self.place else ""
        sure = f", {100 * self.probability:.0f} %" if self.probability is not None else ""
        return f"{self.name}({numbers}){where}{sure}"

    @property
    def name(self) -> str:
        """The effect's canonical name."""
        return self.effect.name

    @property
    def stage(self) -> str:
        """The stage of the simulator it changes."""
        return self.effect.stage

    @property
    def key(self) -> tuple[object, ...]:
        """What amendments of one stage are sorted by."""
        return (self.name, self.place, *sorted(self.parameters.items()))

    @property
    def place(self) -> str:
        """The name of the wall or obstacle it sits on; empty where it has none."""
        return self.location.name if self.location is not None else ""

    @property
    def steps(self) -> dict[str, float]:
        """Parameters that Gauss-Newton solves for here -> step of their difference quotient."""
        return {
            p.name: p.step
            for p in self.effect.parameters
            if p.step is not None and not (p.absent_at_zero and self.parameters.get(p.name, 0.0) <= 0)
        }

    @property
    def search_steps(self) -> dict[str, float]:
        """Parameters that it has and that are searched -> first step of the search."""
        return {k: step for k, step in self.effect.search_steps.items() if k in self.parameters}

    def __getitem__(self, name: str) -> float:
        return self.parameters[name]

    def __call__(self, thing: Any) -> None:
        """Apply it to a Scene (channel scan) or a Machine."""
        self.effect.transform(thing, self)

    def at(self, name: str = "", xy: Floats | tuple[float, float] | None = None) -> Amendment:
        """Return it with a location."""
        point = None if xy is None else (float(xy[0]), float(xy[1]))
        return replace(self, location=Location(name=name, xy=point))

    def moved_to(self, values: Mapping[str, float]) -> Amendment:
        """Return it with some parameters replaced."""
        return replace(self, parameters={**self.parameters, **values})

    def moved_within_bounds(self, values: Mapping[str, float]) -> Amendment:
        """Return it with some parameters replaced, each by the nearest value that the effect allows."""
        allowed = {name: self.effect.parameter(name) for name in values}
        return self.moved_to(
            {
                name: float(min(max(value, allowed[name].low), allowed[name].high))
                for name, value in values.items()
            }
        )

    @property
    def ratio(self) -> float:
        """Its size over its materiality; inf for an effect that has no limit of size."""
        return size_ratio(self.effect, self.parameters)


def without(model: Sequence[Amendment], *indices: int) -> tuple[Amendment, ...]:
    """Return the other effects of a model."""
    return tuple(a for k, a in enumerate(model) if k not in indices)


def size_ratio(effect: Effect, values: Mapping[str, float]) -> float:
    """Return how many times its materiality an effect is (several sizes add as a vector)."""
    sizes = {k: m for k, m in effect.sizes.items() if k in values}
    if not sizes:
        return float("inf")
    return float(sum((values[k] / m) ** 2 for k, m in sizes.items()) ** 0.5)
