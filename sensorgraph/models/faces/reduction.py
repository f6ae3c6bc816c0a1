"""Reduction: what one pass over scans leaves of them; it adds up, so logs can be streamed, merged and distributed.

A block of scans becomes pooled moments of its hits, counts of the space its rays crossed, and a sample of its rays.
Blocks are cut at fixed places and merged in their order, so that the sums agree to the last bit however the blocks
were read and wherever they were reduced.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from logs.run import RangeSensor
from planners.kernel import kernel
from sensorgraph.models.base import TrainingScans
from sensorgraph.models.faces.hit_moments import HitMoments
from sensorgraph.models.faces.observed_space import ObservedSpace
from sensorgraph.models.faces.settings import FACES
from sensorgraph.models.faces.strata import spread_evenly
from sensorgraph.models.faces.visibility import Rays
from sensorgraph.types import Floats

SCANS_PER_BLOCK = FACES.reduction.scans_per_block
MAX_COLLECTED_RAYS = FACES.reduction.max_collected_rays
MAX_SAMPLED_RAYS = FACES.reduction.max_sampled_rays


@dataclass(frozen=True, kw_only=True, eq=False)
class RaySample:
    """Some rays, as the log has them: at which pose, which ray, what range."""

    poses: Floats
    """(n, 3) [m, m, rad] of the scan."""
    beams: NDArray[np.int32]
    """(n,) index of the ray in its scan."""
    ranges: Floats
    """(n,) [m]; +inf nothing seen."""
    ray_poses: Floats | None = None
    """(n, 3) [m, m, rad] where the ray was taken, of a laser that sweeps; None: all at `poses`."""
    weights: Floats | None = None
    """(n,) rays that each stands for; None: all the same."""

    @property
    def poses_of_rays(self) -> Floats:
        """(n, 3) [m, m, rad] where each ray was taken, whether the laser sweeps or not."""
        return self.poses if self.ray_poses is None else self.ray_poses

    def __len__(self) -> int:
        return len(self.ranges)

    def merge(self, other: RaySample) -> RaySample:
        """Put two samples one after the other."""
        return _concatenate([self, other])

    def spread_evenly(self, sensor: RangeSensor) -> RaySample:
        """Return MAX_SAMPLED_RAYS of them at most, as many of each place and direction as far as there are any."""
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
        """Return them as rays from a laser mounted at `mount` (3,)."""
        poses = self.poses_of_rays
        cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        x = poses[:, 0] + cos * mount[0] - sin * mount[1]
        y = poses[:, 1] + sin * mount[0] + cos * mount[1]
        theta = poses[:, 2] + mount[2] + sensor.bearings[self.beams]
        return Rays(
            origins=np.stack([x, y], axis=1),
            directions=np.stack([np.cos(theta), np.sin(theta)], axis=1),
            ranges=self.ranges,
            range_max=sensor.range_max,
            weights=self.weights,
        )


EMPTY_SAMPLE = RaySample(poses=np.zeros((0, 3)), beams=np.zeros(0, dtype=np.int32), ranges=np.zeros(0))


@dataclass(frozen=True, kw_only=True, eq=False)
class Reduction:
    """What is left of any number of scans."""

    hit_moments: HitMoments
    observed: ObservedSpace
    sample: RaySample
    n_rays: int
    """All that were neither broken nor too near."""
    n_returns: int

    def spread_evenly(self, sensor: RangeSensor) -> Reduction:
        """Return the same with a sample that is spread evenly, whose weights add up to all rays."""
        sample = self.sample.spread_evenly(sensor)
        if sample.weights is not None:
            sample = replace(sample, weights=sample.weights * (self.n_rays / sample.weights.sum()))
        return replace(self, sample=sample)

    def merge(self, other: Reduction) -> Reduction:
        """Add up two disjoint sets of scans, those of `self` first."""
        return Reduction(
            hit_moments=self.hit_moments.merge(other.hit_moments),
            observed=self.observed.merge(other.observed),
            sample=self.sample.merge(other.sample),
            n_rays=self.n_rays + other.n_rays,
            n_returns=self.n_returns + other.n_returns,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Block:
    """Scans that are reduced in one go."""

    first: int
    """How many scans came before, in this log and those before it."""
    scans: TrainingScans


class MapBlocks(Protocol):
    """`map`, or something like it that spreads the work; results come in the order of the items."""

    def __call__(
        self, function: Callable[[Block], Reduction], items: Iterable[Block], /
    ) -> Iterator[Reduction]:
        """Apply the function to every item."""
        ...


def blocks_of(scans: TrainingScans, first: int = 0, size: int = SCANS_PER_BLOCK) -> Iterator[Block]:
    """Cut scans into blocks."""
    for start in range(0, len(scans), size):
        yield Block(first=first + start, scans=scans.part(slice(start, start + size)))


def reduce_block(block: Block, *, mount: Floats, share: float) -> Reduction:
    """Reduce one block for a laser mounted at `mount` (3,); `share` of its rays are kept in the sample."""
    scans = block.scans
    sensor, poses, bearings = scans.sensor, scans.poses, scans.sensor.bearings
    ranges = np.ascontiguousarray(scans.ranges, dtype=np.float64)
    if scans.ray_poses is not None:  # each ray is a scan of its own, with its bearing in the heading below
        poses, ranges, bearings = scans.ray_poses.reshape(-1, 3), ranges.reshape(-1, 1), np.zeros(1)
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = poses[:, 0] + cos * mount[0] - sin * mount[1], poses[:, 1] + sin * mount[0] + cos * mount[1]
    theta = poses[:, 2] + mount[2]
    if scans.ray_poses is not None:
        theta += np.tile(sensor.bearings, len(scans))
    n = ranges.size
    origins, directions, ends = np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 2))
    reach, place = np.empty(n), np.empty(n, dtype=np.int64)
    n_rays, n_returns = _flatten(
        x, y, np.cos(theta), np.sin(theta), np.cos(bearings), np.sin(bearings), ranges,
        sensor.range_max, origins, directions, ends, reach, place,
    )  # fmt: skip
    origins, directions, ends = origins[:n_rays], directions[:n_rays], ends[:n_rays]
    reach, place = reach[:n_rays], place[:n_rays]
    taken = place if share >= 1 else place[_is_sampled(place, block.first * sensor.n_rays, share)]
    row, beam = np.divmod(taken, sensor.n_rays)
    return Reduction(
        hit_moments=HitMoments.of(ends, directions),
        observed=ObservedSpace.of(origins, directions, reach, returned=np.isfinite(ranges.ravel()[place])),
        sample=RaySample(
            poses=scans.poses[row],
            beams=beam.astype(np.int32),
            ranges=ranges.ravel()[taken],
            ray_poses=None if scans.ray_poses is None else scans.ray_poses[row, beam],
        ),
        n_rays=n_rays,
        n_returns=n_returns,
    )


def reduce_blocks(
    blocks: Iterable[Block],
    *,
    mount: Floats,
    n_rays: int,
    map_blocks: MapBlocks = map,
    tick: Callable[[], None] | None = None,
) -> Reduction | None:
    """Reduce blocks and merge what is left of them in their order; None where there is no block.

    Parameters
    ----------
    n_rays : of all blocks together, about: it says how thin the sample is
    map_blocks : where the blocks are reduced; `map`: here, one after the other
    """
    work = partial(reduce_block, mount=mount, share=min(1.0, MAX_COLLECTED_RAYS / max(n_rays, 1)))
    total: Reduction | None = None
    samples: list[RaySample] = []
    for part in map_blocks(work, blocks):
        samples.append(part.sample)  # put together once, not again with every block
        part = replace(part, sample=EMPTY_SAMPLE)
        total = part if total is None else total.merge(part)
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


@kernel
def _flatten(
    x: Any,
    y: Any,
    cos: Any,
    sin: Any,
    cos_b: Any,
    sin_b: Any,
    ranges: Any,
    range_max: Any,
    origins: Any,
    directions: Any,
    ends: Any,
    reach: Any,
    place: Any,
) -> Any:
    """List rays that are neither broken nor too near: where they start, point and end (nan: nothing seen)."""
    n, n_returns = 0, 0
    for i in range(ranges.shape[0]):
        for b in range(ranges.shape[1]):
            z = ranges[i, b]
            if not z > 0:
                continue
            ux, uy = cos[i] * cos_b[b] - sin[i] * sin_b[b], sin[i] * cos_b[b] + cos[i] * sin_b[b]
            origins[n, 0], origins[n, 1] = x[i], y[i]
            directions[n, 0], directions[n, 1] = ux, uy
            place[n] = i * ranges.shape[1] + b
            if z < np.inf:
                reach[n] = z
                ends[n, 0], ends[n, 1] = x[i] + z * ux, y[i] + z * uy
                n_returns += 1
            else:
                reach[n] = range_max
                ends[n, 0], ends[n, 1] = np.nan, np.nan
            n += 1
    return n, n_returns


def _is_sampled(place: NDArray[np.int64], first: int, share: float) -> NDArray[np.bool_]:
    """Choose rays by a hash of their number in the log (splitmix64, Steele et al. 2014): the same ones always."""
    with np.errstate(over="ignore"):
        z = (place.astype(np.uint64) + np.uint64(first)) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z ^= z >> np.uint64(31)
    return np.asarray(z < np.uint64(int(share * 2**64)))
