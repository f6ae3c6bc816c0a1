"""Calibrated quantities, and their comparison between two runs of one robot, or between parts of one run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from sensorgraph.diagnosis.motion.calibration.estimate import (
    BLOCKS,
    NUISANCES,
    PARAMETERS,
    DrivingCalibration,
    WindowRows,
    calibrate,
)
from sensorgraph.diagnosis.motion.calibration.laser_motion import WINDOW, LaserMotion
from sensorgraph.effects.effect import Effect
from sensorgraph.effects.latency import LATENCY
from sensorgraph.effects.mount_xy import MOUNT_XY
from sensorgraph.effects.mount_yaw import MOUNT_YAW
from sensorgraph.effects.range_scale import RANGE_SCALE
from sensorgraph.effects.wheel_base import WHEEL_BASE
from sensorgraph.effects.wheel_radius import WHEEL_RADIUS
from sensorgraph.effects.wheel_radius_diff import WHEEL_RADIUS_DIFF
from sensorgraph.types import Floats
from sensorgraph.world.robot import Wheels

LEAST_SIDE = 32
"""Minimum number of windows before and after a change during a run."""
LEVEL = 0.05
"""Probability of a reported difference between two equal runs (over all parameters, Bonferroni)."""


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """How a parameter is printed."""

    title: str
    unit: str
    factor: float
    """From SI to the unit."""
    materiality: float
    """[SI] minimum size that is reported."""
    causes: str
    """Possible causes of a change."""

    def text(self, value: float, stderr: float, *, sign: bool = True) -> str:
        """Return value and standard error in the unit."""
        digits = max(0, min(3, 1 - int(np.floor(np.log10(max(abs(self.factor * stderr), 1e-3))))))
        number = f"{self.factor * value:{'+' if sign else ''}.{digits}f}".replace("-", "−")
        space = "" if self.unit.startswith("°") else " "
        return f"{number}{space}{self.unit} ± {self.factor * stderr:.{digits}f}{space}{self.unit}"


def _material(effect: Effect, index: int = 0) -> float:
    """Return the materiality of a parameter of an effect."""
    size = effect.parameters[index].materiality
    assert size is not None
    return size


QUANTITIES: Mapping[str, Quantity] = {
    "way_scale": Quantity(
        title="distance scale",
        unit="%",
        factor=100.0,
        materiality=_material(WHEEL_RADIUS, 0),
        causes="tyre pressure or wear, a load, another floor, or another laser",
    ),
    "turn_scale": Quantity(
        title="turn scale",
        unit="%",
        factor=100.0,
        materiality=_material(WHEEL_BASE, 0),
        causes="a change of tyre, load or floor, which moves the contact points of the wheels",
    ),
    "heading_bias": Quantity(
        title="heading bias",
        unit="°/m",
        factor=float(np.degrees(1.0)),
        materiality=_material(WHEEL_RADIUS_DIFF, 0) / Wheels().base,
        causes="pressure loss or wear of one tyre, or a load on one side",
    ),
    "mount_x": Quantity(
        title="mount x",
        unit="cm",
        factor=100.0,
        materiality=_material(MOUNT_XY, 0),
        causes="the laser was moved, or a load shifts the centre of rotation",
    ),
    "mount_y": Quantity(
        title="mount y",
        unit="cm",
        factor=100.0,
        materiality=_material(MOUNT_XY, 1),
        causes="the laser was moved",
    ),
    "mount_phi": Quantity(
        title="mount angle",
        unit="°",
        factor=float(np.degrees(1.0)),
        materiality=_material(MOUNT_YAW, 0),
        causes="the laser was knocked, or the robot slides sideways on another floor",
    ),
    "delay": Quantity(
        title="scan delay",
        unit="ms",
        factor=1e3,
        materiality=0.01,
        causes="another driver, or a busy computer",
    ),
}
EFFECT_OF: Mapping[str, str] = {
    "way_scale": WHEEL_RADIUS.name,
    "turn_scale": WHEEL_BASE.name,
    "heading_bias": WHEEL_RADIUS_DIFF.name,
    "mount_x": MOUNT_XY.name,
    "mount_y": MOUNT_XY.name,
    "mount_phi": MOUNT_YAW.name,
    "delay": LATENCY.name,
}
"""Quantity -> effect that it becomes in a report."""
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


def compare(first: DrivingCalibration, second: DrivingCalibration) -> tuple[Difference, ...]:
    """Compare wheels and mount of two runs, in the order of PARAMETERS."""
    limit = _threshold(LEVEL / len(PARAMETERS))
    stderr = np.hypot(first.stderr, second.stderr)
    return tuple(
        Difference(
            name=name,
            first=float(first.values[k]),
            second=float(second.values[k]),
            stderr=float(stderr[k]),
            threshold=limit,
            is_shown=not (name in first.hidden or name in second.hidden),
        )
        for k, name in enumerate(PARAMETERS)
    )


def change_within(motion: LaserMotion, found: DrivingCalibration) -> Change | None:
    """Return the parameter that changed once during a run; None if none did.

    Each border between blocks with at least a quarter of the run on either side is tried. Both sides are
    calibrated separately and compared. The threshold accounts for the number of borders and parameters
    (Bonferroni, in the spirit of Andrews 1993).

    Parameters
    ----------
    found : Calibration of the whole run.
    """
    n = len(motion.first)
    if not is_long_enough(found):
        return None
    at = [n * b // BLOCKS for b in range(BLOCKS // 4, BLOCKS - BLOCKS // 4 + 1)]
    splits = [k for k in at if min(k, n - k) >= WINDOW * LEAST_SIDE]
    best: Difference | None = None
    for k in splits:
        sides = compare(calibrate(motion.part(slice(0, k))), calibrate(motion.part(slice(k, n))))
        for one in sides:
            one = replace(one, threshold=_threshold(LEVEL / (len(PARAMETERS) * len(splits))))
            if one.differs and one.is_material and (best is None or _sigmas(one) > _sigmas(best)):
                best = one
    if best is None:
        return None
    return Change(difference=best, at_s=_time_of(found.rows, PARAMETERS.index(best.name)))


def is_long_enough(found: DrivingCalibration) -> bool:
    """Tell whether a run has enough windows before and after a change to show it."""
    return len(found.rows.scores) >= 2 * LEAST_SIDE


def part_of(rows: WindowRows, chosen: slice) -> WindowRows:
    """Return some windows."""
    return replace(
        rows,
        information=rows.information[chosen],
        scores=rows.scores[chosen],
        from_s=rows.from_s[chosen],
    )


def block_estimates(found: DrivingCalibration, blocks: int) -> tuple[Floats, Floats, Floats]:
    """Return estimates (blocks, 9) and standard errors (blocks, 9) for the parts of a run, and their middles [s].

    A run of fewer windows has fewer parts, and a short drive none.
    """
    rows, n = found.rows, len(found.rows.scores)
    blocks = min(blocks, n)
    values, errors = np.zeros((blocks, found.values.size)), np.zeros((blocks, found.values.size))
    ends = np.append(rows.from_s, found.duration_s)
    middles = np.zeros(blocks)
    for b in range(blocks):
        own = part_of(rows, slice(n * b // blocks, n * (b + 1) // blocks))
        inverse = np.linalg.inv(own.information.sum(axis=0) + rows.prior)
        values[b] = found.values + inverse @ own.scores.sum(axis=0)
        errors[b] = np.sqrt(np.diagonal(inverse @ (own.scores.T @ own.scores) @ inverse))
        middles[b] = 0.5 * (ends[n * b // blocks] + ends[n * (b + 1) // blocks])
    return values, errors, middles


def _time_of(rows: WindowRows, parameter: int) -> float:
    """Return the time [s] at which one parameter changed: where two fits gain most over one.

        gain_k = (S_k - S_n I_k / I_n)² / (I_k (1 - I_k / I_n))

    S_k and I_k are the score and the information of the parameter up to window k, with the other parameters
    projected out.
    """
    n = len(rows.scores)
    least = max(n // BLOCKS, 1)
    total = rows.information.sum(axis=0) + rows.prior
    kept = [k for k in range(len(PARAMETERS) + len(NUISANCES)) if k != parameter]
    # score and information of the parameter, with the other parameters projected out
    share = total[np.ix_([parameter], kept)] @ np.linalg.inv(total[np.ix_(kept, kept)])
    row = np.zeros(len(total))
    row[parameter], row[kept] = 1.0, -share[0]
    score = np.cumsum(rows.scores @ row)
    information = np.cumsum(np.einsum("a,kab,b->k", row, rows.information, row))
    left, all_of = information[least - 1 : n - least], information[-1]
    gain = (score[least - 1 : n - least] - score[-1] * left / all_of) ** 2 / (left * (1 - left / all_of))
    return float(rows.from_s[least + int(np.argmax(gain))])


def _sigmas(one: Difference) -> float:
    return abs(one.value) / one.stderr


def _threshold(level: float) -> float:
    """Return the number of standard errors that chance exceeds with this probability."""
    return NormalDist().inv_cdf(1 - level / 2)
