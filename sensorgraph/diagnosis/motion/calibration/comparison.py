"""Calibrated quantities, and their comparison between two runs of one robot, or between parts of one run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from sensorgraph.diagnosis.motion.calibration.estimate import (
    PARAMETERS,
    DrivingCalibration,
    WindowRows,
)
from sensorgraph.diagnosis.motion.calibration.laser_motion import BLOCKS
from sensorgraph.effects.effect import Effect
from sensorgraph.effects.latency import LATENCY
from sensorgraph.effects.mount_xy import MOUNT_XY
from sensorgraph.effects.mount_yaw import MOUNT_YAW
from sensorgraph.effects.range_scale import RANGE_SCALE
from sensorgraph.effects.wheel_base import WHEEL_BASE
from sensorgraph.effects.wheel_radius import WHEEL_RADIUS
from sensorgraph.effects.wheel_radius_diff import WHEEL_RADIUS_DIFF
from sensorgraph.world.robot import Wheels

LEVEL = 0.05
"""Probability of a reported difference between two equal runs (over all parameters, Bonferroni)."""
PER_SI = {"%": 100.0, "cm": 100.0, "ms": 1000.0} | dict.fromkeys(("°", "°/m"), float(np.degrees(1.0)))
"""Unit -> its number in one SI unit."""


def most_by_chance(n_tests: int) -> float:
    """Return the standard errors that the largest of all parameters exceeds by chance in one of 20 equal pairs of runs."""
    return NormalDist().inv_cdf(1 - LEVEL / (2 * len(PARAMETERS) * n_tests))


SURE = most_by_chance(1)
"""Standard errors. Of 100 robots without any error, five exceed it in one of the six parameters."""


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """How a parameter is printed."""

    title: str
    unit: str
    """One of PER_SI."""
    effect: Effect
    """Effect that it becomes in a report."""
    causes: str
    """Possible causes of a change."""
    per_effect: float = 1.0
    """[SI] Its change per unit of the effect."""

    @property
    def factor(self) -> float:
        """From SI to the unit."""
        return PER_SI[self.unit]

    @property
    def materiality(self) -> float:
        """[SI] minimum size that is reported."""
        return next(iter(self.effect.sizes.values())) * self.per_effect

    def is_off(self, value: float, stderr: float) -> bool:
        """Tell whether a value [SI] is surely not zero and large enough to matter."""
        return abs(value) > max(SURE * stderr, self.materiality)

    def text(self, value: float, stderr: float, *, sign: bool = True) -> str:
        """Return value and standard error in the unit."""
        digits = max(0, min(3, 1 - int(np.floor(np.log10(max(abs(self.factor * stderr), 1e-3))))))
        number = f"{self.factor * value:{'+' if sign else ''}.{digits}f}".replace("-", "−")
        space = "" if self.unit.startswith("°") else " "
        return f"{number}{space}{self.unit} ± {self.factor * stderr:.{digits}f}{space}{self.unit}"


QUANTITIES: Mapping[str, Quantity] = {
    "way_scale": Quantity(
        title="distance scale",
        unit="%",
        effect=WHEEL_RADIUS,
        causes="tyre pressure or wear, a load, another floor, or another laser",
    ),
    "turn_scale": Quantity(
        title="turn scale",
        unit="%",
        effect=WHEEL_BASE,
        causes="a change of tyre, load or floor, which moves the contact points of the wheels",
    ),
    "heading_bias": Quantity(
        title="heading bias",
        unit="°/m",
        effect=WHEEL_RADIUS_DIFF,
        causes="pressure loss or wear of one tyre, or a load on one side",
        per_effect=1.0 / Wheels().base,
    ),
    "mount_x": Quantity(
        title="mount x",
        unit="cm",
        effect=MOUNT_XY,
        causes="the laser was moved, or a load shifts the centre of rotation",
    ),
    "mount_y": Quantity(title="mount y", unit="cm", effect=MOUNT_XY, causes="the laser was moved"),
    "mount_phi": Quantity(
        title="mount angle",
        unit="°",
        effect=MOUNT_YAW,
        causes="the laser was knocked, or the robot slides sideways on another floor",
    ),
    "delay": Quantity(
        title="scan delay",
        unit="ms",
        effect=LATENCY,
        causes="another driver, or a busy computer",
    ),
}
ABSORBED: Mapping[str, str] = {
    RANGE_SCALE.name: "too long ranges enlarge the map and make the wheels seem too small by the same factor, so that the "
    "distance scale is relative to the laser",
    "map_error": "the map is built from the run's own scans; its straightness is known only as far as loops close",
    "pose_error": "the poses fit the scans by construction; only motions between scans, matched without the wheels, are "
    "compared with the wheels",
}
"""What poses from the run's own scans absorb -> explanation."""


@dataclass(frozen=True, kw_only=True)
class Difference:
    """One parameter in two runs."""

    name: str
    """One of PARAMETERS."""
    first: float
    second: float
    stderr: float
    """Of the difference; twice this value covers 95 %."""
    threshold: float
    """Standard errors above which the runs differ."""
    is_shown: bool = True
    """Whether both runs show the parameter."""

    @property
    def value(self) -> float:
        """Second run minus first run."""
        return self.second - self.first

    @property
    def differs(self) -> bool:
        """Tell whether the difference is larger than chance."""
        return abs(self.value) > self.threshold * self.stderr

    @property
    def is_material(self) -> bool:
        """Tell whether the difference exceeds the accuracy of a careful setup."""
        return abs(self.value) > QUANTITIES[self.name].materiality


@dataclass(frozen=True, kw_only=True)
class Change:
    """A parameter that changed once during a run."""

    difference: Difference
    """Values before (first) and after (second) the change."""
    at_s: float
    """[s] since the first scan."""

    @property
    def evidence(self) -> float:
        """Return the evidence [nats] of the change: half the square of its standard errors."""
        return 0.5 * (self.difference.value / self.difference.stderr) ** 2

    @property
    def sentence(self) -> str:
        """Return the change in words, with its possible causes."""
        one, q = self.difference, QUANTITIES[self.difference.name]
        return (
            f"The {q.title} changes during the run, at about {self.at_s:.0f} s, "
            f"by {q.text(one.value, one.stderr)}: {q.causes}"
        )


def compare(
    first: DrivingCalibration, second: DrivingCalibration, n_tests: int = 1
) -> tuple[Difference, ...]:
    """Compare wheels and mount of two runs, in the order of PARAMETERS.

    Parameters
    ----------
    n_tests : Number of such comparisons, which the threshold accounts for (Bonferroni).
    """
    stderr = np.hypot(first.stderr, second.stderr)
    return tuple(
        Difference(
            name=name,
            first=float(first.values[k]),
            second=float(second.values[k]),
            stderr=float(stderr[k]),
            threshold=most_by_chance(n_tests),
            is_shown=not (name in first.hidden or name in second.hidden),
        )
        for k, name in enumerate(PARAMETERS)
    )


def change_within(found: DrivingCalibration) -> Change | None:
    """Return the parameter that changed once during a run; None if none did.

    Each border between blocks with at least a quarter of the run on either side is tried (in the spirit of Andrews
    1993). The change happened where two values of the parameter explain the rows best.
    """
    n = found.rows.n
    if not is_long_enough(found):
        return None
    at = [n * b // BLOCKS for b in range(BLOCKS // 4, BLOCKS - BLOCKS // 4 + 1)]
    splits = [k for k in at if min(k, n - k) >= BLOCKS**2 // 2]
    sides = [(found.part(slice(0, k)), found.part(slice(k, n))) for k in splits]
    told = [one for pair in sides for one in compare(*pair, len(splits)) if one.differs and one.is_material]
    if not told:
        return None
    best = max(told, key=lambda one: abs(one.value) / one.stderr)
    return Change(difference=best, at_s=_time_of(found.rows, PARAMETERS.index(best.name)))


def is_long_enough(found: DrivingCalibration) -> bool:
    """Tell whether a run has enough windows to show a change: as many in each block as there are blocks."""
    return found.rows.n >= BLOCKS**2


def _time_of(rows: WindowRows, parameter: int) -> float:
    """Return the time [s] at which one parameter changed: the most likely one, an eighth of the run from either end."""
    prior = replace(
        rows.prior,
        **{
            k: np.append(v, getattr(rows.prior, k))
            for k, v in (("mean", 0.0), ("sigma", np.inf), ("reach", np.inf))
        },
    )
    first, gains = max(rows.n // BLOCKS, 1), []
    for k in range(first, rows.n - first + 1):
        late = rows.A[:, :, parameter] * (np.arange(rows.n) >= k)[:, None]
        gains.append(rows.regression(late).solve(prior).log_posterior)
    return float(rows.from_s[first + int(np.argmax(gains))])
