"""Derivatives of the readings of a cast by poses, nuisances and corners of the map.

A surface, an edge or a tilt bends a ray. The derivatives of such rays by the pose come from additional casts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sensorgraph.diagnosis.scan.depth_edges import MIN_SHORT_RANGE
from sensorgraph.diagnosis.scan.intake import wobble_of_readings
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.beams import Beams

SETTINGS = SCAN.nuisance


@dataclass(frozen=True, kw_only=True, eq=False)
class Jacobian:
    """First-order derivatives of the readings of one cast by poses, nuisances and wall ends."""

    pose: Floats
    """(n_scans, 3, n_rays) derivatives by x, y, phi of the scan's pose."""
    nuisances: Floats
    """(n_scans, 8, n_rays) derivatives by each Nuisance."""
    ends: Floats
    """(2, n_scans, n_rays) derivatives by a shift of the first and second end of the wall along the ray's normal."""
    wall: Ints
    """(n_scans, n_rays) wall index; 0 without a wall (then `ends` is 0)."""
    nx: Floats
    """(n_scans, n_rays) normal of the wall."""
    ny: Floats
    valid: Bools
    """(n_scans, n_rays) whether the derivatives are valid; elsewhere they are 0."""
    steep: Floats
    """(n_scans, n_rays) [m] additional standard deviation of rays at grazing incidence or on walls with fixed corners."""


def linearise(
    data: ScanData,
    beams: Beams,
    walls: Floats,
    mount: Floats,
    bent: tuple[Bools, Floats, Floats] | None = None,
) -> Jacobian:
    """Differentiate the readings of one cast.

    A straight ray has the length r and the direction u. It meets a wall with the normal n at the incidence a. The lever arm l leads
    from base_link to the laser.

        dr/dx = n_x / cos a,    dr/dy = n_y / cos a,
        dr/dphi = r (n_y u_x - n_x u_y) / cos a + l_x dr/dy - l_y dr/dx.

    Parameters
    ----------
    bent : Which rays (n_scans, n_rays) are bent, their columns by the pose (n_scans, 3, n_rays) from difference
        quotients, and the slope (n_scans, n_rays) [m/rad] by phi.
    """
    cosine, nx, ny = _facing(beams)
    hit = np.isfinite(beams.ranges) & np.isfinite(beams.reading)
    straight = hit if beams.straight is None else hit & beams.straight
    valid = straight & (cosine > SETTINGS.min_cosine)
    slope = np.where(valid, beams.slope, 0.0)
    r = np.where(valid, beams.ranges, 0.0)
    inverse = slope / np.where(valid, cosine, 1.0)
    dx, dy = nx * inverse, ny * inverse
    turn = r * (ny * beams.ux - nx * beams.uy) * inverse
    lx, ly = _lever(data, mount)
    if data.sensor.is_composite:  # each ray turns about the mount, which turns about base_link
        ox, oy = beams.ox - data.poses[:, :1] - lx, beams.oy - data.poses[:, 1:2] - ly
        turn = turn + ox * dy - oy * dx
    pose = np.stack([dx, dy, turn + lx * dy - ly * dx], axis=1)
    on = valid & (beams.wall >= 0)
    slack = np.zeros(cosine.shape)
    if bent is not None:
        which, quotients, steepness = bent
        pose = np.where(which[:, None, :], quotients, pose)
        dx, dy = pose[:, 0], pose[:, 1]
        turn = np.where(which, pose[:, 2] - lx * dy + ly * dx, turn)
        r = np.where(which, beams.reading, r)
        slope = np.where(which, np.where(np.abs(dx) + np.abs(dy) > 0, 1.0, 0.0), slope)
        slack = steepness * _turn_of_surfaces(data, beams, which)
        valid = valid | which
    wall = np.where(on, beams.wall, 0)
    share = _share(beams, walls, wall)
    ends = np.stack([-(1 - share) * inverse * on, -share * inverse * on])
    steep = np.where(straight & ~valid, _grazing_sigma(beams, cosine), slack)  # straight rays have no slack
    beside = wobble_of_readings(data.wobble, pose), _by_corners_that_stay(data, wall, ends)
    return Jacobian(
        pose=pose,
        nuisances=_nuisance_columns(data, pose, turn, r * slope, valid),
        ends=ends,
        wall=wall,
        nx=nx,
        ny=ny,
        valid=valid,
        steep=np.hypot.reduce([np.minimum(steep, data.max_scatter), *beside]),
    )


def _lever(data: ScanData, mount: Floats) -> tuple[Floats, Floats]:
    """Return the lever arm (n_scans, 1), (n_scans, 1) [m] from base_link to the laser, in the axes of the map."""
    c, s = np.cos(data.poses[:, 2:]), np.sin(data.poses[:, 2:])
    return c * mount[0] - s * mount[1], s * mount[0] + c * mount[1]


def _turn_of_surfaces(data: ScanData, beams: Beams, has_columns: Bools) -> Floats:
    """Return the standard deviation (n_scans, n_rays) [rad] of the direction in which a bent ray meets its surface.

    The pose error is a part of it unless the ray has columns by the pose.
    """
    t = data.tolerances
    near = np.maximum(np.where(np.isfinite(beams.ranges), beams.ranges, 1.0), MIN_SHORT_RANGE)
    off = t.map / near + 0.5 * t.mount_yaw
    return np.where(has_columns, off, np.hypot(off, t.pose_yaw + t.pose_xy / near))


def _grazing_sigma(beams: Beams, cosine: Floats) -> Floats:
    """Return the additional standard deviation (n_scans, n_rays) [m] of rays at grazing incidence."""
    constant, share_of_range = SETTINGS.grazing_sigma
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray((constant + share_of_range * beams.ranges) / np.abs(cosine))


def _nuisance_columns(data: ScanData, pose: Floats, turn: Floats, lengths: Floats, valid: Bools) -> Floats:
    """Return the derivatives by each Nuisance (n_scans, 8, n_rays).

    Parameters
    ----------
    pose, turn : Derivatives by the pose (n_scans, 3, n_rays), and by a turn of the laser about itself (n_scans, n_rays).
    lengths : (n_scans, n_rays) [m] Derivative by the scale of the ranges.
    """
    c, s = np.cos(data.poses[:, 2:]), np.sin(data.poses[:, 2:])
    dx, dy = pose[:, 0], pose[:, 1]
    carried = np.einsum("nkm,nk->nm", pose, data.twists)
    out = np.empty((data.n_scans, len(Nuisance), data.n_rays))
    out[:, Nuisance.MOUNT_X] = c * dx + s * dy
    out[:, Nuisance.MOUNT_Y] = c * dy - s * dx
    out[:, Nuisance.MOUNT_YAW] = turn
    out[:, Nuisance.BIAS] = valid
    out[:, Nuisance.SCALE] = lengths
    out[:, Nuisance.DRIFT] = valid * ((data.stamps - data.begin) / data.span)[:, None]
    out[:, Nuisance.DELAY] = -carried
    out[:, Nuisance.SKEW] = carried * data.sensor.sweep_share
    return out


def _by_corners_that_stay(data: ScanData, wall: Ints, ends: Floats) -> Floats:
    """Return the additional standard deviation [m] of readings on walls with fixed corners.

    Their map errors are not among the unknowns.

    Parameters
    ----------
    ends : (2, n_scans, n_rays) Derivatives of the readings by shifts of the ends of their walls, along the normal.
    """
    if data.corners is None or data.corners.rest < 0:
        return np.zeros(wall.shape)
    stays = data.corners.ends == data.corners.rest
    off = np.hypot(*(ends[k] * stays[:, k][wall] for k in (0, 1)))
    return np.asarray(data.tolerances.map * off)


def _facing(beams: Beams) -> tuple[Floats, Floats, Floats]:
    """Return the cosine of the incidence and the normal (n_scans, n_rays) for the derivatives by the pose.

    A cone reads the nearest surface within it. Its reading changes only along the ray, as at a wall that faces the sensor.
    """
    if beams.within is None:
        return beams.cosine, beams.nx, beams.ny
    nx, ny = np.where(beams.within, -beams.ux, beams.nx), np.where(beams.within, -beams.uy, beams.ny)
    return np.where(beams.within, 1.0, beams.cosine), nx, ny


def _share(beams: Beams, walls: Floats, wall: Ints) -> Floats:
    """Return the position along its wall at which each ray hits: 0 at the first end, 1 at the second."""
    if len(walls) == 0:
        return np.zeros(wall.shape)
    a, d = walls[:, 0], walls[:, 1] - walls[:, 0]
    size = np.maximum((d**2).sum(axis=1), 1e-12)
    ax, ay, fx, fy = a[:, 0][wall], a[:, 1][wall], (d[:, 0] / size)[wall], (d[:, 1] / size)[wall]
    r = np.where(np.isfinite(beams.ranges), beams.ranges, 0.0)
    share = (beams.ox + r * beams.ux - ax) * fx + (beams.oy + r * beams.uy - ay) * fy
    return np.asarray(np.clip(share, 0.0, 1.0))


def bent_columns(
    data: ScanData, model: Sequence[Amendment], beams: Beams
) -> tuple[Bools, Floats, Floats] | None:
    """Differentiate bent rays by the pose, with difference quotients of additional casts.

    Returns
    -------
    Which rays have columns (n_scans, n_rays), and the columns (n_scans, 3, n_rays). Then |d reading / d phi|
    (n_scans, n_rays) [m/rad] of all bent rays, including those where it is a jump. None without bent rays.
    """
    if beams.straight is None:
        return None
    which = ~beams.straight & np.isfinite(beams.reading)
    rows = np.flatnonzero(which.any(axis=1))
    if len(rows) == 0:
        return None
    few = data.subset(rows)
    quotients = np.zeros((data.n_scans, 3, data.n_rays))
    smooth = which.copy()
    steepness = np.zeros(which.shape)
    steepest = (
        np.array([1.0, 1.0, data.sensor.range_max]) / SETTINGS.min_cosine
    )  # of a ray that is no grazing one
    for axis, step in enumerate(SCAN.fit.pose_steps):
        scene = few.scene()
        scene.casts, scene.wanted = None, which[rows]
        scene.motion = _nudged(few, axis, step)
        moved = scene.run((*data.known, *model)).reading
        with np.errstate(invalid="ignore"):
            q = (moved - beams.reading[rows]) / step
        ok = np.isfinite(q) & (np.abs(q) < steepest[axis])
        if axis == 2:
            steepness[rows] = np.where(np.isfinite(q), np.abs(q), steepest[axis])
        smooth[rows] &= ok
        quotients[rows, axis] = np.where(ok, q, 0.0)
    return smooth, np.where(smooth[:, None, :], quotients, 0.0), np.where(which, steepness, 0.0)


def _nudged(data: ScanData, axis: int, step: float) -> Callable[[Floats], Floats]:
    offset = np.zeros(3)
    offset[axis] = step
    return lambda times: data.motion(times) + offset
