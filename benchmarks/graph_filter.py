"""A graph in a particle filter on a raw log, beside AMCL with Nav2's defaults and with fitted parameters.

    python -m benchmarks.graph_filter ../shared/data/raw-carmen/aces.clf.bz2 --work /tmp/in_map [--picture FILE.png]

The graph is of the first half of the log, the filters run on the second half (`localize_in_map.halves`), with AMCL's
updates, and start at the true pose. Truth is the whole log, located together, in the second half without the rays that the
filter of the graph uses: a truth of the same readings would share their errors. NEES is the median of e' (P + k P_truth)^-1 e,
with the covariance P of the particles, divided by that of chi² with 3 degrees of freedom: 1 if the posterior is as wide as
its errors. The stated covariances P_truth hold errors that the map shares. So the second half is located twice more, each
time from one half of the other rays, and k makes the NEES of the differences 1.

The posterior of one scan is so narrow that few particles of the prior fall into it. So the filter of the graph adds groups
of rays one after the other, each with an exponent that grows from 0 to 1, and draws new particles after each step (annealed
importance sampling, Neal 2001). KLD-sampling (Fox 2003) chooses their number. `graph.near` tabulates the likelihood of each
scan around the particles. The errors of the odometry are fitted to the first half (`Motion`), since AMCL's model allows no
sideways motion in a turn and no systematic errors.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import chi2

import sensorgraph as sg
from benchmarks.arguments import log_of_halves, parser_of
from benchmarks.localize_in_map import Halves, evenly_spaced, halves, located_without, poses_at_scans, said
from benchmarks.locate import aligned
from benchmarks.particle_filter import FittedAmcl, Motion, driven, fitted_amcl, followed
from logs import read
from logs.transforms import compose, invert, wrap
from planners.types import Floats, Ints
from sensorgraph.exporting.amcl import DEFAULTS
from sensorgraph.exporting.amcl_filter import (
    LASER_MODELS,
    START_SPREAD,
    drawn,
    mean_pose,
    updates,
)
from sensorgraph.graph import Sensorgraph
from sensorgraph.models.likelihood import information_share
from sensorgraph.nearby_likelihood import NearbyLikelihood
from sensorgraph.show.figures.style import new_figure, save_figure
from sensorgraph.world.identified_arena import arena_of

N_RAYS = 60
"""Number of rays of a scan that count, as many as AMCL's."""
N_GROUPS, ORDER = 8, (0, 4, 2, 6, 1, 5, 3, 7)
"""Number of groups of rays, and their order."""
ALONE_SPREAD = 0.05, 0.05, 0.02
"""[m, m, rad] Standard deviations of the prior of a scan that is taken alone."""
N_NEIGHBOURS, KERNEL, TURN_SCALE = 8, 0.5, 2.0
"""Number of neighbours of a particle, share of the difference of two that moves it, and metres that one radian counts."""
NEAR = 0.25, 0.25, 0.1
"""[m, m, rad] Standard deviations of particles up to which their likelihoods are tabulated."""
LEAST, MOST, N_ALONE = 200, 1000, 60
"""Smallest and largest number of particles; number of scans that are taken alone."""
BIN, KLD = np.array([0.2, 0.2, np.radians(6.0)]), (0.05, 2.33)
"""[m, m, rad] Sizes of the bins of KLD-sampling; its largest divergence, and quantile of 99 % (Nav2's pf_err and pf_z)."""


@dataclass(frozen=True, kw_only=True)
class Posterior:
    """Mean and covariance of the particles at each update; nan at other scans."""

    poses: Floats
    covariances: Floats
    seconds: float
    """[s] of CPU"""
    counts: Ints
    """(n_updates,) Number of particles."""


def moments(particles: Floats, weights: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the mean pose, the deviations (n, 3) from it and the covariance."""
    mean = mean_pose(particles, weights)
    off = particles - mean
    off[:, 2] = wrap(off[:, 2])
    return mean, off, (weights[:, None] * off).T @ off


def spread_of(particles: Floats) -> Floats:
    """Return the standard deviations (3,) of particles (n, 3)."""
    _, _, covariance = moments(particles, np.full(len(particles), 1.0 / len(particles)))
    return np.asarray(np.sqrt(np.diag(covariance)))


def weights_of(log_weights: Floats) -> Floats:
    """Return weights that sum to 1."""
    weights = np.exp(log_weights - log_weights.max())
    return np.asarray(weights / weights.sum())


def is_effective(log_weights: Floats) -> bool:
    """Return whether at least half of the particles are effective: 1 / sum(w²) >= n / 2 (Kong, Liu and Wong 1994)."""
    return bool((weights_of(log_weights) ** 2).sum() <= 2.0 / len(log_weights))


class ScanLikelihood:
    """Log-likelihood of one scan for particles: tabulated where they are near each other, else cast for each particle."""

    def __init__(self, graph: Sensorgraph, scan: Floats, rays: Ints) -> None:
        self.graph, self.scan, self.rays = graph, scan, rays
        self.near: NearbyLikelihood | None = None
        bearings = graph.sensor.bearings[rays]
        ends = scan[rays, None] * np.column_stack([np.cos(bearings), np.sin(bearings)])
        self.share = 1.0 if graph.memory is None else float(information_share(graph.memory, ends[None])[0])

    def is_near(self, particles: Floats) -> bool:
        """Return whether the particles are near enough to each other for tables."""
        return bool((spread_of(particles) <= NEAR).all())

    def of(self, particles: Floats, some: Ints) -> Floats:
        """Return the log-likelihood (n,) of the rays at positions `some` among all that count."""
        spread = spread_of(particles)
        if not self.is_near(particles):
            found = self.graph.log_likelihood(self.scan, particles, rays=self.rays[some], correlated=False)
            return np.asarray(self.share * found)
        if self.near is None or (self.near.is_coarse and (spread < 0.5 * self.spread).any()):
            self.near, self.spread = self.graph.near(self.scan, particles, rays=self.rays), spread
        return self.near.log_likelihood(particles, some)


def updated(particles: Floats, likelihood: ScanLikelihood, rng: np.random.Generator) -> Floats:
    """Return particles of the posterior, from those of the prior, by annealed importance sampling.

    Groups of rays come one after the other, the first ones far from each other. The exponent of a group grows in steps that
    keep half of the particles effective. New ones are drawn only when fewer would be (Del Moral, Doucet and Jasra 2006): where
    the graph knows nothing, the prior stays as it is. A drawn particle moves by the difference of two of its neighbours,
    which keeps the shape of each of several modes.
    """
    n, scale, log_weights = len(particles), np.array([1.0, 1.0, TURN_SCALE]), np.zeros(len(particles))
    for first in range(N_GROUPS):
        if first == N_GROUPS // 2 and not likelihood.is_near(particles):
            break  # the other half of the rays would say as little, and casts for each particle take long
        some, done = np.arange(ORDER[first], len(likelihood.rays), N_GROUPS), 0.0
        while done < 1.0:
            found = likelihood.of(particles, some)
            low, step = 0.0, 1.0 - done
            while step - low > 1e-2 * step and not is_effective(log_weights + step * found):
                middle = 0.5 * (low + step)
                low, step = (middle, step) if is_effective(log_weights + middle * found) else (low, middle)
            done += step
            log_weights += step * found
            if done >= 1.0 and is_effective(log_weights):
                continue
            at = drawn(weights_of(log_weights), rng)
            _, neighbours = cKDTree(particles * scale).query(particles * scale, k=N_NEIGHBOURS + 1)
            two = neighbours[at][np.arange(n), rng.integers(1, N_NEIGHBOURS + 1, (2, n))]
            difference = particles[two[0]] - particles[two[1]]
            difference[:, 2] = wrap(difference[:, 2])
            particles = particles[at] + KERNEL * difference
            if n > LEAST:  # fewer suffice for a narrower posterior
                n = min(n, number_of(particles))
                particles = rng.permutation(particles)[:n]
            log_weights = np.zeros(n)
    return particles[drawn(weights_of(log_weights), rng)]


def number_of(particles: Floats) -> int:
    """Return how many particles represent the places of these (n, 3), by KLD-sampling (Fox 2003)."""
    bins = len(np.unique(np.floor(particles / BIN), axis=0)) - 1
    if bins < 1:
        return LEAST
    part = 2.0 / (9.0 * bins)
    wanted = bins / (2.0 * KLD[0]) * (1.0 - part + np.sqrt(part) * KLD[1]) ** 3
    return max(int(wanted), LEAST)


def filtered(
    graph: Sensorgraph, motion: Motion, data: Halves, particles: Floats, first: int, n_updates: int | None,
    rng: np.random.Generator,
) -> Posterior:  # fmt: skip
    """Follow the second half from the particles at scan `first`; `n_updates` None: to its end."""
    odometry = driven(data.second)
    rays = evenly_spaced(data.second.sensor.n_rays, N_RAYS)
    poses, covariances = np.full_like(data.truth, np.nan), np.full((len(data.truth), 3, 3), np.nan)
    last, counts, began = first, [], time.process_time()
    for k in [0, *updates(odometry[first:])][:n_updates]:
        scan = first + k
        if scan != last:
            particles = particles[rng.integers(len(particles), size=max(MOST, len(particles)))]
            particles = motion.moved(particles, compose(invert(odometry[last]), odometry[scan]), rng)
            particles = particles[: number_of(particles)]
        particles = updated(particles, ScanLikelihood(graph, data.second.ranges[scan], rays), rng)
        n, last = len(particles), scan
        poses[scan], _, covariances[scan] = moments(particles, np.full(n, 1.0 / n))
        counts.append(n)
    seconds = time.process_time() - began
    return Posterior(poses=poses, covariances=covariances, seconds=seconds, counts=np.array(counts))


def graph_with_memory(data: Halves, log: Path, work: Path) -> Sensorgraph:
    """Return a graph of the first half that knows how readings are correlated; it is kept in `work`."""
    path = work / f"{log.name}.without_{N_RAYS}.first_memory.sensorgraph"
    if not path.exists():
        sg.build(data.first, calibrate=False, memory=True).save(path)
    return Sensorgraph.load(path)


def alone(
    graph: Sensorgraph, data: Halves, rays: Ints, rng: np.random.Generator
) -> tuple[Floats, Floats, Ints]:
    """Return errors (n, 3) and covariances (n, 3, 3) of one scan alone, with a wide prior about the truth, and the scans."""
    usable = np.flatnonzero(data.covered & np.isfinite(data.truth[:, 0]))
    chosen = usable[evenly_spaced(len(usable), N_ALONE)]
    errors, covariances = [], []
    for k in chosen:
        prior = data.truth[k] + rng.normal(size=(MOST, 3)) * ALONE_SPREAD
        found = updated(prior, ScanLikelihood(graph, data.second.ranges[k], rays), rng)
        mean, _, covariance = moments(found, np.full(len(found), 1.0 / len(found)))
        errors.append(mean - data.truth[k])
        covariances.append(covariance)
    off = np.array(errors)
    off[:, 2] = wrap(off[:, 2])
    return off, np.array(covariances), chosen


def nees(errors: Floats, covariances: Floats) -> float:
    """Return the median of the normalised estimation error squared, 1 if the covariances are right."""
    squares = np.einsum("ni,ni->n", errors, np.linalg.solve(covariances, errors[..., None])[..., 0])
    return float(np.median(squares) / chi2.median(3))


def share_of_truth(log: Path, work: Path) -> float:
    """Return the share of its stated variances that the truth has relative to the map, from two truths of different rays."""
    raw = read(log)
    n, second = raw.sensor.n_rays, slice(raw.n_scans // 2, None)
    used = evenly_spaced(n, N_RAYS)
    others = np.setdiff1d(np.arange(n), used)
    poses, covariances = [], []
    for k in range(2):
        hidden = np.union1d(used, others[k::2])
        run = located_without(raw, second, hidden, work / f"{log.name}.truth_{k}.mcap")
        own, stated = poses_at_scans(run)
        poses.append(own[second])
        covariances.append(stated[second])
    known = np.isfinite(poses[0][:, 0]) & np.isfinite(poses[1][:, 0])
    errors, _ = aligned(poses[0][known], poses[1][known])
    return nees(errors, (covariances[0] + covariances[1])[known])


def picture(found: Posterior, data: Halves, truth_share: float, graph: Sensorgraph, path: Path) -> None:
    """Draw the way of the filter in the map, and its errors beside what it states."""
    use = np.flatnonzero(np.isfinite(found.poses[:, 0]) & np.isfinite(data.truth[:, 0]) & data.covered)
    figure = new_figure(10.0, 4.4)
    left, right = figure.subplots(1, 2)
    arena = arena_of(graph)
    for wall in arena.walls:
        left.plot(*np.asarray(wall).T, color="0.6", lw=0.6)
    way = np.where(
        data.covered[:, None], data.truth[:, :2], np.nan
    )  # gaps: where the first half has not been
    left.plot(*way.T, color="0.2", lw=0.8, label="located with all scans")
    left.plot(*found.poses[use, :2].T, ".", ms=3, label="filter")
    left.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    left.legend()
    error = 100 * np.linalg.norm((found.poses - data.truth)[use, :2], axis=1)
    both = (found.covariances + truth_share * data.truth_covariances)[use]
    stated = 100 * np.sqrt(both[:, 0, 0] + both[:, 1, 1])
    right.plot(error, ".", ms=4, label="error")
    right.plot(stated, color="0.3", lw=0.8, label="stated standard deviation")
    right.set(xlabel="update", ylabel="position [cm]", ylim=(0, None))
    right.legend()
    save_figure(figure, path)


def print_amcl(
    data: Halves, fitted: FittedAmcl, seeds: int, n_updates: int | None, *, in_parts: bool
) -> None:
    """Print the rows of AMCL, in parts also those with the model or the numbers of the fit alone."""
    numbers, model = fitted.numbers, fitted.laser_model
    rows = [("Nav2's defaults", DEFAULTS, LASER_MODELS[0]), ("fitted", numbers, model)]
    if in_parts:
        rows += [
            ("Nav2's defaults, the product", DEFAULTS, LASER_MODELS[1]),
            ("fitted numbers", numbers, LASER_MODELS[0]),
        ]
        print("\n".join(fitted.lines))
    for label, parameters, laser_model in rows:
        for seed in range(seeds):
            began = time.process_time()
            poses = followed(
                data.second, data.truth, fitted.field, parameters, np.random.default_rng(seed), laser_model
            )
            scans = np.flatnonzero(np.isfinite(poses[:, 0]))
            done = scans[:n_updates][data.covered[scans[:n_updates]]]
            rate = len(scans) / (time.process_time() - began)
            print(
                f"AMCL, {label}, 2000 particles, seed {seed}: {said(poses[done], data.truth[done])}; {rate:.1f} updates/s"
            )


def main() -> None:
    """Print the errors of each filter."""
    parser = parser_of(__doc__)
    log_of_halves(parser)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--updates", type=int, help="only the first updates")
    parser.add_argument("--picture", type=Path)
    parser.add_argument(
        "--amcl", action="store_true", help="AMCL alone, with the whole truth, and parts of its fit"
    )
    given = parser.parse_args()
    data = halves(given.log, given.work, hidden=0 if given.amcl else N_RAYS)
    fitted = fitted_amcl(data.first, data.graph)
    print_amcl(data, fitted, given.seeds, given.updates, in_parts=given.amcl)
    if given.amcl:
        return
    graph = graph_with_memory(data, given.log, given.work)
    print(f"graph: {graph.memory.summary() if graph.memory else 'no memory'}")
    motion, truth_share = Motion.fit(data.first), share_of_truth(given.log, given.work)
    print(f"truth: {100 * truth_share:.0f} % of its stated variances are relative to the map")
    rays = evenly_spaced(graph.sensor.n_rays, N_RAYS)
    errors, covariances, chosen_scans = alone(graph, data, rays, np.random.default_rng(0))
    width = nees(errors, covariances + truth_share * data.truth_covariances[chosen_scans])
    print(f"one scan alone: NEES {width:.2f} of {len(errors)} scans")
    first = int(np.flatnonzero(np.isfinite(data.truth[:, 0]))[0])
    for seed in range(given.seeds):
        rng = np.random.default_rng(seed)
        start = data.truth[first] + rng.normal(size=(MOST, 3)) * START_SPREAD
        found = filtered(graph, motion, data, start, first, given.updates, rng)
        done = np.isfinite(found.poses[:, 0]) & np.isfinite(data.truth[:, 0]) & data.covered
        errors = found.poses[done] - data.truth[done]
        errors[:, 2] = wrap(errors[:, 2])
        width = nees(errors, found.covariances[done] + truth_share * data.truth_covariances[done])
        print(
            f"graph, {found.counts.mean():.0f} particles (median {np.median(found.counts):.0f}), seed {seed}: "
            f"{said(found.poses[done], data.truth[done])}; NEES {width:.2f}; "
            f"{len(found.counts) / found.seconds:.1f} updates/s"
        )
    if given.picture:
        picture(found, data, truth_share, graph, given.picture)


if __name__ == "__main__":
    main()
