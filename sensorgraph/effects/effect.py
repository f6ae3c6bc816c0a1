"""Effect: one piece of physics that a bare ray caster lacks; Amendment: an effect with its numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from sensorgraph.types import Floats

Channel = Literal["scan", "odometry", "drive"]
Place = Literal["wall", "obstacle", "spot", "sector"]


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One number of an effect."""

    name: str
    unit: str
    doc: str
    neutral: float | None = 0.0
    """The value that changes nothing; None: no single value does."""
    materiality: float | None = None
    """A smaller size is within the tolerance of a careful set-up; None: the size is not this number's."""
    low: float = -float("inf")
    high: float = float("inf")


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

    def __call__(self, **values: float) -> Amendment:
        """Return the effect with these parameter values; `place` is set with `.at`."""
        return Amendment(effect=self, parameters=values)

    @property
    def sizes(self) -> dict[str, float]:
        """Parameters that have a materiality -> that materiality."""
        return {p.name: p.materiality for p in self.parameters if p.materiality is not None}


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

    def __getitem__(self, name: str) -> float:
        return self.parameters[name]

    def __call__(self, thing: Any) -> None:
        """Apply it to a Scene (channel scan) or a Machine."""
        self.effect.transform(thing, self)

    def at(self, name: str = "", xy: Floats | tuple[float, float] | None = None) -> Amendment:
        """Return it with a location."""
        point = None if xy is None else (float(xy[0]), float(xy[1]))
        return self._with(location=Location(name=name, xy=point))

    def moved_to(self, values: Mapping[str, float]) -> Amendment:
        """Return it with some parameters replaced."""
        return self._with(parameters={**self.parameters, **values})

    def _with(self, **changes: Any) -> Amendment:
        from dataclasses import replace

        return replace(self, **changes)

    @property
    def ratio(self) -> float:
        """Its size over its materiality; inf for an effect that has no limit of size."""
        return size_ratio(self.effect, self.parameters)


def size_ratio(effect: Effect, values: Mapping[str, float]) -> float:
    """Return how many times its materiality an effect is (several sizes add as a vector)."""
    sizes = {k: m for k, m in effect.sizes.items() if k in values}
    if not sizes:
        return float("inf")
    return float(sum((values[k] / m) ** 2 for k, m in sizes.items()) ** 0.5)
