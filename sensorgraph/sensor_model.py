"""The graph as a sensor model: distribution, likelihood and samples of the readings at any poses.

`Sensorgraph.predict`, `log_likelihood` and `sample` use this module. Poses are (n_poses, 3), or (n_poses, n_rays, 3) with
one pose for each ray, as while a laser sweeps on a moving robot.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from typing import Literal, Protocol

import numpy as np

from logs.run import RangeSensor
from sensorgraph.errors import SensorgraphError
from sensorgraph.models.base import Model, Prediction
from sensorgraph.models.cells.model import CellModel
from sensorgraph.models.distribution import Mixture
from sensorgraph.models.faces.model import Faces
from sensorgraph.models.likelihood import information_share
from sensorgraph.models.place_noise import places_of
from sensorgraph.models.residual_memory import ResidualMemory
from sensorgraph.models.seen_space import seen_space
from sensorgraph.models.unknown_space import N_POSES, N_RAYS, UnknownSpace
from sensorgraph.nearby_likelihood import NearbyLikelihood, tabulated
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.scene import apply_range_limits

logger = logging.getLogger(__name__)
Unanswered = Literal["broad", "skip"]
"""What a ray counts that no training data support: the distribution of unknown space, or nothing."""
POSES_PER_MIXTURE = 16
"""Number of poses whose mixtures are in memory at once."""
POSES_PER_TASK = 64
"""Number of poses whose likelihood one thread computes at a time."""


class Graph(Protocol):
    """What this module needs of a `Sensorgraph`, which describes the attributes."""

    @property
    def model(self) -> Model: ...
    @property
    def sensor(self) -> RangeSensor: ...
    @property
    def memory(self) -> ResidualMemory | None: ...
    @property
    def unknown_space(self) -> UnknownSpace: ...
    def lasers(self, poses: Floats) -> Floats: ...
    def predict(self, poses: Floats, *, rays: Ints) -> Prediction: ...


def each_ray(poses: Floats, rays: Ints) -> Iterator[tuple[Floats, Ints]]:
    """Yield the poses (n_poses, 3) and the index (1,) of each ray, for poses (n_poses, n_rays, 3)."""
    for j in range(len(rays)):
        yield np.ascontiguousarray(poses[:, j]), rays[j : j + 1]


@dataclass(frozen=True, kw_only=True, eq=False)
class GraphRays:
    """Rays of a graph at poses, whose distribution is computed in pieces when it is needed."""

    graph: Graph
    poses: Floats
    """(n_poses, 3) or (n_poses, n_rays, 3) [m, m, rad]"""
    rays: Ints
    """(n_rays,) indices."""

    def _parts(self) -> Iterator[tuple[slice, Mixture]]:
        """Yield slices of the poses with their mixtures."""
        model = self.graph.model
        for first in range(0, len(self.poses), POSES_PER_MIXTURE):
            here = slice(first, first + POSES_PER_MIXTURE)
            poses = self.poses[here]
            if poses.ndim == 2:
                yield here, model.mixture(poses, self.rays)
                continue
            each = [model.mixture(there, own) for there, own in each_ray(poses, self.rays)]
            yield here, Mixture.padded(each, axis=1)

    @property
    def mixture(self) -> Mixture:
        """The mixtures of all rays; large for many poses of a model of cells."""
        return Mixture.padded([part for _, part in self._parts()], axis=0)

    def evaluate(self, function: Callable[[Mixture, Floats], Floats], values: Floats) -> Floats:
        """Return a function of mixtures and values for all rays, (n_poses, n_rays) both."""
        out = np.empty(values.shape)
        for here, part in self._parts():
            out[here] = function(part, values[here])
        return out

    def points(self, ranges: Floats) -> Floats:
        """Return the end points (n_poses, n_rays, 2) [m, map] of ranges (n_poses, n_rays) [m]; nan where not finite."""
        places = places_of(
            self.graph.lasers(self.poses), self.graph.sensor.bearings[self.rays], ranges, np.inf
        )
        return np.where(np.isfinite(ranges)[..., None], places[..., :2], np.nan)


def likelihood_of(
    graph: Graph,
    ranges: Floats,
    poses: Floats,
    rays: Ints,
    *,
    correlated: bool,
    per_ray: bool,
    unanswered: Unanswered,
) -> Floats:
    """Compute `Sensorgraph.log_likelihood`; ranges (n_poses or 1, n_rays) [m], poses as the module describes."""
    found, supported = ray_likelihoods(graph, ranges, poses, rays)
    known = ~np.isnan(np.broadcast_to(ranges, found.shape))
    if unanswered == "broad":
        found = np.where(supported | ~known, found, graph.unknown_space.log_likelihood(ranges, graph.sensor))
        counts = known
    else:
        found = np.where(supported, found, 0.0)
        counts = known & supported
    if len(poses) and not supported.any():
        _check_place(graph, poses)
    found *= _shares(graph, ranges, rays, correlated=correlated)[:, None]
    return found if per_ray else np.where(counts, found, 0.0).sum(axis=1)


def near_of(
    graph: Graph, ranges: Floats, poses: Floats, rays: Ints, *, correlated: bool, unanswered: Unanswered
) -> NearbyLikelihood:
    """Compute `Sensorgraph.near`; ranges (1, n_rays) [m], poses (n_poses, 3)."""
    if poses.ndim == 3:
        raise SensorgraphError(
            "near takes one pose for all rays of a scan, which start at one point; use log_likelihood"
        )
    if graph.sensor.scan_duration > 0:
        warn_of_sweep(graph.sensor.scan_duration)
    known = graph.unknown_space.log_likelihood(ranges, graph.sensor)[0]
    broad = known if unanswered == "broad" else np.zeros(len(rays))
    share = float(_shares(graph, ranges, rays, correlated=correlated)[0])
    mount = graph.lasers(np.zeros((1, 3)))[0]
    return tabulated(graph.model, graph.sensor.bearings, mount, ranges[0], poses, rays, broad, share)


def _shares(graph: Graph, ranges: Floats, rays: Ints, *, correlated: bool) -> Floats:
    """Return the share (len(ranges),) of its information that counts in each scan, 1 without a memory."""
    if correlated and graph.memory is not None:
        return information_share(graph.memory, _ends_in_laser(ranges, graph.sensor, rays))
    if correlated:
        _warn_of_missing_memory()
    return np.ones(len(ranges))


def ray_likelihoods(graph: Graph, ranges: Floats, poses: Floats, rays: Ints) -> tuple[Floats, Bools]:
    """Return the log-likelihood and the support (n_poses, n_rays) of each ray, computed on all processors."""
    model = graph.model
    out, supported = np.empty((len(poses), len(rays))), np.empty((len(poses), len(rays)), dtype=np.bool_)

    def some(first: int) -> None:
        here = slice(first, first + POSES_PER_TASK)
        own = ranges if len(ranges) == 1 else ranges[here]
        if poses.ndim == 2:
            out[here], supported[here] = model.log_likelihood(own, poses[here], rays)
            return
        for j, (there, ray) in enumerate(each_ray(poses[here], rays)):
            found, is_known = model.log_likelihood(own[:, j : j + 1], there, ray)
            out[here, j], supported[here, j] = found[:, 0], is_known[:, 0]

    starts = range(0, len(poses), POSES_PER_TASK)
    if len(starts) > 1:
        list(_threads().map(some, starts))
    else:
        for first in starts:
            some(first)
    return out, supported


def _check_place(graph: Graph, poses: Floats) -> None:
    """Refuse poses that are all outside the space that the training rays crossed.

    Raises
    ------
    SensorgraphError : No pose lies in the map.
    """
    model = graph.model
    if not isinstance(model, Faces | CellModel):
        return
    low, high = seen_space(model).bounds
    xy = graph.lasers(poses)[..., :2]
    if not ((xy >= low) & (xy <= high)).all(axis=-1).any():
        x, y = xy.reshape(-1, 2)[0]
        raise SensorgraphError(
            f"all poses are outside the map, the first at ({x:.2f}, {y:.2f}) m; expected x from {low[0]:.2f} to "
            f"{high[0]:.2f} m and y from {low[1]:.2f} to {high[1]:.2f} m, in the frame map of the graph's log"
        )


@cache
def _warn_of_missing_memory() -> None:
    """Warn once that neighbouring readings count as independent."""
    logger.warning(
        "the graph has no residual memory, so neighbouring readings count as independent and likelihoods are too "
        "narrow; build it with memory=True"
    )


@cache
def warn_of_sweep(duration: float) -> None:
    """Warn once that one pose is given for a scan that takes `duration` [s]."""
    logger.warning(
        "the laser takes %.0f ms for a scan, and one pose is given for all its rays; on a moving robot pass a pose for "
        "each ray, (n_poses, n_rays, 3), such as run.ray_poses(scan)",
        1e3 * duration,
    )


@cache
def _threads() -> ThreadPoolExecutor:
    """Return the threads of the likelihood; the kernels release the lock of the interpreter."""
    n = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )  # not on macOS
    return ThreadPoolExecutor(min(n, 8), thread_name_prefix="likelihood")


os.register_at_fork(after_in_child=_threads.cache_clear)  # a forked process has no thread of its parent


def unknown_space(graph: Graph) -> UnknownSpace:
    """Return the distribution of readings where nothing is known, from predictions all over the known space."""
    model = graph.model
    if not isinstance(model, Faces | CellModel):
        return UnknownSpace(median=graph.sensor.range_max, p_no_return=0.0)
    rng = np.random.default_rng(0)
    poses = seen_space(model).draw(N_POSES, rng)
    rays = np.unique(np.linspace(0, graph.sensor.n_rays - 1, N_RAYS).astype(np.intp))
    where = poses[:, None].repeat(len(rays), axis=1) if graph.sensor.is_composite else poses
    found = graph.predict(where, rays=rays)
    return UnknownSpace.of(found.median[found.answered], found.p_no_return[found.answered], graph.sensor)


def _ends_in_laser(ranges: Floats, sensor: RangeSensor, rays: Ints) -> Floats:
    """Return the measured end points (n, n_rays, 2) [m] in the frame of the laser."""
    bearings = sensor.bearings[rays]
    ends = ranges[..., None] * np.stack([np.cos(bearings), np.sin(bearings)], axis=-1)
    return np.asarray(ends + sensor.origins[rays] if sensor.is_composite else ends)


def draw(graph: Graph, poses: Floats, uniform: Floats, normal: Floats, rays: Ints) -> Floats:
    """Draw one reading of rays (n_rays,) at poses: (n_poses, n_rays) [m], +inf for no return.

    `uniform` and `normal` (n_poses, n_rays) are the random numbers; equal numbers give equal readings.
    """
    model = graph.model
    if not isinstance(model, Faces | CellModel):
        found = graph.predict(poses, rays=rays)
        return np.asarray(np.where(uniform < found.p_no_return, np.inf, found.mode + found.sigma * normal))
    if poses.ndim == 2:
        return model.draw(poses, uniform, normal, rays)
    readings = np.empty(poses.shape[:2])
    for j, (there, ray) in enumerate(each_ray(poses, rays)):
        readings[:, j] = model.draw(there, uniform[:, j : j + 1], normal[:, j : j + 1], ray)[:, 0]
    return readings


def sample_of(graph: Graph, poses: Floats, n: int, seed: int, rays: Ints, *, residual_memory: bool) -> Floats:
    """Compute `Sensorgraph.sample`: (n, n_poses, n_rays) [m]."""
    out = np.empty((n, len(poses), len(rays)))
    memory = graph.memory if residual_memory else None
    places = None
    if memory is not None:
        mode = graph.predict(poses, rays=rays).mode
        sensor = graph.sensor
        places = places_of(graph.lasers(poses), sensor.bearings[rays], mode, sensor.range_max)
    for k in range(n):
        rng = np.random.default_rng([seed, k])
        uniform, normal = rng.random(out.shape[1:]), rng.normal(size=out.shape[1:])
        if memory is not None and places is not None:
            world = int(rng.integers(2**31))
            for i in range(len(poses)):
                uniform[i], normal[i] = memory.numbers(world, 0.0, places[i], uniform[i], normal[i])
        out[k] = apply_range_limits(draw(graph, poses, uniform, normal, rays), graph.sensor)
    return out
