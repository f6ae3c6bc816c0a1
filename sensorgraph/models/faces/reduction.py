"""Reduction of scans in one pass: sums that can be added, so that logs can be streamed, merged and distributed.

A block of scans is reduced to pooled moments of its hits, counts of the space that its rays crossed, and a sample of
its rays. Blocks have fixed boundaries and are merged in order, so the sums are identical to the last bit,
independently of how the logs were read and where the blocks were reduced.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from logs.run import RangeSensor
from logs.transforms import compose
from sensorgraph.models.base import TrainingScans
from sensorgraph.models.faces.hit_moments import HitMoments
from sensorgraph.models.faces.observed_space import ObservedSpace
from sensorgraph.models.faces.strata import spread_evenly
from sensorgraph.models.faces.visibility import Rays
from sensorgraph.types import Floats

SCANS_PER_BLOCK = 8192
"""Number of scans in a block; like the numbers of rays, it was set by time and memory
(`python -m benchmarks.infrastructure build`)."""
MAX_SAMPLED_RAYS = 1_500_000
"""Number of collected rays that are sampled, spread evenly over places and directions."""
LOWER_QUARTILE = float(ndtri(0.625))
"""Lower quartile of the absolute value of a standard normal variable."""
MAX_COLLECTED_RAYS = 2 * MAX_SAMPLED_RAYS
"""Expected number of rays collected from a whole log."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RaySample:
    """Some rays as logged: pose, index and range."""

    poses: Floats
    """(n, 3) [m, m, rad] pose of the scan."""
    beams: NDArray[np.int32]
    """(n,) index of the ray in its scan."""
    ranges: Floats
    """(n,) [m] range; +inf: no return."""
    ray_poses: Floats | None = None
    """(n, 3) [m, m, rad] pose at the time of the ray, for a sweeping laser; None: `poses`."""
    weights: Floats | None = None
    """(n,) number of rays that each ray represents; None: all the same."""

    @property
    def poses_of_rays(self) -> Floats:
        """(n, 3) [m, m, rad] pose at the time of each ray, for a sweeping laser or not."""
        return self.poses if self.ray_poses is None else self.ray_poses

    def __len__(self) -> int:
        return len(self.ranges)

    def noise(self, bearings: Floats) -> float:
        """Return the range noise [m] by the ranges r of three neighbouring rays; 0 if too few are known.

        On a wall 1 / r is a sinusoid of the bearing. With the angles a and b between the rays, q is the noise:

            q = sin(b) / r_1 - sin(a + b) / r_2 + sin(a) / r_3,  var(q) = sigma² (sin²(b) / r_1⁴ + ...)

        It is larger at edges and on clutter, so that its lower quartile counts.

        Parameters
        ----------
        bearings : (n_rays,) [rad]
        """
        is_next = np.diff(self.beams) == 1
        first = np.flatnonzero(is_next[:-1] & is_next[1:])
        r = self.ranges[first[:, None] + np.arange(3)]
        known = np.isfinite(r).all(axis=1)
        r, steps = r[known], np.diff(bearings[self.beams[first[known, None]] + np.arange(3)])
        if len(r) == 0:
            return 0.0
        factors = np.sin(np.column_stack([steps[:, 1], -steps.sum(axis=1), steps[:, 0]]))
        q, scale = (factors / r).sum(axis=1), np.sqrt(((factors / r**2) ** 2).sum(axis=1))
        return float(np.quantile(np.abs(q) / scale, 0.25)) / LOWER_QUARTILE

    def spread_evenly(self, sensor: RangeSensor) -> RaySample:
        """Return at most MAX_SAMPLED_RAYS rays, with up to the same number from each place and direction."""
        if len(self) <= MAX_SAMPLED_RAYS:
            return self
        poses = self.poses_of_rays
        turn = np.mod(poses[:, 2] + sensor.bearings[self.beams], 2 * np.pi)
        kept, weights = spread_evenly(poses[:, :2], turn, MAX_SAMPLED_RAYS)
        return RaySample(
            poses=self.poses[kept],
            beams=self.beams[kept],
            ranges=self.ranges[kept],
            ray_poses=None if self.ray_poses is None else self.ray_poses[kept],
            weights=weights,
        )

    def rays(self, sensor: RangeSensor, mount: Floats) -> Rays:
        """Return the rays of a laser mounted at `mount` (3,)."""
        lasers = compose(self.poses_of_rays, mount)
        theta = lasers[:, 2] + sensor.bearings[self.beams]
        return Rays(
            origins=np.ascontiguousarray(lasers[:, :2]),  # kernels are compiled for this layout
            directions=np.stack([np.cos(theta), np.sin(theta)], axis=1),
            ranges=self.ranges,
            range_max=sensor.range_max,
            weights=self.weights,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Reduction:
    """The reduction of any number of scans."""

    hit_moments: HitMoments
    observed: ObservedSpace
    sample: RaySample
    n_rays: int
    """Number of rays that are valid and not too close."""
    n_returns: int

    def spread_evenly(self, sensor: RangeSensor) -> Reduction:
        """Return the reduction with a sample that is spread evenly, whose weights sum to the number of all rays."""
        sample = self.sample.spread_evenly(sensor)
        if sample.weights is not None:
            sample = replace(sample, weights=sample.weights * (self.n_rays / sample.weights.sum()))
        return replace(self, sample=sample)


@dataclass(frozen=True, kw_only=True, eq=False)
class Block:
    """Scans that are reduced together."""

    first: int
    """Number of scans before this block, in this log and the preceding ones."""
    scans: TrainingScans


class MapBlocks(Protocol):
    """`map`, or a function that distributes the work and returns results in the order of the items."""

    def __call__(
        self, function: Callable[[Block], Reduction], items: Iterable[Block], /
    ) -> Iterator[Reduction]:
        """Apply the function to every item."""
        ...


def blocks_of(scans: TrainingScans, size: int = SCANS_PER_BLOCK) -> Iterator[Block]:
    """Divide scans into blocks."""
    for start in range(0, len(scans), size):
        yield Block(first=start, scans=scans.part(slice(start, start + size)))


def reduce_block(block: Block, *, mount: Floats, share: float) -> Reduction:
    """Reduce one block for a laser mounted at `mount` (3,); the sample keeps `share` of its rays."""
    scans = block.scans
    sensor, poses, bearings = scans.sensor, scans.poses, scans.sensor.bearings
    ranges = np.ascontiguousarray(scans.ranges, dtype=np.float64)
    if scans.ray_poses is not None:  # each ray is a separate scan; the heading below includes its bearing
        poses, ranges, bearings = scans.ray_poses.reshape(-1, 3), ranges.reshape(-1, 1), np.zeros(1)
    x, y, theta = np.ascontiguousarray(compose(poses, mount).T)
    if scans.ray_poses is not None:
        theta += np.tile(sensor.bearings, len(scans))
    place = np.flatnonzero(ranges > 0)  # neither too close nor broken
    row, beam = np.divmod(place, ranges.shape[1])
    cos, sin = np.cos(theta)[row], np.sin(theta)[row]
    cos_b, sin_b = np.cos(bearings)[beam], np.sin(bearings)[beam]
    origins = np.column_stack([x[row], y[row]])
    directions = np.column_stack([cos * cos_b - sin * sin_b, sin * cos_b + cos * sin_b])
    reach = ranges.ravel()[place]
    returned = reach < np.inf
    reach[~returned] = sensor.range_max
    ends = origins + reach[:, None] * directions
    ends[~returned] = np.nan
    taken = place if share >= 1 else place[_is_sampled(place, block.first * sensor.n_rays, share)]
    row, beam = np.divmod(taken, sensor.n_rays)
    return Reduction(
        hit_moments=HitMoments.of(ends, directions),
        observed=ObservedSpace.of(origins, directions, reach, returned=returned),
        sample=RaySample(
            poses=scans.poses[row],
            beams=beam.astype(np.int32),
            ranges=ranges.ravel()[taken],
            ray_poses=None if scans.ray_poses is None else scans.ray_poses[row, beam],
        ),
        n_rays=len(place),
        n_returns=int(returned.sum()),
    )


def reduce_blocks(
    blocks: Iterable[Block],
    *,
    mount: Floats,
    n_rays: int,
    map_blocks: MapBlocks = map,
    tick: Callable[[], None] | None = None,
) -> Reduction | None:
    """Reduce blocks and merge the results in order; None without blocks.

    Parameters
    ----------
    n_rays : Approximate number of rays in all blocks; it determines the share of the sample.
    map_blocks : Function that reduces the blocks; `map` runs here, one block after the other.
    """
    work = partial(reduce_block, mount=mount, share=min(1.0, MAX_COLLECTED_RAYS / max(n_rays, 1)))
    total: Reduction | None = None
    samples: list[RaySample] = []
    for part in map_blocks(work, blocks):
        samples.append(part.sample)  # concatenated once, not with every block
        total = (
            part
            if total is None
            else replace(
                total,
                hit_moments=total.hit_moments.merge(part.hit_moments),
                observed=total.observed.merge(part.observed),
                n_rays=total.n_rays + part.n_rays,
                n_returns=total.n_returns + part.n_returns,
            )
        )
        if tick is not None:
            tick()
    return None if total is None else replace(total, sample=_concatenate(samples))


def _concatenate(samples: Sequence[RaySample]) -> RaySample:
    return RaySample(
        poses=np.concatenate([s.poses for s in samples]),
        beams=np.concatenate([s.beams for s in samples]),
        ranges=np.concatenate([s.ranges for s in samples]),
        ray_poses=np.concatenate([s.poses_of_rays for s in samples])
        if any(s.ray_poses is not None for s in samples)
        else None,
    )


def _is_sampled(place: NDArray[np.int64], first: int, share: float) -> NDArray[np.bool_]:
    """Select rays by a hash of their number in the log (splitmix64, Steele et al. 2014), so that the choice is fixed."""
    with np.errstate(over="ignore"):
        z = (place.astype(np.uint64) + np.uint64(first)) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z ^= z >> np.uint64(31)
    return np.asarray(z < np.uint64(int(share * 2**64)))
