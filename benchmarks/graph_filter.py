"""A graph in a particle filter on a raw log, beside AMCL with Nav2's defaults and with fitted parameters.

The graph is of the first half of the log, the filters run on the second half (`localize_in_map.halves`). All have AMCL's
motion model and updates, and are told where to start. Truth is the whole log, located together. NEES is the
median of e' (P + P_truth)^-1 e, with the covariance P of the particles, divided by that of chi² with 3 degrees of freedom:
1 if the posterior is as wide as its errors.

    python -m benchmarks.graph_filter ../shared/data/raw-carmen/aces.clf.bz2 --work /tmp/in_map
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import sensorgraph as sg
from benchmarks.localize_in_map import Halves, halves, said
from benchmarks.particle_filter import followed
from logs.transforms import compose, invert, wrap
from sensorgraph.exporting.amcl import DEFAULTS, compare_laser_models, estimate_amcl
from sensorgraph.exporting.amcl_filter import LASER_MODELS, START_SPREAD, CellDistances, _moved, updates
from sensorgraph.exporting.nav2 import chosen, map_of
from sensorgraph.graph import Sensorgraph
from sensorgraph.localization.odometry import odometry_at_scans, odometry_of
from sensorgraph.world.identified_arena import arena_of

Floats = NDArray[np.float64]
N_RAYS = 60
"""Number of rays of a scan that count, as many as AMCL's."""


@dataclass(frozen=True, kw_only=True)
class Posterior:
    """Mean and covariance of the particles at each update; nan at other scans."""

    poses: Floats
    covariances: Floats
    seconds: float
    n_updates: int


def filtered(
    graph: Sensorgraph, data: Halves, parameters: Mapping[str, float], n: int, rng: np.random.Generator
) -> Posterior:
    """Follow the second half with the likelihood of a graph."""
    run, truth = data.second, data.truth
    motion = odometry_of(run)
    assert motion is not None
    odometry = odometry_at_scans(run, motion)
    first = int(np.flatnonzero(np.isfinite(truth[:, 0]))[0])
    rays = np.unique(np.linspace(0, run.sensor.n_rays - 1, N_RAYS).astype(int))
    particles = truth[first] + rng.normal(size=(n, 3)) * START_SPREAD
    poses, covariances = np.full_like(truth, np.nan), np.full((len(truth), 3, 3), np.nan)
    last, began, count = first, time.perf_counter(), 0
    for k in updates(odometry[first:]):
        step = compose(invert(odometry[last]), odometry[first + k])
        particles, last = _moved(particles, step, parameters, rng), first + k
        spread = np.std(particles[:, 0]) / np.sqrt(n)
        wide = graph.with_pose_errors(max(0.01, spread), max(0.002, np.std(particles[:, 2]) / np.sqrt(n)))
        weights = wide.log_likelihood(run.ranges[last], particles, rays=rays)
        weights = np.exp(weights - weights.max())
        weights /= weights.sum()
        turn = np.arctan2(weights @ np.sin(particles[:, 2]), weights @ np.cos(particles[:, 2]))
        mean = np.array([*(weights @ particles[:, :2]), turn])
        off = particles - mean
        off[:, 2] = wrap(off[:, 2])
        poses[last], covariances[last] = mean, (weights[:, None] * off).T @ off
        at = np.searchsorted(np.cumsum(weights), (np.arange(n) + rng.uniform()) / n)
        particles, count = particles[np.clip(at, 0, n - 1)], count + 1
    return Posterior(
        poses=poses, covariances=covariances, seconds=time.perf_counter() - began, n_updates=count
    )


def nees(found: Posterior, data: Halves) -> float:
    """Return the median of the normalised estimation error squared, 1 if the covariances are right."""
    use = np.isfinite(found.poses[:, 0]) & np.isfinite(data.truth[:, 0]) & data.covered
    error = found.poses[use] - data.truth[use]
    error[:, 2] = wrap(error[:, 2])
    both = found.covariances[use] + data.truth_covariances[use]
    squares = np.einsum("ni,ni->n", error, np.linalg.solve(both, error[..., None])[..., 0])
    return float(np.median(squares) / 2.366)  # the median of chi² with 3 degrees of freedom


def main() -> None:
    """Print the errors of each filter."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log", type=Path)
    parser.add_argument("--work", type=Path, default=Path("runs/in_map"))
    parser.add_argument("--particles", type=int, default=200)
    parser.add_argument("--seeds", type=int, default=2)
    given = parser.parse_args()
    data = halves(given.log, given.work)
    arena = arena_of(sg.Sensorgraph.load(given.work / f"{given.log.name}.first.sensorgraph"))
    grid = map_of(arena)
    numbers = chosen(estimate_amcl(data.first, arena, grid))
    compared = compare_laser_models(data.first, grid, numbers)
    field = CellDistances.of(grid)
    models = [
        ("AMCL, Nav2's defaults, 2000 particles", DEFAULTS, LASER_MODELS[0]),
        ("AMCL, fitted, 2000 particles", numbers, compared.name if compared else LASER_MODELS[0]),
    ]
    for label, parameters, laser_model in models:
        for seed in range(given.seeds):
            began = time.perf_counter()
            poses = followed(
                data.second, data.truth, field, parameters, np.random.default_rng(seed), laser_model
            )
            done = np.isfinite(poses[:, 0]) & data.covered
            rate = np.isfinite(poses[:, 0]).sum() / (time.perf_counter() - began)
            print(
                f"{label}, seed {seed}: {said(poses[done], data.truth[done])}; {rate:.0f} updates/s",
                flush=True,
            )
    path = given.work / f"{given.log.name}.first_memory.sensorgraph"
    if not path.exists():
        sg.build(replace(data.first), calibrate=False, memory=True).save(path)
    graph = sg.Sensorgraph.load(path)
    print(f"graph: {graph.memory.summary() if graph.memory else 'no memory'}")
    for n in (given.particles, 2000):
        for seed in range(given.seeds):
            found = filtered(graph, data, numbers, n, np.random.default_rng(seed))
            done = np.isfinite(found.poses[:, 0]) & data.covered
            print(
                f"graph, {n} particles, seed {seed}: {said(found.poses[done], data.truth[done])}; "
                f"NEES {nees(found, data):.2f}; {found.n_updates / found.seconds:.0f} updates/s",
                flush=True,
            )


if __name__ == "__main__":
    main()
