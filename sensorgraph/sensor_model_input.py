"""Check the arguments of a sensor model: readings, poses and rays; messages name the unit that was probably meant."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from logs import arguments
from logs.run import RangeSensor
from planners.types import MAX_COORDINATE
from sensorgraph.errors import SensorgraphError
from sensorgraph.robust import MAJORITY
from sensorgraph.types import Floats, Ints

MAX_HEADING = 100.0
"""[rad] Largest accepted heading: unwrapped ones grow by full turns, and larger ones are probably degrees."""


def numbers_of(values: ArrayLike, what: str) -> Floats:
    """Return values as numbers; masked ones are nan.

    Raises
    ------
    SensorgraphError : A value is not a real number.
    """
    try:
        return arguments.numbers_of(values, what)
    except ValueError as exc:
        raise SensorgraphError(str(exc)) from exc


def spread_over(values: ArrayLike, what: str, shape: tuple[int, int]) -> Floats:
    """Return values (n_poses, n_rays) as numbers, broadcast to that shape.

    Raises
    ------
    SensorgraphError : A value is not a real number, or their shape does not fit.
    """
    given = numbers_of(values, what)
    try:
        return np.broadcast_to(given, shape)
    except ValueError:
        raise SensorgraphError(
            f"{what} has shape {given.shape}, expected one number, ({shape[1]},) for one of each ray, ({shape[0]}, 1) for "
            f"one of each pose, or {shape}; for several numbers call it once for each"
        ) from None


def rays_of(rays: ArrayLike | None, n_rays: int) -> Ints:
    """Return the indices of rays: all for None; a mask (n_rays,) of bool chooses rays.

    Raises
    ------
    SensorgraphError : There is no ray, an index is no whole number, or a ray does not exist.
    """
    if rays is None:
        return np.arange(n_rays)
    given = np.asarray(rays)
    if given.ndim != 1 or given.dtype.kind not in "iub" or len(given) == 0:
        raise SensorgraphError(
            f"rays has shape {given.shape} and type {given.dtype}; expected a list of whole numbers from 0 to {n_rays - 1}"
        )
    if given.dtype.kind == "b":
        if len(given) != n_rays or not given.any():
            raise SensorgraphError(
                f"rays chooses {given.sum()} of {len(given)} rays; expected some of the {n_rays} of the graph's sensor"
            )
        return np.flatnonzero(given)
    wrong = given[(given < 0) | (given >= n_rays)]
    if len(wrong):
        raise SensorgraphError(
            f"ray {', '.join(map(str, wrong[:8].tolist()))} does not exist; this sensor has rays 0 to {n_rays - 1}"
        )
    return given.astype(np.intp)


def check_readings(ranges: ArrayLike, n_poses: int, rays: Ints, sensor: RangeSensor) -> Floats:
    """Return readings (n_poses or 1, n_rays) [m]; those beyond range_max are no return, those below range_min too close.

    Raises
    ------
    SensorgraphError : The readings are of other rays or poses, or in another unit.
    """
    given = numbers_of(ranges, "ranges")
    known = np.atleast_2d(given)
    if known.ndim != 2 or len(known) not in (1, n_poses):
        raise SensorgraphError(
            f"ranges has shape {given.shape}, expected (n_rays,) for one scan or ({n_poses}, n_rays): one scan for each pose"
        )
    if known.shape[1] == sensor.n_rays:
        known = known[:, rays]
    elif known.shape[1] != len(rays):
        raise SensorgraphError(
            f"a scan has {known.shape[1]} ranges, expected the {sensor.n_rays} rays of the graph's sensor; "
            "name those that you have with rays="
        )
    finite = known[np.isfinite(known)]
    if len(finite) and (finite > sensor.range_max).mean() > MAJORITY:
        median = float(np.median(finite))
        raise SensorgraphError(
            f"most ranges exceed range_max {sensor.range_max:g} m (median {median:g}); expected metres"
            + (": divide millimetres by 1000" if 1e-3 * median < sensor.range_max else "")
        )
    known = np.where(known > sensor.range_max, np.inf, known)
    return np.where(known < sensor.range_min, -np.inf, known)


def check_poses(poses: Floats, n_rays: int) -> None:
    """Check the shape, the numbers and the unit of poses.

    Raises
    ------
    SensorgraphError : The poses have another shape, one is not finite or too far away, or headings are in degrees.
    """
    if poses.shape[-1:] != (3,) or poses.shape[1:-1] not in ((), (1,), (n_rays,)):
        raise SensorgraphError(
            f"poses has shape {poses.shape}, expected (n_poses, 3) for x, y, phi or (n_poses, {n_rays}, 3)"
        )
    flat = poses.reshape(len(poses), 1 if poses.ndim == 2 else poses.shape[1], 3)
    if not np.isfinite(poses).all():
        row = int(np.flatnonzero(~np.isfinite(flat).all(axis=(1, 2)))[0])
        raise SensorgraphError(f"pose {row} is not finite; remove such poses")
    phi = poses[..., 2]
    if (most := np.abs(phi).max(initial=0.0)) > 2 * math.pi and (
        most > MAX_HEADING or (phi == phi.round()).all()
    ):
        raise SensorgraphError(f"a pose has the heading {most:g}; radians expected: use np.radians(degrees)")
    if np.abs(poses[..., :2]).max(initial=0.0) > MAX_COORDINATE:
        row, ray = divmod(int(np.abs(flat[..., :2]).max(axis=2).argmax()), flat.shape[1])
        raise SensorgraphError(
            f"pose {row} is at {flat[row, ray, :2].tolist()} m; expected at most {MAX_COORDINATE:g} m from the origin"
        )
