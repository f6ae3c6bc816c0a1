"""A wrong angle between the rays: found from the run itself.

With bearings that are 3 % too wide, a turning robot sees the same walls from several headings in different shapes. The scale
of the bearings is one more unknown of the equations of the ray times (`turning_pieces`), so that a sweep, which also
stretches the scans of a robot that turns to one side, is not taken for it, nor are wheels that turn too much.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from logs.motion import Motion
from logs.run import RangeSensor
from sensorgraph.localization.turning_pieces import MAX_STEPS, LinearisedPieces, TurningPieces, sweep_basis

LEAST = 0.005
"""Minimum relative error of the step that is corrected: 0.7° at either end of a view of 270°."""
MOST = 0.3
"""Maximum relative error that is sought; a narrow view may show any."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BearingScale:
    """The right step of the bearings, relative to the stated one."""

    value: float
    stderr: float
    kept: str
    """Ray whose bearing is right: first, middle or last."""

    def of(self, sensor: RangeSensor) -> RangeSensor:
        """Return a sensor with the right bearings."""
        at = _kept(sensor)[self.kept]
        return replace(sensor, bearings=at + self.value * (sensor.bearings - at))

    @property
    def line(self) -> str:
        """One line for the user."""
        return (
            f"the step of the bearings is {self.value:.3f} ± {self.stderr:.4f} of the stated one: corrected, with the "
            f"bearing of the {self.kept} ray as stated (check `angle_increment`)"
        )


def estimated_scale(
    sensor: RangeSensor, pieces: TurningPieces, start: LinearisedPieces, motion: Motion
) -> tuple[float, float] | None:
    """Return the right step of the bearings, relative to that of the sensor, and its standard error; None if it is not found.

    Parameters
    ----------
    sensor : With the ray times that the run shows.
    start : `pieces`, linearised at these.
    motion : Motion of base_link, from the odometry or the track.
    """
    basis, bearings = sweep_basis(sensor.n_rays), sensor.bearings - sensor.bearings.mean()
    scale, times, equations = 1.0, np.zeros(basis.shape[1]), start
    for step in range(MAX_STEPS):  # each leaves half of an error or less
        found = equations.estimate(basis, bearings[:, None])
        change, stderr = float(found.change[-1]), float(np.sqrt(found.covariance[-1, -1]))
        scale, times = scale + change, times + found.change[:-1]
        if abs(scale - 1.0) > MOST:
            return None
        if abs(change) < (0.5 if step == 0 else 0.1) * LEAST:  # the first step finds half, or more
            return scale, stderr
        scaled = replace(sensor, bearings=sensor.bearings.mean() + scale * bearings)
        there = replace(pieces, run=replace(pieces.run, sensor=scaled))
        equations = there.linearised(sensor.ray_delays + basis @ times, motion)
    return None


def kept_ray(sensor: RangeSensor, scale: float, turned: float | None) -> str:
    """Return which of the first, the middle and the last ray has its stated bearing.

    Parameters
    ----------
    turned : [rad] From the motion of the odometry to that of the scans, which the kept ray explains best. None: the first one is kept.
    """
    kept = _kept(sensor)
    if turned is None:
        return "first"
    return min(kept, key=lambda name: abs((scale - 1.0) * (kept[name] - kept["middle"]) - turned))


def _kept(sensor: RangeSensor) -> dict[str, float]:
    """Return the bearings that may be right."""
    first, last = map(float, sensor.bearings[[0, -1]])
    return {"first": first, "middle": 0.5 * (first + last), "last": last}
