"""A graph as a sensor model of real logs: intervals, scores and chances of its distribution, beside other models.

    python -m benchmarks.sensor_model LOG [LOG ...] [--placements N] [--dither STEP] [--picture FILE.png]

Each log is built without five stretches (those of `--split block`), and scored on these, where the graph answers
and the return is between 0.1 and 10 m. Beside it: the beam model (Thrun, Burgard and Fox 2005, section 6.2) on the tuned
5 cm occupancy grid of `occupancy_grid.py`, its z_hit, z_short, z_rand and sigma fitted by EM to half of the held-out
stretches; `cells` with one Gaussian at the mode, sigma fitted to the same half; and a kernel density over the ranges
that the five nearest training scans measured in this direction, its bandwidth fitted too. All are scored on the other half.

A log whose readings are multiples of a step has lumps in its distribution function. `--dither` adds a uniform number
within half a step to its held-out readings, which shows how much of a difference is due to them.

Errors of one stretch are alike, so five stretches know a frequency to 2 to 8 points only; its standard error is that
between stretches. `--placements` holds out other stretches in turn, each with a graph of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.spatial import cKDTree

from benchmarks.arguments import parser_of
from benchmarks.occupancy_grid import Grid, held_placements, tuned
from logs import Run, pair, read
from logs.motion import ray_poses
from logs.transforms import compose, wrap
from planners.types import Bools, Floats, Ints
from sensorgraph.building.build import build
from sensorgraph.building.split import N_STRETCHES
from sensorgraph.models.base import OFF_DISTANCE
from sensorgraph.models.cells.key_frames import is_key_frame
from sensorgraph.show.figures.style import new_figure, save_figure

LEVELS = (0.5, 0.9, 0.99)
MAX_RANGE = 10.0
"""[m] Longest scored return, the reach of cells and grid."""
UNIFORM = 1.0 / MAX_RANGE
"""[1/m] Density of an arbitrary reading."""
MIN_RAYS = 100
"""Smallest number of rays of a tenth of the stated chances that is told."""
N_NEAREST = 5
"""Number of training scans of the kernel density."""


@dataclass(frozen=True, kw_only=True)
class Scored:
    """What one log says of the distribution of the graph, ray by ray; (n,) each."""

    name: str
    pit: Floats
    """Distribution function at the measured ranges."""
    stated: Floats
    """Chance of being off by more than 5 cm."""
    off: Floats
    """1 where it was."""
    stretch: Ints
    """Index of the held-out stretch."""
    scores: dict[str, Floats]
    """Log densities [ln 1/m] of each model, of the rays that are not fitted."""

    @property
    def coverage(self) -> list[float]:
        """Shares within the intervals of LEVELS."""
        return [float((np.abs(self.pit - 0.5) <= 0.5 * level).mean()) for level in LEVELS]

    @property
    def stretches(self) -> Floats:
        """Share within the first of these intervals in each held-out stretch."""
        inside = np.abs(self.pit - 0.5) <= 0.5 * LEVELS[0]
        return np.array([inside[self.stretch == k].mean() for k in np.unique(self.stretch)])

    @property
    def chances(self) -> Floats:
        """(n_bins, 4) Stated chance, frequency, its standard error between stretches, and number of rays, in each tenth."""
        bins = np.clip((self.stated * 10).astype(int), 0, 9)
        rows = []
        for k in range(10):
            own = bins == k
            if (n := int(own.sum())) < MIN_RAYS:
                continue
            stated, seen = self.stated[own].mean(), self.off[own].mean()
            excess = np.bincount(self.stretch[own], (self.off - self.stated)[own] - (seen - stated))
            rows.append([stated, seen, np.sqrt((excess**2).sum()) / n, n])
        return np.array(rows)


def gaussian(error: Floats, sigma: float) -> Floats:
    """Return the normal density [1/m]."""
    return np.asarray(np.exp(-0.5 * (error / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi)))


def beam_model(z: Floats, expected: Floats, fit: Bools) -> Floats:
    """Return the density (n,) of the beam model, fitted to some rays by EM (Thrun et al., table 6.2)."""
    weights, sigma, rate = np.array([0.7, 0.15, 0.15]), 0.05, 1.0

    def parts() -> Floats:
        short = np.where(
            z < expected, rate * np.exp(-rate * z) / np.maximum(-np.expm1(-rate * expected), 1e-9), 0.0
        )
        return np.column_stack([gaussian(z - expected, sigma), short, np.full(len(z), UNIFORM)]) * weights

    for _ in range(200):
        shares = parts()[fit]
        shares /= shares.sum(axis=1, keepdims=True)
        weights = shares.mean(axis=0)
        sigma = max(
            float(np.sqrt((shares[:, 0] * (z - expected)[fit] ** 2).sum() / shares[:, 0].sum())), 1e-3
        )
        rate = float(shares[:, 1].sum() / max((shares[:, 1] * z[fit]).sum(), 1e-9))
    return np.asarray(parts().sum(axis=1))


def best_width(density: object, fit: Bools) -> float:
    """Return the width [m] that maximises the mean log density of some rays."""
    found = minimize_scalar(
        lambda s: -float(np.log(density(np.exp(s))[fit]).mean()),  # type: ignore[operator]
        bounds=(np.log(0.005), np.log(1.0)),
        method="bounded",
    )
    return float(np.exp(found.x))


def nearest_ranges(poses: Floats, train: Floats, ranges: Floats, bearings: Floats) -> Floats:
    """Return what the nearest training scans measured in the direction of each ray: (n, n_rays, N_NEAREST) [m]."""
    tree = cKDTree(np.column_stack([train[:, :2], np.cos(train[:, 2]), np.sin(train[:, 2])]))
    _, near = tree.query(
        np.column_stack([poses[:, :2], np.cos(poses[:, 2]), np.sin(poses[:, 2])]), k=N_NEAREST
    )
    turn = wrap(poses[:, None, 2] - train[near, 2])  # (n, N_NEAREST)
    wanted = wrap(turn[..., None] + bearings)
    ray = np.clip(np.searchsorted(bearings, wanted), 0, len(bearings) - 1)
    found = np.take_along_axis(ranges[near], ray, axis=2)
    return np.asarray(np.moveaxis(found, 1, 2))


def score(run: Run, held: Bools, most: int, dither: float) -> Scored:
    """Score a graph of the other scans of a run on those held out.

    At most `most` of these are used, dithered by the step `dither` [m].
    """
    pairing = pair(run)
    graph = build([run.take_scans(~held)], model="cells")
    train = np.flatnonzero(pairing.paired & ~held)
    train = train[is_key_frame(pairing.poses[train], np.zeros(len(train), dtype=np.intp))]
    test = np.flatnonzero(pairing.paired & held)
    test = test[:: max(1, len(test) // most)]
    poses, ranges = pairing.poses[test], run.ranges[test]
    ranges = ranges + dither * np.random.default_rng(0).uniform(-0.5, 0.5, ranges.shape)
    each = ray_poses(run, pairing, test)  # the other models take the pose at the stamp
    found = graph.predict(each)
    use = found.answered & (ranges > 0.1) & (ranges < MAX_RANGE) & np.isfinite(found.mode)
    z = ranges[use]
    half = np.broadcast_to(((np.arange(len(test)) * 10 // len(test)) % 2 == 0)[:, None], use.shape)[use]
    own = graph.log_likelihood(ranges, each, correlated=False, per_ray=True)[use]
    to_laser = (lambda p: p) if run.pose_frame == "laser" else (lambda p: compose(p, run.sensor.mount))
    grid_args = to_laser(pairing.poses[train]), run.ranges[train], run.sensor.bearings
    threshold = tuned(Grid, *grid_args)["grid, least MAE"]
    expected, _ = Grid(*grid_args).cast(to_laser(poses), threshold)
    near = nearest_ranges(
        to_laser(poses), to_laser(pairing.poses[train]), run.ranges[train], run.sensor.bearings
    )
    near = np.where(np.isfinite(near), near, 2 * MAX_RANGE)[use]

    def kernel_density(width: float) -> Floats:
        return np.asarray(0.95 * gaussian(z[:, None] - near, width).mean(axis=1) + 0.05 * UNIFORM)

    def one_gaussian(width: float) -> Floats:
        return np.asarray(0.95 * gaussian(z - found.mode[use], width) + 0.05 * UNIFORM)

    densities = {
        "beam model": beam_model(z, expected[use], half),
        "cells, one Gaussian": one_gaussian(best_width(one_gaussian, half)),
        "kernel density": kernel_density(best_width(kernel_density, half)),
    }
    scores = {"graph": own[~half]}
    scores |= {name: np.log(density)[~half] for name, density in densities.items()}
    stretch = np.broadcast_to((N_STRETCHES * test // run.n_scans)[:, None], use.shape)[use]
    return Scored(
        name="", pit=found.cdf(ranges)[use], stated=found.p_off[use], stretch=stretch, scores=scores,
        off=(np.abs(ranges - found.mode) > OFF_DISTANCE)[use].astype(float),
    )  # fmt: skip


def scored(path: Path, most: int, dither: float, placements: int) -> Scored:
    """Score one log with its stretches held out at several places, as `occupancy_grid.py` moves them."""
    run = read(path)
    parts = [score(run, held, most, dither) for held in held_placements(run, placements)]
    pit, stated, off = (
        np.concatenate([getattr(one, name) for one in parts]) for name in ("pit", "stated", "off")
    )
    return Scored(
        name=path.name.split(".")[0], pit=pit, stated=stated, off=off,
        stretch=np.concatenate([k * N_STRETCHES + one.stretch for k, one in enumerate(parts)]),
        scores={name: np.concatenate([one.scores[name] for one in parts]) for name in parts[0].scores},
    )  # fmt: skip


def picture(logs: list[Scored], path: Path) -> None:
    """Draw the histogram of the distribution function, and stated chances against frequencies."""
    figure = new_figure(10.0, 4.2)
    left, right = figure.subplots(1, 2)
    for one in logs:
        heights, edges = np.histogram(one.pit, 20, (0.0, 1.0), density=True)
        left.stairs(heights, edges, label=one.name)
        stated, seen, error, _ = one.chances.T
        right.errorbar(stated, seen, error, fmt="o-", ms=4, lw=1, label=one.name)
    left.axhline(1.0, color="0.6", lw=0.8)
    right.plot([0, 1], [0, 1], color="0.6", lw=0.8)
    left.set(xlabel="distribution function at the measured range", ylabel="density", ylim=(0, None))
    right.set(
        xlabel="stated chance of being off by more than 5 cm", ylabel="frequency", xlim=(0, 1), ylim=(0, 1)
    )
    right.legend()
    save_figure(figure, path)


def main() -> None:
    """Print one row for each log."""
    parser = parser_of(__doc__)
    parser.add_argument("logs", type=Path, nargs="+")
    parser.add_argument("--most", type=int, default=200, help="held-out scans of each log")
    parser.add_argument("--dither", type=float, default=0.0, help="[m] step of the readings of the logs")
    parser.add_argument("--placements", type=int, default=1, help="times that other stretches are held out")
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args()
    done = []
    for log in given.logs:
        done.append(one := scored(log, given.most, given.dither, given.placements))
        shares = " / ".join(f"{100 * share:.1f}" for share in one.coverage)
        print(f"{one.name}: within 50 / 90 / 99 % intervals {shares} % of {len(one.pit):,} returns")
        low, high = 100 * np.quantile(one.stretches, [0.0, 1.0])
        print(f"  within 50 % intervals in each of {len(one.stretches)} stretches: {low:.0f} to {high:.0f} %")
        means = ", ".join(f"{name} {values.mean():.3f}" for name, values in one.scores.items())
        print(f"  mean log score: {means}")
        for stated, seen, error, n in one.chances:
            print(
                f"  off by more than 5 cm: stated {100 * stated:.1f} %, was {100 * seen:.1f} ± {100 * error:.1f} % of {n:,.0f}"
            )
    if given.picture:
        picture(done, given.picture)


if __name__ == "__main__":
    main()
