"""Evidence for a fault from an estimate of its size: a healthy robot against a faulty one, both with stated priors.

A healthy robot has a size of N(b, t²): the baseline b and the tolerance t. A faulty one has N(b, t² + s²). An estimate
with the standard error e has the log Bayes factor

    log N(estimate; b, e² + t² + s²) - log N(estimate; b, e² + t²).

The wider prior is the Occam factor. With the prior odds of a fault, it gives a probability.

Where e comes from the scatter of few measurements, with ν degrees of freedom, N is Student's t with ν in place of the
normal distribution. After two seconds of driving, the scatter itself is hardly known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

from scipy.special import expit

from sensorgraph.diagnosis.report.quantities import number
from sensorgraph.effects.latency import LATENCY
from sensorgraph.effects.wheel_radius import WHEEL_RADIUS
from sensorgraph.effects.wheel_radius_diff import WHEEL_RADIUS_DIFF
from sensorgraph.watching.settings import FaultPrior

UNITS = {
    "s": (1e3, " ms"), "m": (1e3, " mm"), "rad": (math.degrees(1.0), "°"), "rad_per_m": (math.degrees(1.0), "°/m"),
    "scale": (1e2, " %"), "share": (1e2, " %"), "from_rad": (math.degrees(1.0), "°"), "to_rad": (math.degrees(1.0), "°"),
}  # fmt: skip
"""Key of a size -> factor and unit for readers."""
WORDS = {WHEEL_RADIUS.name: "distance scale", WHEEL_RADIUS_DIFF.name: "heading bias"}
"""Name -> quantity that is printed, as `locate` and the calibration print it: what the odometry misses. The size of the effect of
this name has the opposite sign: what the odometry reports in excess."""


@dataclass(frozen=True, kw_only=True)
class Baseline:
    """Size of one parameter of a healthy robot."""

    value: float = 0.0
    tolerance: float = 0.0


@dataclass(frozen=True, kw_only=True)
class FaultDoubt:
    """One hypothesis about laser or wheels, with its probability."""

    name: str
    p: float
    parameters: dict[str, float]
    stderr: dict[str, float]
    nats: float
    """Evidence against a healthy robot."""
    since: float = 0.0
    """[s]"""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {
            "name": self.name,
            "parameters": {key: round(value, 6) for key, value in self.parameters.items()},
            "stderr": {key: round(value, 6) for key, value in self.stderr.items() if math.isfinite(value)},
            "p": round(self.p, 6),
            "nats": round(self.nats, 2),
            "since": round(self.since, 3),
        }

    def sentence(self) -> str:
        """Return the hypothesis with its sizes."""
        between = " " if "from_rad" in self.parameters else ", "
        sizes = between.join(
            _size(key, value, self.stderr.get(key, math.inf)) for key, value in self.parameters.items()
        )
        if self.name == LATENCY.name:  # `diagnose` counts the age of a scan, which has the opposite sign
            older = self.parameters["s"] < 0
            size = number(abs(1e3 * self.parameters["s"]), 1e3 * self.stderr.get("s", math.inf))
            return f"latency: scans {size} ms {'older' if older else 'newer'} than their stamps"
        return f"{WORDS.get(self.name, self.name.replace('_', ' '))} {sizes}"


def _size(key: str, value: float, stderr: float) -> str:
    """Return a size with its standard error in the unit of readers."""
    if key not in UNITS:
        return f"{key} {number(value, stderr)}"
    factor, unit = UNITS[key]
    if key in ("from_rad", "to_rad"):
        word = "from" if key == "from_rad" else "to"
        return f"{word} {number(factor * value)}{unit}"
    return f"{number(factor * value, factor * stderr, signed=key != 'share')}{unit}"


def doubt_of(
    fault: FaultPrior,
    estimate: float,
    stderr: float,
    log_odds: float,
    baseline: Baseline | None = None,
    freedom: float = math.inf,
) -> FaultDoubt:
    """Return the doubt about one parameter from its estimate; `log_odds` are those of the fault before.

    Parameters
    ----------
    freedom : Degrees of freedom of the standard error.
    """
    base = baseline or Baseline(tolerance=fault.tolerance)
    healthy = stderr**2 + base.tolerance**2
    faulty = healthy + fault.size**2
    square = (estimate - base.value) ** 2
    nats = 0.0
    if math.isfinite(stderr):  # without data, nothing is known
        nats = _misfit(square / healthy, freedom) - _misfit(square / faulty, freedom)
        nats -= 0.5 * math.log(faulty / healthy)
    return FaultDoubt(
        name=fault.name, p=float(expit(nats + log_odds)), nats=nats,
        parameters={fault.parameter: estimate - base.value}, stderr={fault.parameter: math.sqrt(healthy)},
    )  # fmt: skip


def _misfit(square: float, freedom: float) -> float:
    """Return the negative logarithm of a t density at a squared deviation in standard errors, relative to its maximum."""
    if math.isinf(freedom):
        return 0.5 * square
    return 0.5 * (freedom + 1.0) * math.log1p(square / freedom)


class Collects(Protocol):
    """Evidence that knows for how long it has been collected."""

    age: float


T = TypeVar("T", bound=Collects)


class Pair(Generic[T]):
    """Two collections of the same evidence, begun one period apart: the older one forgets all after two periods."""

    def __init__(self, make: type[T], period: float) -> None:
        self.make, self.period = make, period
        self.older, self.younger = make(), make()
        self.younger.age = -math.inf

    def advance(self, dt: float) -> None:
        """Let time [s] pass, and begin a new collection when one is due."""
        for one in (self.older, self.younger):
            one.age += dt
        if self.older.age >= 2 * self.period:
            self.older, self.younger = self.younger, self.make()
        elif self.older.age >= self.period and not math.isfinite(self.younger.age):
            self.younger = self.make()

    @property
    def both(self) -> list[T]:
        """The collections that have begun."""
        return [one for one in (self.older, self.younger) if math.isfinite(one.age)]
