"""Detect a mirrored scan or a laser mounted backwards, by comparison with the map or with the scans themselves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from logs.motion import ray_poses
from logs.run import RangeSensor, Run, pair
from logs.usability import MIN_SCANS
from planners.arena import Arena
from sensorgraph.types import Floats
from sensorgraph.world.raycast import cast, cast_rays, laser_poses, ray_starts

MAX_SCANS = 300  # that are compared
CAUSES = {
    "as logged": (1, 0.0),
    "mirrored": (-1, 0.0),
    "turned 180°": (1, np.pi),
    "mirrored and turned 180°": (-1, np.pi),
}
TURNS = (*range(30, 166, 15), *range(195, 331, 15))
"""[°] Other turns of a laser, or of the frame of its poses, that are tried, then refined in steps of `FINE_TURN`."""
FINE_TURN = 2
MAX_RAYS = 180
"""Number of rays of each scan that are compared in this search."""
MAX_MEDIAN_ERROR = 0.1  # [m] median error above which map, poses and scans do not belong together
MAX_ERROR_RATIO = 0.8  # another orientation must be better by this factor to be reported
END_POINT_CELL = 0.1  # [m] cell of the grid of end points
CELL_HEADING = 0.5  # [rad] of this grid, so that walls along x or y do not lie on the borders of its cells


@dataclass(frozen=True, kw_only=True)
class Orientation:
    """Misfit of the scan under each orientation; smaller is better."""

    fits: dict[str, float]
    """Orientation -> median |measured - cast| [m] against a map, otherwise the number of cells filled by end
    points."""
    against: str
    """`the arena` or `itself`."""
    n_scans: int
    is_odometry: bool = False
    """Whether the poses are odometry, whose frame is seldom that of a map."""

    @property
    def best(self) -> str:
        """Return the orientation with the best fit, unless the logged one is nearly as good."""
        name = min(self.fits, key=lambda key: self.fits[key])
        return name if self.fits[name] < MAX_ERROR_RATIO * self.fits["as logged"] else "as logged"

    def lines(self) -> list[str]:
        """Return the fit of each orientation, and advice if another one fits better."""
        unit, scale = (
            ("median error in cm", 100.0)
            if self.against == "the arena"
            else ("cells filled, fewer is better", 1.0)
        )
        fits = ", ".join(f"{name} {scale * value:,.0f}" for name, value in self.fits.items())
        out = [f"scan against {self.against} ({self.n_scans} scans, {unit}): {fits}"]
        if self.best != "as logged":
            out.append(
                f"WARNING: the scan fits better {self.best}: check the sign of angle_increment, the mount's yaw, the frame of "
                "the poses and the driver's `inverted` setting"
            )
        elif self.against == "the arena" and self.fits[self.best] > MAX_MEDIAN_ERROR:
            out.append(
                "the poses are odometry, whose frame is not that of the arena: `sensorgraph locate --arena` finds them in it"
                if self.is_odometry
                else f"WARNING: the scan fits the arena badly ({100 * self.fits[self.best]:.0f} cm): check that it is the arena "
                "of this run, that poses and scans share a clock, and the mount"
            )
        return out


def orientation(run: Run, arena: Arena | None) -> Orientation | None:
    """Compare the scans of a run with an arena, or with each other, under several orientations of the sensor.

    Without an arena, the end points coincide best under the right orientation and fill the fewest cells. This
    requires views of the same walls under several headings. Composite sensors are mirrored and turned
    together, including their mounts.

    Returns
    -------
    None for fewer than 10 scans with poses, and for cones, whose end points are unknown.
    """
    if run.sensor.cones.any():
        return None
    pairing = pair(run)
    index = np.flatnonzero(pairing.paired & np.isfinite(run.ranges).any(axis=1))
    if len(index) < MIN_SCANS:
        return None
    some = index[np.linspace(0, len(index) - 1, min(MAX_SCANS, len(index))).astype(np.intp)]
    ranges = run.ranges[some]
    several = run.sensor.is_composite
    poses = pairing.poses[some][:, None] if several else ray_poses(run, pairing, some)  # (n, n_rays or 1, 3)
    mounted = poses if run.pose_frame == "laser" else laser_poses(poses, run.sensor.mount)

    def lasers(sign: int, turn: float) -> Floats:
        return ray_starts(mounted, _turned(run.sensor, sign, turn)) if several else mounted

    rays = np.linspace(0, run.sensor.n_rays - 1, min(run.sensor.n_rays, MAX_RAYS)).astype(np.intp)

    def cells(sign: int, turn: float) -> float:
        starts = lasers(sign, turn)
        some_starts = starts if starts.shape[1] == 1 else starts[:, rays]
        return cells_filled(ranges[:, rays], some_starts, run.sensor.bearings[rays], sign, turn)

    fits = {}
    for name, (sign, turn) in {**CAUSES, **_other_turn(cells)}.items():
        if arena is not None:
            fits[name] = _against_map(ranges, lasers(sign, turn), run.sensor, arena, sign, turn)
        else:
            fits[name] = cells_filled(ranges, lasers(sign, turn), run.sensor.bearings, sign, turn)
    return Orientation(
        fits=fits, against="itself" if arena is None else "the arena", n_scans=len(some),
        is_odometry=run.meta.get("pose_source", "").startswith("odometry"),
    )  # fmt: skip


def _other_turn(cells: Callable[[int, float], float]) -> dict[str, tuple[int, float]]:
    """Return the turn by which the scans fill fewer cells than under each of `CAUSES`, with its name; empty if none.

    If one of `CAUSES` is better than the others, no turn is searched for. Small turns are left to the calibration of the mount.
    """
    known, second = sorted(cells(sign, turn) for sign, turn in CAUSES.values())[:2]
    if known < MAX_ERROR_RATIO * second:
        return {}
    for sign, prefix in ((1, ""), (-1, "mirrored and ")):
        least = min(TURNS, key=lambda degrees: cells(sign, np.radians(degrees)))
        near = range(least - FINE_TURN * 4, least + FINE_TURN * 4 + 1, FINE_TURN)
        best = min(near, key=lambda degrees: cells(sign, np.radians(degrees)))
        if cells(sign, np.radians(best)) < MAX_ERROR_RATIO * known:
            return {f"{prefix}turned {(best + 180) % 360 - 180}°": (sign, float(np.radians(best)))}
    return {}


def _turned(sensor: RangeSensor, sign: int, turn: float) -> RangeSensor:
    """Return a composite sensor mirrored, then turned about the origin of its frame; bearings are unchanged."""
    x, y = sensor.origins[:, 0], sign * sensor.origins[:, 1]
    c, s = np.cos(turn), np.sin(turn)
    return replace(sensor, origins=np.stack([c * x - s * y, s * x + c * y], axis=1))


def _against_map(
    ranges: Floats, lasers: Floats, sensor: RangeSensor, arena: Arena, sign: int, turn: float
) -> float:
    if lasers.shape[1] > 1:  # each ray from its own pose
        origins = np.broadcast_to(lasers[..., :2], (*ranges.shape, 2))
        ideal = cast_rays(arena, origins, lasers[..., 2] + sign * sensor.bearings + turn, sensor).ranges
    else:
        bearings = sensor.bearings if sign > 0 else -sensor.bearings[::-1]
        turned = lasers[:, 0] + np.array([0.0, 0.0, turn])
        ideal = cast(arena, turned, replace(sensor, bearings=bearings, mount=np.zeros(3))).ranges[:, ::sign]
    seen = np.isfinite(ranges) & (ranges > 0.1)
    return float(np.median(np.abs(ranges[seen] - np.minimum(ideal[seen], sensor.range_max))))


def cells_filled(ranges: Floats, lasers: Floats, bearings: Floats, sign: int = 1, turn: float = 0.0) -> float:
    """Return the number of cells that the end points of scans fill; right poses fill the fewest.

    Parameters
    ----------
    ranges : (n, n_rays) [m]
    lasers : (n, 1, 3) or (n, n_rays, 3) [m, m, rad] poses of the laser in map.
    bearings : (n_rays,) [rad]
    sign, turn : -1 for a mirrored laser, and [rad] by which it is turned.
    """
    near = (ranges > 0.1) & (ranges < 10.0)
    r, phi = ranges[near], (lasers[..., 2] + (sign * bearings + turn - CELL_HEADING))[near]
    cos, sin = np.cos(CELL_HEADING), np.sin(CELL_HEADING)
    x, y = (np.broadcast_to(lasers[..., i], ranges.shape)[near] for i in range(2))
    column = np.floor((cos * x + sin * y + r * np.cos(phi)) / END_POINT_CELL)
    row = np.floor((cos * y - sin * x + r * np.sin(phi)) / END_POINT_CELL)
    cells = np.sort(1_000_003.0 * column + row)  # exact: whole numbers below 2**53
    return float(np.count_nonzero(np.diff(cells)) + 1) if len(cells) else 0.0
