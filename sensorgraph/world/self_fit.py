"""Find what makes the scans of a run contradict each other: the clock of the poses, the yaw of the laser, the step of its
bearings, or a scale.

The end points of all scans fill the fewest cells if poses, bearings and ranges are right, as in `orientation`. Each is
changed alone; the change that leaves the fewest cells is reported.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from logs.run import Run, pair
from logs.transforms import interpolate
from sensorgraph.types import Floats
from sensorgraph.world.orientation import MAX_ERROR_RATIO, cells_filled
from sensorgraph.world.raycast import laser_poses


class Search(NamedTuple):
    """A change that is searched for on a grid around 0, which is refined around its best point."""

    most: float
    coarse: float
    fine: float


SEARCHES = {
    "lag": Search(most=1.0, coarse=0.1, fine=0.02),
    "turn": Search(most=0.2, coarse=0.02, fine=0.004),
    "step": Search(most=0.1, coarse=0.01, fine=0.002),
    "scale": Search(most=0.1, coarse=0.01, fine=0.002),
}
"""Change -> how it is searched for: [s] time of the poses, [rad] turn of the laser, and shares of the bearings' step and of
the ranges. Larger differences of clocks are found by the log times (`logs.clocks`), larger turns by `orientation`."""

MIN_SCANS, MAX_SCANS, MAX_RAYS = 50, 150, 90
"""Fewer scans do not see the same walls often enough; more scans and rays take longer and show no more."""


@dataclass(frozen=True, kw_only=True)
class SelfFit:
    """A change with which the scans fit each other better."""

    name: str
    """One of `SEARCHES`."""
    value: float
    """[s] by which the stamps of the fitting poses are later than those of the scans, [rad], or the share that is added."""
    fit: float
    """Number of cells that the scans fill with the change, relative to those without it."""

    def line(self) -> str:
        """Return a warning."""
        more, size = self.value > 0, abs(self.value)
        how, why = {
            "lag": (
                f"with the poses that are stamped {1e3 * size:.0f} ms {'later' if more else 'earlier'}",
                "poses and scans have different clocks or latencies; correct the stamps where they are logged, or estimate "
                "the poses with `sensorgraph locate`",
            ),
            "turn": (
                f"with the laser turned by {np.degrees(self.value):+.1f}°",
                "check the yaw of its mount, and the heading of the poses",
            ),
            "step": (
                f"with bearings {100 * size:.1f} % {'further apart' if more else 'closer together'}",
                "check angle_min, angle_max and angle_increment of the driver",
            ),
            "scale": (
                f"with ranges {100 * size:.1f} % {'longer' if more else 'shorter'}",
                "the scales of ranges and poses differ",
            ),
        }[self.name]
        return f"the scans fit each other better {how} (they fill {100 * self.fit:.0f} % of the cells): {why}"


def self_fit(run: Run) -> SelfFit | None:
    """Return the change with which the scans of a run fit each other best; None if none is needed, or nothing shows it.

    It takes turns, and views of the same walls. Sensors with several origins and wide cones are not tested.
    """
    sensor = run.sensor
    if sensor.is_composite or sensor.cones.any():
        return None
    times = run.stamps + float(np.mean(sensor.ray_delays))
    most = SEARCHES["lag"].most
    inside = (times - most > run.pose_stamps.min(initial=np.inf)) & (
        times + most < run.pose_stamps.max(initial=-np.inf)
    )
    use = np.flatnonzero(pair(run).paired & inside & np.isfinite(run.ranges).any(axis=1))
    known = np.isfinite(run.poses).all(axis=1)
    if len(use) < MIN_SCANS:
        return None
    some = use[np.linspace(0, len(use) - 1, min(MAX_SCANS, len(use))).astype(np.intp)]
    rays = np.linspace(0, sensor.n_rays - 1, min(MAX_RAYS, sensor.n_rays)).astype(np.intp)
    ranges, bearings = run.ranges[some][:, rays], sensor.bearings[rays]
    mount = np.zeros(3) if run.pose_frame == "laser" else sensor.mount

    def lasers_at(lag: float) -> Floats:
        poses = interpolate(times[some] + lag, run.pose_stamps[known], run.poses[known])
        return laser_poses(poses, mount)[:, None]

    as_stamped = lasers_at(0.0)

    def cells(lag: float = 0.0, turn: float = 0.0, step: float = 0.0, scale: float = 0.0) -> float:
        lasers = lasers_at(lag) if lag else as_stamped
        angles = bearings + turn + step * (bearings - sensor.bearings[0])
        return cells_filled((1 + scale) * ranges, lasers, angles)

    now = cells()
    if now == 0.0:
        return None
    found = []
    for name, search in SEARCHES.items():
        value, left = _least(lambda value, name=name: cells(**{name: value}), search)  # type: ignore[misc]
        found.append(SelfFit(name=name, value=value, fit=left / now))
    best = min(found, key=lambda one: one.fit)
    return best if best.fit < MAX_ERROR_RATIO else None


def _least(cells: Callable[[float], float], search: Search) -> tuple[float, float]:
    """Return the change with the fewest cells, and their number."""
    first = np.arange(-search.most, search.most + search.coarse / 2, search.coarse)
    middle = float(first[int(np.argmin([cells(value) for value in first]))])
    second = np.arange(middle - search.coarse, middle + search.coarse + search.fine / 2, search.fine)
    left = [cells(value) for value in second]
    return float(second[int(np.argmin(left))]), min(left)
