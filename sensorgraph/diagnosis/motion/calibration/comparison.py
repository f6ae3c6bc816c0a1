"""Compare the calibration of wheels and mount between two runs of one robot, or between parts of one run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from sensorgraph.diagnosis.motion.calibration.estimate import (
    NUISANCES,
    PARAMETERS,
    DrivingCalibration,
    WindowRows,
    calibrate,
)
from sensorgraph.diagnosis.motion.calibration.laser_motion import LaserMotion
from sensorgraph.diagnosis.motion.calibration.settings import CALIBRATION
from sensorgraph.diagnosis.motion.calibration.words import QUANTITIES
from sensorgraph.types import Floats


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
    limit = _threshold(CALIBRATION.level / len(PARAMETERS))
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
    s, n = CALIBRATION, len(motion.first)
    if not is_long_enough(found):
        return None
    at = [n * b // s.blocks for b in range(s.blocks // 4, s.blocks - s.blocks // 4 + 1)]
    splits = [k for k in at if min(k, n - k) >= s.window * s.least_side]
    best: Difference | None = None
    for k in splits:
        sides = compare(calibrate(motion.part(slice(0, k))), calibrate(motion.part(slice(k, n))))
        for one in sides:
            one = replace(one, threshold=_threshold(s.level / (len(PARAMETERS) * len(splits))))
            if one.differs and one.is_material and (best is None or _sigmas(one) > _sigmas(best)):
                best = one
    if best is None:
        return None
    return Change(difference=best, at_s=_time_of(found.rows, PARAMETERS.index(best.name)))


def is_long_enough(found: DrivingCalibration) -> bool:
    """Tell whether a run has enough windows before and after a change to show it."""
    return len(found.rows.scores) >= 2 * CALIBRATION.least_side


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
    least = max(n // CALIBRATION.blocks, 1)
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
