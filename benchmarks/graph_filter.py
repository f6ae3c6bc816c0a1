"""A graph in a particle filter on a raw log, beside AMCL with Nav2's defaults and with fitted parameters.

    python -m benchmarks.graph_filter ../shared/data/raw-carmen/aces.clf.bz2 --work /tmp/in_map [--picture FILE.png]

The graph is of the first half of the log, the filters run on the second half (`localize_in_map.halves`), with AMCL's
updates, and are told where to start. Truth is the whole log, located together. NEES is the median of e' (P + P_truth)^-1 e,
with the covariance P of the particles, divided by that of chi² with 3 degrees of freedom: 1 if the posterior is as wide as
its errors.

The posterior of one scan is so narrow that few of 200 particles fall into it. So the filter of the graph
raises the exponent of the likelihood from 0 to 1 in steps that keep half of the particles effective (annealed importance
sampling, Neal 2001). It draws new particles after each step, with the kernel of Liu and West (2001), which keeps mean and
covariance. Its motion noise is fitted to the first half (`MotionNoise`), since AMCL's allows no sideways motion in a turn.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

import sensorgraph as sg
from benchmarks.localize_in_map import Halves, halves, said
from benchmarks.particle_filter import driven, followed
from logs import pair
from logs.run import Run
from logs.transforms import compose, invert, wrap
from sensorgraph.exporting.amcl import DEFAULTS, compare_laser_models, estimate_amcl
from sensorgraph.exporting.amcl_filter import (
    LASER_MODELS,
    START_SPREAD,
    CellDistances,
    drawn,
    mean_pose,
    updates,
)
from sensorgraph.exporting.nav2 import chosen, map_of
from sensorgraph.graph import Sensorgraph
from sensorgraph.show.figures.style import new_figure, save_figure
from sensorgraph.world.identified_arena import arena_of

Floats = NDArray[np.float64]
Likelihood = Callable[[int, Floats], Floats]
"""Log-likelihood (n,) of a scan, given by index, for particles (n, 3)."""
N_RAYS = 60
"""Number of rays of a scan that count, as many as AMCL's."""
KERNEL = 0.3
"""Width of the kernel of new particles, in standard deviations of the particles."""
FREEDOM = 4
"""Degrees of freedom of Student's distribution of the motion noise."""
N_GLOBAL, N_AFTER, N_STARTS = 4000, 400, 5
"""Number of particles of a global start, of its later updates, and of starts."""
CONVERGED = 0.5
"""[m] Largest error of a filter that has converged."""


@dataclass(frozen=True, kw_only=True)
class MotionNoise:
    """Noise of the odometry between two updates, in the frame of the robot."""

    coefficients: Floats
    """(3, 3) Variance of x, y and phi = coefficients · (1e-4, distance² [m²], turn² [rad²])."""

    @classmethod
    def fit(cls, run: Run) -> MotionNoise:
        """Fit the variances to the steps of a located run by weighted least squares; the largest 2 % are cut."""
        odometry, poses = driven(run), pair(run).poses
        first = int(np.flatnonzero(np.isfinite(poses[:, 0]))[0])
        at = np.array([first + k for k in updates(odometry[first:])])
        steps = compose(invert(odometry[at[:-1]]), odometry[at[1:]])
        errors = compose(invert(steps), compose(invert(poses[at[:-1]]), poses[at[1:]]))
        known = np.isfinite(errors).all(axis=1)
        rows, squares = cls.features(steps[known]), errors[known] ** 2
        found = []
        for y in np.minimum(squares, np.quantile(squares, 0.98, axis=0)).T:
            variance = np.full(len(y), y.mean())
            for _ in range(10):
                solution = nnls(rows / variance[:, None], y / variance)[0]
                variance = rows @ solution + 1e-8
            found.append(solution)
        return cls(coefficients=np.array(found))

    @staticmethod
    def features(steps: Floats) -> Floats:
        """Return the features (n, 3) of steps (n, 3)."""
        return np.column_stack([np.full(len(steps), 1e-4), (steps[:, :2] ** 2).sum(axis=1), steps[:, 2] ** 2])

    def moved(self, particles: Floats, step: Floats, rng: np.random.Generator) -> Floats:
        """Return particles (n, 3) after a step (3,) of the odometry."""
        sigma = np.sqrt(self.coefficients @ self.features(step[None])[0])
        noise = rng.standard_t(FREEDOM, size=particles.shape) * np.sqrt((FREEDOM - 2) / FREEDOM)
        return np.asarray(compose(particles, compose(step, noise * sigma)))


@dataclass(frozen=True, kw_only=True)
class Posterior:
    """Mean and covariance of the particles at each update; nan at other scans."""

    poses: Floats
    covariances: Floats
    seconds: float
    """[s] of CPU"""
    n_updates: int


def moments(particles: Floats, weights: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the mean pose, the deviations (n, 3) from it and the covariance."""
    mean = mean_pose(particles, weights)
    off = particles - mean
    off[:, 2] = wrap(off[:, 2])
    return mean, off, (weights[:, None] * off).T @ off


def tempered(log_likelihood: Floats, exponent: float) -> Floats:
    """Return weights that sum to 1."""
    weights = np.exp(exponent * (log_likelihood - log_likelihood.max()))
    return np.asarray(weights / weights.sum())


def updated(
    particles: Floats, likelihood: Callable[[Floats], Floats], rng: np.random.Generator, *, is_local: bool = True
) -> Floats:  # fmt: skip
    """Return particles of the posterior, from those of the prior, by annealed importance sampling.

    `is_local` False: the kernel keeps each particle near its own place, for priors with several modes.
    """
    n, done = len(particles), 0.0
    while done < 1.0:
        found = likelihood(particles)
        low, step = 0.0, 1.0 - done
        while step - low > 1e-3 * step and (tempered(found, step) ** 2).sum() > 2.0 / n:
            middle = 0.5 * (low + step)
            if (tempered(found, middle) ** 2).sum() > 2.0 / n:
                step = middle
            else:
                low = middle
        done += step
        weights = tempered(found, step)
        at = drawn(weights, rng)
        if is_local:
            mean, off, covariance = moments(particles, weights)
            noise = rng.multivariate_normal(np.zeros(3), covariance + 1e-12 * np.eye(3), size=n)
            particles = mean + np.sqrt(1.0 - KERNEL**2) * off[at] + KERNEL * noise
        else:
            particles = particles[at] + (1.0 - done) * rng.normal(size=(n, 3)) * [0.2, 0.2, 0.1]
    return particles


def filtered(
    likelihood: Likelihood, noise: MotionNoise, data: Halves, n: int, rng: np.random.Generator
) -> Posterior:
    """Follow the second half from where it starts."""
    truth, odometry = data.truth, driven(data.second)
    last = first = int(np.flatnonzero(np.isfinite(truth[:, 0]))[0])
    particles = truth[first] + rng.normal(size=(n, 3)) * START_SPREAD
    poses, covariances = np.full_like(truth, np.nan), np.full((len(truth), 3, 3), np.nan)
    began, count = time.process_time(), 0
    for k in updates(odometry[first:]):
        scan = first + k
        particles = noise.moved(particles, compose(invert(odometry[last]), odometry[scan]), rng)
        particles = updated(particles, partial(likelihood, scan), rng)
        poses[scan], _, covariances[scan] = moments(particles, np.full(n, 1.0 / n))
        last, count = scan, count + 1
    return Posterior(
        poses=poses, covariances=covariances, seconds=time.process_time() - began, n_updates=count
    )


def converged(
    likelihood: Likelihood, noise: MotionNoise, data: Halves, rng: np.random.Generator
) -> tuple[float, float]:
    """Return the share of global starts that find the robot within 10 updates, and the mean number of updates."""
    truth, odometry = data.truth, driven(data.second)
    usable = np.flatnonzero(data.covered & np.isfinite(truth[:, 0]))
    low, high = truth[usable, :2].min(axis=0) - 2.0, truth[usable, :2].max(axis=0) + 2.0
    needed = []
    for first in usable[np.linspace(0, 0.9 * len(usable), N_STARTS).astype(int)]:
        particles = np.column_stack(
            [rng.uniform(low, high, (N_GLOBAL, 2)), rng.uniform(-np.pi, np.pi, N_GLOBAL)]
        )
        last, found = first, np.inf
        for count, k in enumerate([0, *list(updates(odometry[first:]))[:9]]):
            scan = first + k
            particles = noise.moved(particles, compose(invert(odometry[last]), odometry[scan]), rng)
            particles = updated(particles, partial(likelihood, scan), rng, is_local=False)
            particles, last = particles[:: max(1, len(particles) // N_AFTER)], scan
            if np.hypot(*(np.median(particles[:, :2], axis=0) - truth[scan, :2])) < CONVERGED:
                found = min(found, count + 1)
            else:
                found = np.inf
        needed.append(found)
    done = np.isfinite(needed)
    return float(done.mean()), float(np.mean(np.array(needed)[done])) if done.any() else np.nan


def nees(found: Posterior, data: Halves) -> float:
    """Return the median of the normalised estimation error squared, 1 if the covariances are right."""
    use = np.isfinite(found.poses[:, 0]) & np.isfinite(data.truth[:, 0]) & data.covered
    error = found.poses[use] - data.truth[use]
    error[:, 2] = wrap(error[:, 2])
    both = found.covariances[use] + data.truth_covariances[use]
    squares = np.einsum("ni,ni->n", error, np.linalg.solve(both, error[..., None])[..., 0])
    return float(np.median(squares) / 2.366)  # the median of chi² with 3 degrees of freedom


def picture(found: Posterior, data: Halves, graph: Sensorgraph, path: Path) -> None:
    """Draw the way of the filter in the map, and its errors beside what it states."""
    use = np.flatnonzero(np.isfinite(found.poses[:, 0]) & np.isfinite(data.truth[:, 0]) & data.covered)
    figure = new_figure(10.0, 4.4)
    left, right = figure.subplots(1, 2)
    arena = arena_of(graph)
    for wall in arena.walls:
        left.plot(*np.asarray(wall).T, color="0.6", lw=0.6)
    way = np.where(
        data.covered[:, None], data.truth[:, :2], np.nan
    )  # the first half has not been in the gaps
    left.plot(*way.T, color="0.2", lw=0.8, label="located with all scans")
    left.plot(*found.poses[use, :2].T, ".", ms=3, label="filter")
    left.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    left.legend()
    error = 100 * np.linalg.norm((found.poses - data.truth)[use, :2], axis=1)
    both = (found.covariances + data.truth_covariances)[use]
    stated = 100 * np.sqrt(both[:, 0, 0] + both[:, 1, 1])
    right.plot(error, ".", ms=4, label="error")
    right.plot(stated, color="0.3", lw=0.8, label="stated standard deviation")
    right.set(xlabel="update", ylabel="position [cm]", ylim=(0, None))
    right.legend()
    save_figure(figure, path)


def print_amcl(
    data: Halves, numbers: Mapping[str, float], field: CellDistances, fitted: str, seeds: int
) -> None:
    """Print the rows of AMCL."""
    for label, parameters, laser_model in (
        ("AMCL, Nav2's defaults, 2000 particles", DEFAULTS, LASER_MODELS[0]),
        ("AMCL, fitted, 2000 particles", numbers, fitted),
    ):
        for seed in range(seeds):
            began = time.process_time()
            poses = followed(
                data.second, data.truth, field, parameters, np.random.default_rng(seed), laser_model
            )
            done = np.isfinite(poses[:, 0]) & data.covered
            rate = np.isfinite(poses[:, 0]).sum() / (time.process_time() - began)
            print(
                f"{label}, seed {seed}: {said(poses[done], data.truth[done])}; {rate:.1f} updates/s",
                flush=True,
            )


def main() -> None:
    """Print the errors of each filter."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log", type=Path)
    parser.add_argument("--work", type=Path, default=Path("runs/in_map"))
    parser.add_argument("--particles", type=int, nargs="+", default=[200])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--global-start", action="store_true", help="also starts without a pose")
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args()
    data = halves(given.log, given.work)
    arena = arena_of(sg.Sensorgraph.load(given.work / f"{given.log.name}.first.sensorgraph"))
    grid = map_of(arena)
    numbers = chosen(estimate_amcl(data.first, arena, grid))
    compared = compare_laser_models(data.first, grid, numbers)
    field = CellDistances.of(grid)
    print_amcl(data, numbers, field, compared.name if compared else LASER_MODELS[0], given.seeds)
    path = given.work / f"{given.log.name}.first_memory.sensorgraph"
    if not path.exists():
        sg.build(data.first, calibrate=False, memory=True).save(path)
    graph = sg.Sensorgraph.load(path)
    print(f"graph: {graph.memory.summary() if graph.memory else 'no memory'}")
    noise = MotionNoise.fit(data.first)
    rays = np.unique(np.linspace(0, data.second.sensor.n_rays - 1, N_RAYS).astype(int))

    def likelihood(scan: int, particles: Floats) -> Floats:
        return graph.log_likelihood(data.second.ranges[scan], particles, rays=rays)

    for n in given.particles:
        for seed in range(given.seeds):
            found = filtered(likelihood, noise, data, n, np.random.default_rng(seed))
            done = np.isfinite(found.poses[:, 0]) & data.covered
            print(
                f"graph, {n} particles, seed {seed}: {said(found.poses[done], data.truth[done])}; "
                f"NEES {nees(found, data):.2f}; {found.n_updates / found.seconds:.1f} updates/s",
                flush=True,
            )
    if given.picture:
        picture(found, data, graph, given.picture)
    if given.global_start:
        share, count = converged(likelihood, noise, data, np.random.default_rng(0))
        print(
            f"graph, {N_GLOBAL} particles without a start, then {N_AFTER}: "
            f"{100 * share:.0f} % found, after {count:.1f} updates"
        )


if __name__ == "__main__":
    main()
