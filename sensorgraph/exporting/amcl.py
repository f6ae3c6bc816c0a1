"""AMCL's parameters from a run: the beam mixture by EM, the likelihood field, and the odometry noise.

The map gives the expected range z* of a reading z. Its beam model is

    p(z) = z_hit·N(z; z*, spread²) + z_short·E(z) + z_max·[z = range_max] + z_rand/range_max.

Here E(z) = rate·exp(-rate·z) / (1 - exp(-rate·z*)) for z < z*, and 0 otherwise. EM estimates its parameters (Thrun, Burgard and Fox, Probabilistic Robotics, 2005, tables 6.1 and 6.2). The
distance of returns to occupied cells gives the likelihood field (table 6.3). The noise of an odometry step
(table 5.6, as in Nav2's AMCL) is

    var(turn1 + turn2) = alpha1 (turn1² + turn2²) + 2 alpha2 way²,
    var(way) = alpha3 way² + alpha4 (turn1² + turn2²).

Every number has an interval, from a bootstrap over segments of the run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice, pairwise

import numpy as np
from scipy.optimize import nnls

from logs.run import OccupancyMap, Run, pair
from planners.arena import Arena, wrap
from sensorgraph.errors import SensorgraphError
from sensorgraph.exporting.amcl_filter import LASER_MODELS, CellDistances, filtered, updates
from sensorgraph.localization.odometry import odometry_at_scans, odometry_of
from sensorgraph.types import Floats
from sensorgraph.world.raycast import cast_laser, laser_poses

DEFAULTS: Mapping[str, float] = {
    "alpha1": 0.2, "alpha2": 0.2, "alpha3": 0.2, "alpha4": 0.2, "alpha5": 0.2, "lambda_short": 0.1,
    "laser_max_range": 100.0, "sigma_hit": 0.2, "z_hit": 0.5, "z_max": 0.05, "z_rand": 0.5, "z_short": 0.05,
}  # fmt: skip
"""Defaults of Nav2's AMCL (docs.nav2.org, AMCL configuration)."""
MAX_SCANS = 2000
"""Maximum number of scans for the mixture, spread evenly over the run."""
N_BLOCKS, N_DRAWS = 20, 200
"""Number of segments of the run, also for the comparison of laser models, and number of bootstrap draws of as many."""
EM_PASSES = 60
N_UPDATES, N_WARM_UP, N_PARTICLES = 25, 10, 500
"""Filter updates per segment; updates before the filter settles, which do not count; particles."""
MIN_STEPS = 40
"""Minimum number of odometry steps for an estimate of its noise."""
MAX_POSE_DISTANCE = 0.11
"""[s] Maximum time to the nearest reference pose: half the period of a laser of 5 Hz located by its scans."""
MOTION_NAMES = ("alpha1", "alpha2", "alpha3", "alpha4")


@dataclass(frozen=True, kw_only=True)
class BootstrapEstimate:
    """A value with its 95 % bootstrap interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.3g} ({self.low:.3g} to {self.high:.3g})"


def estimate_amcl(run: Run, arena: Arena, grid: OccupancyMap) -> dict[str, BootstrapEstimate]:
    """Return the parameters that a run with poses determines, by their names in Nav2.

    Parameters
    ----------
    run : Run with poses in the frame of the arena.
    grid : Map for AMCL; `sigma_hit` is the distance of returns to its occupied cells.

    Raises
    ------
    SensorgraphError : The run has no poses, or none at its scans.
    """
    pairing = pair(run)
    index = np.flatnonzero(pairing.paired)
    if len(index) == 0:
        raise SensorgraphError("the run has no pose at any scan; locate it first with `sensorgraph locate`")
    index = index[np.unique(np.linspace(0, len(index) - 1, min(MAX_SCANS, len(index))).astype(np.intp))]
    poses, readings = pairing.poses[index], run.ranges[index]
    out = _beam_mixture(run, arena, poses, readings, grid)
    out.update(_motion_noise(run))
    top = run.sensor.range_max
    out["laser_max_range"] = BootstrapEstimate(value=top, low=top, high=top)
    return out


@dataclass(frozen=True, kw_only=True)
class LaserModelChoice:
    """Chosen laser model of AMCL, with the errors of both models."""

    name: str
    default_error: BootstrapEstimate
    """[m] Median distance between the run's poses and a filter with Nav2's default laser model."""
    product_error: BootstrapEstimate
    """[m] The same with `likelihood_field_prob`."""

    def __str__(self) -> str:
        by_name = (
            f"{name} {100 * found.value:.1f} cm ({100 * found.low:.1f} to {100 * found.high:.1f})"
            for name, found in zip(LASER_MODELS, (self.default_error, self.product_error), strict=True)
        )
        default = "" if self.name == LASER_MODELS[0] else f"; Nav2's default is {LASER_MODELS[0]}"
        return f"median error against the run's poses: {', '.join(by_name)}{default}"


def compare_laser_models(
    run: Run, grid: OccupancyMap, parameters: Mapping[str, float]
) -> LaserModelChoice | None:
    """Track segments of the run by a filter with each laser model; None if the run has too little odometry.

    The default is replaced only if the interval of the difference excludes zero in favour of the product.

    Parameters
    ----------
    run : Run with poses in the frame of the map.
    parameters : Parameters by their names in Nav2.
    """
    motion, pairing = odometry_of(run), pair(run)
    if motion is None or len(run.odom_stamps) < MIN_STEPS:
        return None
    odometry, field = odometry_at_scans(run, motion), CellDistances.of(grid)
    medians = []
    for first in np.linspace(0, run.n_scans, N_BLOCKS, endpoint=False).astype(np.intp):
        known = first + np.flatnonzero(pairing.paired[first:])
        if len(known) == 0:
            break
        last = list(islice(updates(odometry[known]), N_UPDATES))[-1:]
        index = known[: last[0] + 1] if last else known[:1]
        at, truth = odometry[index], pairing.poses[index]
        errors = []
        for model in LASER_MODELS:
            poses = filtered(
                at, run.ranges[index], run.sensor, truth[0], field, parameters,
                rng=np.random.default_rng(0), laser_model=model, n_particles=N_PARTICLES,
            )  # fmt: skip
            errors.append(np.hypot(*(poses - truth)[:, :2].T))
        settled = np.flatnonzero(np.isfinite(errors[0]))[N_WARM_UP:]
        if len(settled):
            medians.append([float(np.median(error[settled])) for error in errors])
    if len(medians) < N_BLOCKS // 2:
        return None
    rows = np.array(medians)
    rng = np.random.default_rng(0)
    drawn = rng.integers(0, len(rows), (N_DRAWS, len(rows)))
    draws = np.median(rows[drawn], axis=1)  # (n_draws, 2)
    low, high = np.percentile(draws, [2.5, 97.5], axis=0)
    is_better = np.percentile(np.median((rows[:, 1] - rows[:, 0])[drawn], axis=1), 97.5) < 0
    default, product = _named(LASER_MODELS, np.median(rows, axis=0), low, high).values()
    return LaserModelChoice(name=LASER_MODELS[int(is_better)], default_error=default, product_error=product)


def _beam_mixture(
    run: Run, arena: Arena, poses: Floats, readings: Floats, grid: OccupancyMap
) -> dict[str, BootstrapEstimate]:
    """Estimate z_hit, z_short, z_max, z_rand, lambda_short and sigma_hit (Probabilistic Robotics, table 6.2)."""
    sensor = run.sensor
    lasers = laser_poses(poses, sensor.mount)
    expected, _ = cast_laser(arena.walls, lasers, sensor.bearings, sensor.range_max)
    expected = np.minimum(expected, sensor.range_max)
    is_max = ~(readings < sensor.range_max)  # beyond the range, or missing
    z = np.where(is_max, sensor.range_max, np.maximum(readings, 0.0))
    cell_distance = _distance_to_cells(lasers, sensor.bearings, np.where(is_max, np.nan, z), grid)
    block = np.arange(len(poses)) * N_BLOCKS // len(poses)
    names = ("z_hit", "z_short", "z_max", "z_rand", "lambda_short", "sigma_hit")
    start = (0.7, 0.1, 0.1, 0.1, 1.0, max(3 * sensor.sigma, grid.resolution))
    estimate = _fit_mixture(z, expected, is_max, cell_distance, sensor.range_max, start)
    block_estimates = [
        _fit_mixture(z[block == k], expected[block == k], is_max[block == k], cell_distance[block == k], sensor.range_max, estimate, 8)
        for k in range(min(N_BLOCKS, len(poses)))
    ]  # fmt: skip
    return _with_intervals(names, estimate, np.array(block_estimates))


def _fit_mixture(
    z: Floats,
    expected: Floats,
    is_max: np.ndarray,
    cell_distance: Floats,
    range_max: float,
    start: tuple[float, ...],
    passes: int = EM_PASSES,
) -> tuple[float, ...]:
    """Alternate the shares of each reading and the parameters of the mixture (EM)."""
    w_hit, w_short, w_max, w_rand, rate, _ = start
    is_hit = ~is_max
    miss = np.where(is_hit, z - expected, 0.0)
    spread = max(float(np.median(np.abs(miss[is_hit]))) * 1.48, 1e-3) if is_hit.any() else 0.1
    shares = np.zeros((4, *z.shape))
    for _ in range(passes):
        within = 1 - np.exp(-rate * np.maximum(expected, 1e-3))
        shares[0] = w_hit * is_hit * np.exp(-0.5 * (miss / spread) ** 2) / (spread * np.sqrt(2 * np.pi))
        shares[1] = w_short * is_hit * (z < expected) * rate * np.exp(-rate * z) / within
        shares[2] = w_max * is_max
        shares[3] = w_rand * is_hit / range_max
        shares /= np.maximum(shares.sum(axis=0), 1e-12)
        w_hit, w_short, w_max, w_rand = (float(part.mean()) for part in shares)
        rate = float(np.clip(shares[1].sum() / max((shares[1] * z).sum(), 1e-9), 0.01, 20.0))
        spread = max(float(np.sqrt((shares[0] * miss**2).sum() / max(shares[0].sum(), 1e-9))), 1e-3)
    known = np.isfinite(cell_distance)
    weight = shares[0][known]
    sigma = float(np.sqrt((weight * cell_distance[known] ** 2).sum() / max(weight.sum(), 1e-9)))
    return w_hit, w_short, w_max, w_rand, rate, sigma


def _distance_to_cells(lasers: Floats, bearings: Floats, z: Floats, grid: OccupancyMap) -> Floats:
    """Return the root mean square distance [m] of each return to an occupied cell; nan outside the map.

    It combines the distance between cell centres with a uniform position within the cell.
    """
    phi = lasers[:, 2:] + bearings
    ends = np.stack([lasers[:, :1] + z * np.cos(phi), lasers[:, 1:2] + z * np.sin(phi)], axis=-1)
    return np.asarray(np.hypot(CellDistances.of(grid).at(ends), grid.resolution / np.sqrt(12)))


def _motion_noise(run: Run) -> dict[str, BootstrapEstimate]:
    """Return alpha1 to alpha4 from odometry steps relative to those of the poses; {} if there are too few steps.

    The variances are linear in the alphas (see the module). Weighted non-negative least squares fits them to
    the squared errors. alpha5 only applies to omnidirectional robots.
    """
    steps = _steps(run)
    if len(steps) < MIN_STEPS:
        return {}
    estimate = _fit_alphas(steps)
    block = np.arange(len(steps)) * N_BLOCKS // len(steps)
    rng = np.random.default_rng(0)
    draws = []
    for _ in range(N_DRAWS):
        chosen = rng.integers(0, N_BLOCKS, N_BLOCKS)
        draws.append(_fit_alphas(np.concatenate([steps[block == k] for k in chosen])))
    low, high = np.percentile(draws, [2.5, 97.5], axis=0)
    return _named(MOTION_NAMES, estimate, low, high)


def _steps(run: Run) -> Floats:
    """Return (n, 6): first turn, way and second turn between two updates, of the odometry and of the poses."""
    if len(run.odom_stamps) < 2 or len(run.pose_stamps) < 2:
        return np.zeros((0, 6))
    stamps, odometry = run.odom_stamps, run.odometry
    after = np.searchsorted(run.pose_stamps, stamps).clip(1, len(run.pose_stamps) - 1)
    known = (stamps >= run.pose_stamps[0]) & (stamps <= run.pose_stamps[-1])
    nearest = np.minimum(run.pose_stamps[after] - stamps, stamps - run.pose_stamps[after - 1])
    known &= nearest <= MAX_POSE_DISTANCE
    phi = np.unwrap(run.poses[:, 2])
    truth = np.column_stack(
        [np.interp(stamps, run.pose_stamps, part) for part in (run.poses[:, 0], run.poses[:, 1], phi)]
    )
    odometry, truth = odometry[known], truth[known]
    out = [
        [*_turn_way_turn(odometry[a], odometry[b]), *_turn_way_turn(truth[a], truth[b])]
        for a, b in pairwise([0, *updates(odometry)])
    ]
    return np.array(out, dtype=np.float64).reshape(-1, 6)


def _turn_way_turn(a: Floats, b: Floats) -> tuple[float, float, float]:
    """Split a step into turn, way, turn, as AMCL does; a way below 1 cm has no direction."""
    way = float(np.hypot(*(b[:2] - a[:2])))
    first = 0.0 if way < 0.01 else float(wrap(np.arctan2(b[1] - a[1], b[0] - a[0]) - a[2]))
    backwards = abs(first) > np.pi / 2  # reversing: the turn is relative to the rear
    first = float(wrap(first + np.pi)) if backwards else first
    return first, -way if backwards else way, float(wrap(b[2] - a[2] - first))


def _fit_alphas(steps: Floats) -> Floats:
    """Fit alpha1 to alpha4 to the errors of the total turn and of the way.

    The two turns are not fitted separately: on a short way its direction is noise of the poses. The two turns
    then have opposite errors, and the heading of the robot has none.
    """
    turn, true_turn = steps[:, 0] + steps[:, 2], steps[:, 3] + steps[:, 5]
    turns, ways = steps[:, 3] ** 2 + steps[:, 5] ** 2, steps[:, 4] ** 2  # of the poses, as those of the
    none = np.zeros(len(steps))  # odometry contain its noise
    rows = np.concatenate(
        [
            np.stack([turns, 2 * ways, none, none], axis=1),
            np.stack([none, none, ways, turns], axis=1),
        ]
    )
    squares = np.concatenate([wrap(turn - true_turn), steps[:, 1] - steps[:, 4]]) ** 2
    alphas = np.full(4, 0.1)
    for _ in range(8):  # the variance of a square is twice its squared mean
        weight = 1 / np.maximum(rows @ alphas, 1e-8)
        alphas = nnls(rows * weight[:, None], squares * weight)[0]
    return np.asarray(alphas)


def _with_intervals(
    names: tuple[str, ...], estimate: tuple[float, ...], block_estimates: Floats
) -> dict[str, BootstrapEstimate]:
    """Return the values of the whole run, with intervals from a bootstrap over its segments."""
    rng = np.random.default_rng(0)
    means = block_estimates[rng.integers(0, len(block_estimates), (N_DRAWS, len(block_estimates)))].mean(
        axis=1
    )
    half = (np.percentile(means, 97.5, axis=0) - np.percentile(means, 2.5, axis=0)) / 2
    return _named(names, np.array(estimate), np.maximum(estimate - half, 0.0), estimate + half)


def _named(names: Sequence[str], values: Floats, low: Floats, high: Floats) -> dict[str, BootstrapEstimate]:
    """Return values (n,) with the ends of their intervals (n,) by names."""
    rows = np.column_stack([values, low, high]).tolist()
    return {
        name: BootstrapEstimate(value=v, low=a, high=b) for name, (v, a, b) in zip(names, rows, strict=True)
    }
