"""Log-likelihood of one scan at many poses near each other, as the particles of a filter, from one table for each ray.

The laser of the particles is near c = (x_c, y_c), at a heading near phi_c. A return z ends at e. Seen from c, the point e
has the bearing b + turn and the range rho. To first order, the likelihood of z at the particle is that of the reading rho
of a ray with this bearing at c: both measure how far e is from the same surface. So a ray is cast at c for a few turns,
and each cast is evaluated at a few ranges. A particle then looks up its turn and range, with bilinear interpolation. A ray
without a return has the turn of the heading alone.

The error is the parallax: of the angle of incidence, and of edges that hide a surface from c and not from the particle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from logs.transforms import compose, invert
from planners.kernel import inner_kernel, outer_kernel
from sensorgraph.errors import SensorgraphError
from sensorgraph.models.base import Model
from sensorgraph.models.cells.model import CellModel
from sensorgraph.models.faces.model import Faces
from sensorgraph.sensor_model_input import check_poses, numbers_of, rays_of
from sensorgraph.types import Bools, Floats, Ints

TURN_STEP, RANGE_STEP = math.radians(0.25), 0.01
"""[rad], [m] Wanted distances between the entries of a table."""
MAX_TURNS, MAX_RANGES = 48, 64
"""Largest numbers of entries; tables of wide clouds of particles are coarser."""


@dataclass(frozen=True, kw_only=True, eq=False)
class NearbyLikelihood:
    """Log-likelihood of one scan, tabulated around one place; `Sensorgraph.near` makes it."""

    ranges: Floats
    """(n_rays,) [m]"""
    bearings: Floats
    """(n_rays,) [rad]"""
    mount: Floats
    """(3,) Pose of the laser in the frame of the poses."""
    centre: Floats
    """(3,) Pose of the laser from which the rays are cast."""
    grids: Floats
    """(n_rays, 4) First turn [rad] and range [m], and their steps."""
    shapes: Ints
    """(n_rays, 3) Index of the ray's first entry, number of turns and of ranges."""
    table: Floats
    """(n_entries,) Log-likelihoods, tempered if the readings are correlated."""

    def __repr__(self) -> str:
        """Summarise the tables in one line."""
        x, y, phi = self.centre
        return f"NearbyLikelihood: {len(self.ranges)} rays, seen from ({x:.2f}, {y:.2f}) m, {phi:.2f} rad"

    @property
    def is_coarse(self) -> bool:
        """Whether entries are further apart than wanted, since the poses were too far from each other."""
        return bool((self.grids[:, 2:] > [1.01 * TURN_STEP, 1.01 * RANGE_STEP]).any())

    def log_likelihood(self, poses: ArrayLike, rays: ArrayLike | None = None) -> Floats:
        """Return the sum over rays (n_poses,) at poses (n_poses, 3), which should lie among those of the tables.

        `rays` are positions among the rays of the tables; None: all.

        Raises
        ------
        SensorgraphError : The poses have another shape or are not finite, or a ray does not exist.
        """
        index = rays_of(rays, len(self.ranges))
        where = np.atleast_2d(numbers_of(poses, "poses"))
        if where.ndim != 2:
            raise SensorgraphError(f"poses has shape {where.shape}, expected (n_poses, 3) for x, y, phi")
        check_poses(where, len(index))
        out = np.zeros(len(where))
        lasers = np.ascontiguousarray(compose(where, self.mount))
        _add_up(
            lasers, self.ranges, self.bearings, self.centre, self.grids, self.shapes, self.table, index, out
        )
        return out


@inner_kernel
def _seen(x: float, y: float, turn: float, z: float, bearing: float, centre: Floats) -> tuple[float, float]:
    """Return the turn [rad] and the range [m] of a reading, seen from the centre; range 0 without a return."""
    if not math.isfinite(z):
        return turn, 0.0
    dx = x - centre[0] + z * math.cos(centre[2] + turn + bearing)
    dy = y - centre[1] + z * math.sin(centre[2] + turn + bearing)
    c, s = math.cos(centre[2] + bearing), math.sin(centre[2] + bearing)
    return math.atan2(c * dy - s * dx, c * dx + s * dy), math.hypot(dx, dy)


@outer_kernel
def _bounds(lasers: Floats, ranges: Floats, bearings: Floats, centre: Floats, out: Floats) -> None:
    """Fill out (n_rays, 4) with the smallest and largest turn and range of each ray."""
    for b in range(len(ranges)):
        out[b, 0], out[b, 1], out[b, 2], out[b, 3] = math.inf, -math.inf, math.inf, -math.inf
        for i in range(len(lasers)):
            angle = lasers[i, 2] - centre[2]
            angle -= 2.0 * math.pi * round(angle / (2.0 * math.pi))
            turn, rho = _seen(lasers[i, 0], lasers[i, 1], angle, ranges[b], bearings[b], centre)
            out[b, 0], out[b, 1] = min(out[b, 0], turn), max(out[b, 1], turn)
            out[b, 2], out[b, 3] = min(out[b, 2], rho), max(out[b, 3], rho)


@outer_kernel
def _add_up(
    lasers: Floats, ranges: Floats, bearings: Floats, centre: Floats, grids: Floats, shapes: Ints, table: Floats,
    index: Ints, out: Floats,
) -> None:  # fmt: skip
    """Add to out (n_poses,) the interpolated log-likelihoods of the rays `index`; outside a table, its border counts."""
    for b in index:
        first, n_turns, n_ranges = shapes[b]
        for i in range(len(lasers)):
            angle = lasers[i, 2] - centre[2]
            angle -= 2.0 * math.pi * round(angle / (2.0 * math.pi))
            turn, rho = _seen(lasers[i, 0], lasers[i, 1], angle, ranges[b], bearings[b], centre)
            u = min(max((turn - grids[b, 0]) / grids[b, 2], 0.0), n_turns - 1.0)
            v = min(max((rho - grids[b, 1]) / grids[b, 3], 0.0), n_ranges - 1.0)
            j, k = min(int(u), max(n_turns - 2, 0)), min(int(v), max(n_ranges - 2, 0))
            u, v = u - j, v - k
            here = first + j * n_ranges + k
            up = here + n_ranges if n_turns > 1 else here
            right = 1 if n_ranges > 1 else 0
            low = (1.0 - v) * table[here] + v * table[here + right]
            high = (1.0 - v) * table[up] + v * table[up + right]
            out[i] += (1.0 - u) * low + u * high


def tabulated(
    model: Model, every_bearing: Floats, mount: Floats, readings: Floats, poses: Floats, rays: Ints, broad: Floats,
    share: float,
) -> NearbyLikelihood:  # fmt: skip
    """Tabulate readings (n_rays,) [m] for poses (n_poses, 3) near each other.

    `broad` (n_rays,) is the log-likelihood of a reading where nothing is known, `share` the factor of all log-likelihoods.
    """
    lasers = np.ascontiguousarray(compose(poses, mount))
    turns = np.arctan2(np.sin(lasers[:, 2]).mean(), np.cos(lasers[:, 2]).mean())
    centre = np.array([*lasers[:, :2].mean(axis=0), turns])
    bearings = every_bearing[rays]
    bounds = np.empty((len(rays), 4))
    _bounds(lasers, readings, bearings, centre, bounds)
    spans = bounds[:, 1::2] - bounds[:, ::2]
    counts = np.ceil(spans / [TURN_STEP, RANGE_STEP]).astype(np.intp) + 1
    counts = np.minimum(counts, [MAX_TURNS, MAX_RANGES])
    steps = np.maximum(spans / np.maximum(counts - 1, 1), 1e-12)
    parts = []
    for b in range(len(rays)):
        turn = bounds[b, 0] + steps[b, 0] * np.arange(counts[b, 0])
        there = np.column_stack([np.tile(centre[:2], (len(turn), 1)), centre[2] + turn])
        z = readings[b] + np.zeros(1)
        if np.isfinite(readings[b]):
            z = bounds[b, 2] + steps[b, 1] * np.arange(counts[b, 1])
        found, known = _several(model, z, compose(there, invert(mount)), rays[b : b + 1])
        parts.append(share * np.where(known[:, None], found, 0.0 if np.isnan(readings[b]) else broad[b]))
    sizes = np.array([part.size for part in parts])
    return NearbyLikelihood(
        ranges=readings, bearings=bearings, mount=mount, centre=centre,
        grids=np.column_stack([bounds[:, ::2], steps]),
        shapes=np.column_stack([np.cumsum(sizes) - sizes, [part.shape for part in parts]]),
        table=np.concatenate([part.ravel() for part in parts]),
    )  # fmt: skip


def _several(model: Model, readings: Floats, poses: Floats, ray: Ints) -> tuple[Floats, Bools]:
    """Return the log-likelihoods (n_poses, n_readings) of readings of one ray, and which poses data support."""
    cells = model.cells if isinstance(model, Faces) else model
    if isinstance(cells, CellModel):  # a cast through cells takes longer than many readings
        found, known = cells.log_likelihoods(readings[None, None], poses, ray)
        return found[:, 0], known[:, 0]
    each = [model.log_likelihood(np.array([[z]]), poses, ray) for z in readings]
    return np.column_stack([found[:, 0] for found, _ in each]), each[0][1][:, 0]
