"""RangeSensor: rays, limits and times of a range sensor, and where it sits on the robot."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from logs.arguments import convert_lists
from logs.types import Floats

PoseFrame = Literal["base_link", "laser"]
RARE_TIMES: Mapping[str, int | float] = {"interlaced_sweeps": 1, "sweep_period": 0.0, "first_ray_delay": 0.0}
"""Fields of `RangeSensor` that files contain only if they differ from these defaults."""


def median_step(values: Floats | NDArray[np.int64], otherwise: float) -> float:
    """Return the median step of stamps or bearings (n,), in their unit; `otherwise` for fewer than two."""
    return float(np.median(np.diff(values))) if len(values) > 1 else otherwise


def usual_step(stamps: Floats | NDArray[np.int64], otherwise: float = 0.0) -> float:
    """Return the median step of stamps (n,) that increase, in their unit, as a coarse clock repeats some; else `otherwise`."""
    steps = np.diff(stamps)
    steps = steps[(steps > 1e-9) & np.isfinite(steps)]
    return float(np.median(steps)) if len(steps) else otherwise


def _empty(*shape: int) -> Floats:
    return np.zeros(shape, dtype=np.float64)


@dataclass(frozen=True, kw_only=True, eq=False)
class RangeSensor:
    """Geometry, limits and timing of a planar range sensor."""

    bearings: Floats
    """(n_rays,) [rad] in the laser frame, increasing (counter-clockwise); ray 0 is the rightmost one."""
    range_min: float = 0.05
    """[m] a closer surface gives -inf."""
    range_max: float = 8.0
    """[m] a ray without a surface up to this range gives +inf."""
    mount: Floats = field(default_factory=lambda: _empty(3))
    """(3,) [m, m, rad] laser in base_link."""
    sigma: float = 0.01
    """[m] standard deviation of a range."""
    resolution: float = 0.0
    """[m] ranges are multiples of this step; 0: not rounded."""
    rate: float = 10.0
    """[Hz] scans per second."""
    sweep_time: float = 0.0
    """[s] duration of one sweep, from ray 0 to one ray after the last; negative for a clockwise sweep.
    The value is -0.0 if a laser is clockwise and its log does not state the duration."""
    interlaced_sweeps: int = 1
    """Number of sweeps per scan, each with every n-th ray: 2 for a SICK LMS at 0.5°, whose mirror measures every 1°."""
    sweep_period: float = 0.0
    """[s] from one interlaced sweep to the next, usually one turn of the mirror; negative: the last sweep comes first."""
    first_ray_delay: float = 0.0
    """[s] from the stamp of a scan to ray 0; negative if the driver stamps scans on arrival."""
    height: float = 0.0
    """[m] height of the scan plane above the floor."""
    origins: Floats = field(default_factory=lambda: _empty(0, 2))
    """(n_rays, 2) [m] origin of each ray in the laser frame, for several sensors read as one.
    Default (0, 2): all rays start at the origin of the laser frame."""
    cones: Floats = field(default_factory=lambda: _empty(0))
    """(n_rays,) [rad] opening angle of the cone in which each ray measures the nearest surface.
    Default (0,): rays are thin."""
    delays: Floats = field(default_factory=lambda: _empty(0))
    """(n_rays,) [s] time of each ray after that of ray 0, for several sensors read as one. Default (0,): by `sweep_time`."""

    def __post_init__(self) -> None:
        convert_lists(self, "bearings", "mount", "origins", "cones", "delays")
        if self.bearings.ndim != 1 or len(self.bearings) < 1:
            raise ValueError(f"bearings has shape {self.bearings.shape}, expected (n_rays,)")
        steps = np.diff(self.bearings)
        in_order = steps >= 0 if self.is_composite else steps > 0
        if not in_order.all():
            first = int(np.flatnonzero(~in_order)[0])
            raise ValueError(
                f"bearings go from {self.bearings[first]:g} to {self.bearings[first + 1]:g} rad at ray {first}, expected "
                "increasing ones: reverse bearings and ranges of a clockwise laser"
            )
        n = self.n_rays
        if self.origins.shape not in ((0, 2), (n, 2)) or {self.cones.shape, self.delays.shape} - {(0,), (n,)}:
            raise ValueError(
                f"origins has shape {self.origins.shape}, cones {self.cones.shape} and delays {self.delays.shape}, "
                f"expected ({n}, 2), ({n},) and ({n},)"
            )
        if self.mount.shape != (3,):
            raise ValueError(f"mount has shape {self.mount.shape}, expected (3,): x, y, yaw")
        if not 0 <= self.range_min < self.range_max:
            raise ValueError(
                f"range limits are {self.range_min} to {self.range_max}, expected 0 <= min < max"
            )
        if not 0 < self.rate < np.inf:
            raise ValueError(f"the rate is {self.rate} Hz, expected a number above 0")
        others = {
            name: getattr(self, name)
            for name in ("sigma", "resolution", "sweep_time", "sweep_period", "first_ray_delay", "height")
        }
        if not np.isfinite(list(others.values())).all():
            raise ValueError(f"the sensor has {others}, expected finite numbers")
        k, period = self.interlaced_sweeps, self.sweep_period
        if k < 1 or (k == 1) != (period == 0) or (k > 1 and abs(period) < abs(self.sweep_time)):
            raise ValueError(
                f"interlaced_sweeps is {k} and sweep_period {period:g} s, with a sweep_time of {self.sweep_time:g} s; "
                "expected 1 and 0 s, or at least 2 and a sweep_period of at least sweep_time"
            )

    def __repr__(self) -> str:
        """Summarise rays, limits and mount in one line."""
        first, last = np.degrees(self.bearings[[0, -1]])
        x, y, yaw = self.mount
        return (
            f"RangeSensor: {self.n_rays} rays from {first:.1f} to {last:.1f} deg, {self.range_min:g} to "
            f"{self.range_max:g} m, mount ({x:g}, {y:g}) m, {np.degrees(yaw):g} deg"
        )

    @property
    def n_rays(self) -> int:
        """Number of rays in a scan."""
        return len(self.bearings)

    def take(self, rays: NDArray[np.integer] | slice) -> RangeSensor:
        """Return the sensor with a subset of its rays, in increasing order.

        If the subset no longer alternates between interlaced sweeps, it counts as one sweep.
        """
        turns = np.arange(self.n_rays)[rays] % self.interlaced_sweeps
        is_in_turns = np.array_equal(turns, np.arange(len(turns)) % self.interlaced_sweeps)
        return replace(
            self,
            interlaced_sweeps=self.interlaced_sweeps if is_in_turns else 1,
            sweep_period=self.sweep_period if is_in_turns else 0.0,
            bearings=self.bearings[rays],
            origins=self.origins[rays] if len(self.origins) else self.origins,
            cones=self.cones[rays] if len(self.cones) else self.cones,
            delays=self.delays[rays] if len(self.delays) else self.delays,
        )

    @property
    def is_composite(self) -> bool:
        """Return whether rays have different origins, as several sensors read as one have."""
        return bool(self.origins.any())

    @property
    def ray_delays(self) -> Floats:
        """(n_rays,) [s] time of each ray after the stamp of the scan; all 0 without a sweep."""
        if len(self.delays):
            return self.first_ray_delay + self.delays
        ray = np.arange(self.n_rays)
        along = self.sweep_time * ray / self.n_rays
        return self.first_ray_delay + along + self.sweep_period * (ray % self.interlaced_sweeps)

    @property
    def is_clockwise(self) -> bool:
        """Return whether the laser measures its last ray first."""
        return math.copysign(1.0, self.sweep_time) < 0

    @property
    def sweep_share(self) -> Floats:
        """(n_rays,) elapsed share of a sweep at the time of each ray."""
        if self.delays.any():
            return np.asarray((self.delays - self.delays.min()) / self.scan_duration)
        ray = np.arange(self.n_rays)
        return (ray[::-1] if self.is_clockwise else ray) / self.n_rays

    @property
    def ray_0_after_first(self) -> float:
        """[s] from the ray that is measured first to ray 0, which a clockwise laser measures last."""
        return -self.sweep_time * (self.n_rays - 1) / self.n_rays if self.is_clockwise else 0.0

    @property
    def has_ray_delays(self) -> bool:
        """Return whether the rays of a scan have times that differ from its stamp."""
        return bool(self.sweep_time or self.sweep_period or self.first_ray_delay or self.delays.any())

    @property
    def scan_duration(self) -> float:
        """[s] duration of a scan, from the first measured ray to one ray after the last."""
        if len(self.delays):
            return float(np.ptp(self.delays))
        return abs(self.sweep_time) + (self.interlaced_sweeps - 1) * abs(self.sweep_period)

    @property
    def has_ray_poses(self) -> bool:
        """Return whether the rays of a scan start at different points when the robot moves."""
        return self.has_ray_delays or self.is_composite

    @property
    def is_evenly_spaced(self) -> bool:
        """Return whether the bearings are equally spaced, to within 1e-6 rad."""
        steps = np.diff(self.bearings)
        return len(steps) == 0 or bool(np.ptp(steps) < 1e-6)


def rare_times(sensor: RangeSensor) -> dict[str, int | float]:
    """Return the fields of `RARE_TIMES` that differ from their defaults."""
    return {
        name: getattr(sensor, name) for name, usual in RARE_TIMES.items() if getattr(sensor, name) != usual
    }


def with_rare_times(sensor: RangeSensor, stated: Mapping[str, str | int | float]) -> RangeSensor:
    """Return the sensor with the fields of `RARE_TIMES` that a file contains."""
    values = {**RARE_TIMES, **{name: stated[name] for name in RARE_TIMES if name in stated}}
    return replace(
        sensor,
        interlaced_sweeps=int(values["interlaced_sweeps"]),
        sweep_period=float(values["sweep_period"]),
        first_ray_delay=float(values["first_ray_delay"]),
    )
