"""What one pass leaves of scans adds up: however a log is cut or spread, the same is left."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from logs.run import RangeSensor
from planners.arena import Arena
from sensorgraph.models.base import TrainingScans
from sensorgraph.models.faces import reduction
from sensorgraph.models.faces.hit_moments import HitMoments
from sensorgraph.models.faces.model import Faces
from sensorgraph.models.faces.observed_space import ObservedSpace, is_ray_observed, missing_returns_are_free
from sensorgraph.models.faces.reduction import Reduction, blocks_of, reduce_blocks
from sensorgraph.types import Bools, Floats
from sensorgraph.world.raycast import cast


@pytest.fixture(scope="module")
def scans(room: Arena, sensor: RangeSensor) -> TrainingScans:
    """Return 500 scans in the room, with readings that do not count among them."""
    rng = np.random.default_rng(0)
    poses = rng.uniform([0.4, 0.4, -np.pi], [2.2, 2.6, np.pi], (500, 3))
    ranges = cast(room, poses, sensor).ranges
    ranges = ranges + 0.01 * rng.normal(size=ranges.shape)
    for value in (np.nan, -np.inf, np.inf):
        ranges[rng.random(ranges.shape) < 0.02] = value
    return TrainingScans(sensor=sensor, poses=poses, ranges=ranges, run=np.zeros(500, dtype=np.intp))


def reduce(scans: TrainingScans, size: int, map_blocks=map) -> Reduction:
    left = reduce_blocks(
        blocks_of(scans, size=size), mount=scans.laser_mount, n_rays=scans.ranges.size, map_blocks=map_blocks
    )
    assert left is not None
    return left


def test_counts_are_those_of_a_plain_count(scans: TrainingScans) -> None:
    left = reduce(scans, 500)
    assert left.n_rays == (scans.ranges > 0).sum()
    assert left.n_returns == left.hit_moments.counts.sum() == np.isfinite(scans.ranges).sum()
    assert len(left.sample) == left.n_rays


@pytest.mark.parametrize("size", [1, 77, 499])
def test_blocks_of_any_size_leave_the_same(scans: TrainingScans, size: int) -> None:
    whole, parts = reduce(scans, 500), reduce(scans, size)
    np.testing.assert_array_equal(parts.hit_moments.cells, whole.hit_moments.cells)
    np.testing.assert_allclose(parts.hit_moments.moments, whole.hit_moments.moments, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(parts.sample.ranges, whole.sample.ranges)
    np.testing.assert_array_equal(parts.sample.poses, whole.sample.poses)
    assert parts.observed.counts.sum() == whole.observed.counts.sum()
    assert parts.observed.free.sum() == whole.observed.free.sum()


def test_the_sample_is_the_same_share_of_every_part(
    scans: TrainingScans, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reduction, "MAX_COLLECTED_RAYS", 6000)
    a, b = reduce(scans, 500), reduce(scans, 61)
    np.testing.assert_array_equal(a.sample.beams, b.sample.beams)
    n = a.n_rays * 6000 / scans.ranges.size
    assert abs(len(a.sample) - n) < 5 * np.sqrt(n)
    shares = np.bincount(a.sample.beams, minlength=61)
    assert shares.min() > 0.5 * shares.mean()


def test_a_long_stay_elsewhere_does_not_thin_what_was_passed_once(
    scans: TrainingScans, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = np.where(np.arange(500)[:, None] < 30, [2.0, 2.5], [0.4, 0.4])
    poses = np.column_stack([place, scans.poses[:, 2]])
    ranges = np.ones_like(scans.ranges)
    monkeypatch.setattr(reduction, "MAX_SAMPLED_RAYS", ranges.size // 3)
    left = reduce(replace(scans, poses=poses, ranges=ranges), 61).spread_evenly(scans.sensor).sample
    assert 0.95 * ranges.size // 3 < len(left) <= ranges.size // 3
    assert (left.poses[:, 0] == 2.0).sum() == 30 * ranges.shape[1]


def test_sample_gives_the_rays_of_the_mounted_laser(scans: TrainingScans) -> None:
    rays = reduce(scans, 500).sample.rays(scans.sensor, scans.laser_mount)
    ends = rays.hits[np.isfinite(rays.ranges)]
    assert (ends > [-0.1, -0.1]).all() and (ends < [4.1, 3.1]).all()
    np.testing.assert_allclose(np.hypot(*rays.directions.T), 1.0)


def test_surfaces_merge_to_what_all_hits_give() -> None:
    rng = np.random.default_rng(1)
    points, along = rng.uniform(-1, 1, (4000, 2)), rng.normal(size=(4000, 2))
    whole = HitMoments.of(points, along)
    merged = HitMoments.of(points[:1500], along[:1500]).merge(HitMoments.of(points[1500:], along[1500:]))
    np.testing.assert_array_equal(merged.cells, whole.cells)
    np.testing.assert_allclose(merged.moments, whole.moments, atol=1e-12)


def test_crossed_grids_of_other_cells_merge_into_the_coarser(scans: TrainingScans) -> None:
    fine = reduce(scans, 500).observed
    coarse = fine.coarser()
    assert coarse.cell == 2 * fine.cell
    assert coarse.counts[coarse.counts < 255].sum() <= fine.counts.sum()
    both = fine.merge(coarse)
    assert both.cell == coarse.cell
    i, j = np.nonzero(fine.counts)
    centres = fine.origin + (np.stack([i, j], axis=1) + 0.5) * fine.cell
    at = np.floor((centres - both.origin) / both.cell).astype(int)
    assert (both.counts[tuple(at.T)] > 0).all()


def are_observed(grid: ObservedSpace, origins: Floats, directions: Floats, reach: Floats) -> Bools:
    """Return whether rays (n,) crossed only observed cells."""
    space = grid.origin, grid.cell, grid.distance_to_unobserved
    rays = zip(origins, directions, reach, strict=True)
    return np.array([is_ray_observed(*start, *along, far, *space) for start, along, far in rays])


def test_far_rays_make_cells_coarser_not_memory_larger() -> None:
    origins = np.array([[0.0, 0.0], [50_000.0, 30_000.0]])
    grid = ObservedSpace.of(origins, np.array([[1.0, 0.0], [0.0, 1.0]]), np.full(2, 5.0))
    assert grid.counts.size < 1 << 27
    assert are_observed(grid, origins, np.array([[1.0, 0.0], [0.0, 1.0]]), np.full(2, 4.0)).all()


def test_nothing_is_left_of_nothing(scans: TrainingScans) -> None:
    assert reduce_blocks([], mount=np.zeros(3), n_rays=0) is None
    blind = replace(scans, ranges=np.full_like(scans.ranges, np.inf))
    left = reduce(blind, 100)
    assert left.n_returns == 0 and len(left.hit_moments.cells) == 0


def test_jumping_through_crossed_space_agrees_with_a_walk_in_small_steps() -> None:
    rng = np.random.default_rng(12)
    counts = np.ones((60, 50), dtype=np.uint8)
    counts[tuple(rng.integers(0, (60, 50), (40, 2)).T)] = 0
    grid = ObservedSpace(origin=np.array([-2.0, -1.5]), cell=0.1, counts=counts, free=counts > 0)
    origins = rng.uniform([-1.9, -1.4], [3.9, 3.4], (1000, 2))
    turn = rng.uniform(-np.pi, np.pi, 1000)
    turn[:40] = np.repeat([0.0, np.pi / 2, np.pi, -np.pi / 2], 10)
    directions = np.column_stack([np.cos(turn), np.sin(turn)])
    reach = rng.uniform(0.0, 4.0, 1000)
    steps = np.linspace(0.0, 1.0, 4001) * reach[:, None]  # 1 mm: a corner cut by less is not told
    cells = np.floor((origins[:, None] + steps[..., None] * directions[:, None] - grid.origin) / 0.1).astype(
        int
    )
    inside = ((cells >= 0) & (cells < counts.shape)).all(axis=-1)
    known = inside & (counts[tuple(np.clip(cells, 0, np.array(counts.shape) - 1).T)].T > 0)
    differ = are_observed(grid, origins, directions, reach) != known.all(axis=1)
    assert 0.2 < known.all(axis=1).mean() < 0.8
    assert differ.mean() < 0.005


def test_hits_are_those_of_all_rays_though_the_sample_is_even(
    room: Arena, scans: TrainingScans, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A corner is passed in 40 of 500 scans: its rays all stay, and count no more than the others for that."""
    passing = np.arange(500) < 40
    poses = np.where(passing[:, None], [3.4, 2.4, 0.5], [0.5, 0.5, -0.6])
    scans = replace(scans, poses=poses + np.random.default_rng(3).normal(0, 0.02, (500, 3)))
    readings = cast(room, scans.poses, scans.sensor).ranges
    scans = replace(scans, ranges=readings + 0.01 * np.random.default_rng(4).normal(size=readings.shape))

    def hits_by_wall() -> np.ndarray:
        fitted = Faces.fit(scans, calibrate=False)
        wall = np.round(np.degrees(np.arctan2(*fitted.faces.normals.T[::-1])) / 90) % 4
        return np.bincount(wall.astype(int), weights=fitted.hits, minlength=4)

    every = hits_by_wall()
    monkeypatch.setattr(reduction, "MAX_SAMPLED_RAYS", scans.ranges.size // 3)
    np.testing.assert_allclose(hits_by_wall(), every, rtol=0.02)


def test_missing_returns_are_of_free_rays_where_things_stop_rays_at_one_rate() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        lengths = rng.exponential(rng.uniform(3.0, 40.0), 20_000)  # [m] to the next tree of a forest
        assert missing_returns_are_free(np.where(lengths < 8.0, lengths, np.inf), 8.0)
    assert missing_returns_are_free(np.array([1.0, 2.0, 3.0]), 8.0)


def test_missing_returns_are_not_of_free_rays_where_few_return_from_so_far() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        ranges = rng.uniform(0.5, 6.0, 20_000)  # [m] to the walls of a room
        ranges[rng.random(20_000) < rng.uniform(0.003, 0.1)] = np.inf
        assert not missing_returns_are_free(ranges, 80.0)


def test_space_behind_dark_things_is_looked_at_and_not_known_to_be_free(scans: TrainingScans) -> None:
    far = replace(scans, sensor=replace(scans.sensor, range_max=80.0))
    known = reduce(far, 100).observed.with_missing(scans.ranges[scans.ranges > 0], 80.0)
    returned = np.isfinite(scans.ranges)
    plain = reduce(replace(far, ranges=np.where(returned, scans.ranges, np.nan)), 100).observed
    assert known.free.sum() == (plain.counts > 0).sum() < 0.01 * (known.counts > 0).sum()
    near = reduce(scans, 100).observed.with_missing(np.array([1.0, 2.0]), 8.0)
    np.testing.assert_array_equal(near.free, near.counts > 0)


@pytest.mark.parametrize("n", [2, 3])
def test_hits_of_a_smaller_place_are_those_of_points_that_are_closer(n: int) -> None:
    rng = np.random.default_rng(6)
    points, directions = rng.normal(0.0, 1.0, (500, 2)), rng.normal(0.0, 1.0, (500, 2))
    smaller = HitMoments.of(points / n, directions)
    found = HitMoments.of(points, directions).scaled_down(n)
    np.testing.assert_array_equal(found.cells, smaller.cells)
    np.testing.assert_allclose(found.moments, smaller.moments, atol=1e-12)


@pytest.mark.parametrize("sigma", [0.01, 0.03])
@pytest.mark.parametrize("every", [1, 3])
def test_the_noise_of_neighbouring_rays_is_that_of_the_laser(
    scans: TrainingScans, sigma: float, every: int
) -> None:
    """Rays that are 9° apart, too, though their ranges differ by more than the noise."""
    own = 0.01
    noise = np.sqrt(sigma**2 - own**2) * np.random.default_rng(0).normal(size=scans.ranges.shape)
    sensor = replace(scans.sensor, bearings=scans.sensor.bearings[::every])
    some = replace(scans, sensor=sensor, ranges=(scans.ranges + noise)[:, ::every])
    found = reduce(some, 7).sample.noise(sensor.bearings)
    assert found == pytest.approx(sigma, rel=0.4)  # edges are in it, too
