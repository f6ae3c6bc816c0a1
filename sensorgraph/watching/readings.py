"""Evidence of readings for a pose: how much more probable they are there than anywhere in the place.

With the graph's density p of a reading z at the pose, the density p_0 of any reading in the place, and the prior share s
of readings that the graph can predict, the evidence of one reading is

    log((s p + (1 - s) p_0) / p_0),

and the probability that the graph predicts it is s p / (s p + (1 - s) p_0). Unseen space stops a ray at the rate p_0 / S_0
(`anywhere`). With the density m of the surfaces that the graph knows, the probability S that none of them is nearer than z, and
the probability A that unseen space lets the ray pass up to z,

    p = A (m + S p_0 / S_0)   where z ends in unseen space,        p = A m   elsewhere.

A ray that stays in unseen space says nothing: p = p_0. From a pose in unseen space, only rays that the graph answers do: it
saw the surfaces nearby from their other sides.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from logs.motion import to_ray_starts
from logs.run import RangeSensor
from logs.transforms import compose, invert
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.models.base import Prediction
from sensorgraph.models.cells.model import CellModel
from sensorgraph.models.faces.model import Faces
from sensorgraph.models.likelihood import MIN_DENSITY, information_share
from sensorgraph.models.seen_space import seen_space
from sensorgraph.sensor_model import ray_likelihoods
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.watching.anywhere import AnyReading, UnseenSpace
from sensorgraph.watching.settings import READINGS, ReadingPriors
from sensorgraph.world.ray_order import bearings_text, ray_order


@dataclass(frozen=True, kw_only=True, eq=False)
class ReadingEvidence:
    """Evidence of the readings of one scan at poses."""

    ratios: Floats
    """(n_poses, n_rays) [nats]; 0 for a broken reading."""
    known: Bools
    """(n_poses, n_rays) whether the graph answers the ray and the reading is not broken."""
    fits: Floats
    """(n_poses, n_rays) probability that the graph predicts the reading."""
    residuals: Floats
    """(n_poses, n_rays) [m] Reading less the predicted one."""
    predicted: float
    """Prior share of readings that the graph can predict."""

    @property
    def answered(self) -> Floats:
        """(n_poses,) Share of the rays that the graph answers."""
        return np.asarray(self.known.mean(axis=1))


class GraphReadings:
    """Compares scans of one sensor with a graph."""

    def __init__(self, graph: Sensorgraph, sensor: RangeSensor, priors: ReadingPriors = READINGS) -> None:
        if not isinstance(graph.model, Faces | CellModel):
            raise SensorgraphError(
                f"the sensorgraph's model is {graph.model.name}, which watch cannot follow; build one with faces or cells"
            )
        order = ray_order(graph.sensor.bearings, sensor.bearings)
        if order is None:
            raise SensorgraphError(
                f"the scans have {bearings_text(sensor.bearings, graph.sensor.bearings)} as the graph has; use a graph that "
                "was built with this laser"
            )
        self.graph, self.sensor, self.priors = graph, sensor, priors
        self.seen = seen_space(graph.model)
        n = sensor.n_rays
        self.rays: Ints = np.unique(np.linspace(0, n - 1, min(n, priors.n_rays)).astype(np.intp))
        """Rays of the sensor that are compared."""
        self.own: Ints = order[self.rays]
        """The same rays in the graph's order."""
        share = max(len(self.rays) // priors.n_pose_rays, 1)
        self.of_pose: Ints = np.arange(share // 2, len(self.rays), share)
        """Positions among `rays` that weigh poses."""
        nearest = (
            np.zeros(3) if graph.pose_frame == "laser" else getattr(graph.model, "mount", graph.sensor.mount)
        )
        self._mount = compose(sensor.mount, invert(nearest))
        self.expected = self._anywhere()
        """[nats] Mean evidence of a reading of the graph itself, at its pose."""

    def graph_poses(self, base: Floats) -> Floats:
        """Return the poses (..., 3) in the frame of the graph for poses (..., 3) of base_link in map."""
        return np.asarray(compose(base, self._mount))

    def sees(self, poses: Floats) -> Bools:
        """Tell at which poses (n, 3) of base_link in map a laser is in space that training rays crossed."""
        lasers = self.graph.lasers(self.graph_poses(poses)[:, None])
        return np.asarray(self.seen.contains(lasers[..., :2]).any(axis=1))

    def evidence(
        self, ranges: Floats, poses: Floats, which: Ints | None = None, *, expected: Prediction | None = None
    ) -> ReadingEvidence:
        """Return the evidence of a scan (n_rays,) [m] at poses (n_poses, 3), for `rays` or some positions among them.

        Parameters
        ----------
        expected : Prediction of these rays at the poses; None: it is computed.
        """
        which = np.arange(len(self.rays)) if which is None else which
        z = ranges[self.rays[which]]
        z = np.where(
            np.isneginf(z) | (z < self.sensor.range_min), np.nan, z
        )  # something on the laser says no pose
        z = np.where(z >= self.sensor.range_max, np.inf, z)
        starts, own = self.graph_poses(poses), self.own[which]
        if self.graph.sensor.is_composite:
            starts = to_ray_starts(starts[:, None], self.graph.sensor, self.graph.pose_frame)[:, own]
        if expected is None:
            expected = self.graph.predict(self.graph_poses(poses), rays=own)
        s, known = self.priors.predicted, expected.answered & ~np.isnan(z)
        ratios = np.logaddexp(math.log(s) + self._log_ratios(z, starts, own, expected), math.log(1 - s))
        ratios = np.where(np.isnan(z), 0.0, ratios)
        fits = 1.0 - (1.0 - s) * np.exp(-ratios)
        with np.errstate(invalid="ignore"):
            residuals = z - expected.ranges
        return ReadingEvidence(ratios=ratios, known=known, fits=fits, residuals=residuals, predicted=s)

    def n_independent(self, ranges: Floats) -> float:
        """Return the number of independent readings of a scan (n_rays,) [m] among those that weigh poses."""
        n, rays = len(self.of_pose), self.rays[self.of_pose]
        if self.graph.memory is None:
            return self.priors.independent * n
        bearings = self.sensor.bearings[rays]
        ends = ranges[rays, None] * np.column_stack([np.cos(bearings), np.sin(bearings)])
        return n * float(information_share(self.graph.memory, ends[None])[0])

    def predict(self, pose: Floats) -> Prediction:
        """Return the prediction of `rays` at one pose (3,)."""
        return self.graph.predict(self.graph_poses(pose[None]), rays=self.own)

    def _log_ratios(self, z: Floats, starts: Floats, own: Ints, expected: Prediction) -> Floats:
        """Return log(p / p_0) (n_poses, n_rays) of readings (n_rays,) [m]."""
        lasers = self.graph.lasers(starts if starts.ndim == 3 else starts[:, None])
        headings = np.asarray(lasers[..., 2] + self.graph.sensor.bearings[own])
        lengths = np.where(np.isposinf(z), self.sensor.range_max, np.nan_to_num(z))
        ends = lasers[..., :2] + lengths[:, None] * np.stack([np.cos(headings), np.sin(headings)], axis=-1)
        passed = self._unseen.log_passed(lasers[..., :2], headings, lengths)
        known = self._log_density(z[None], starts, own, expected) - self.anywhere.log_density(z)
        with np.errstate(invalid="ignore", divide="ignore"):
            nearer = np.nan_to_num(ndtr((z - expected.mean) / expected.sigma))
            unseen = np.log1p((expected.p_no_return - 1.0) * nearer) - self.anywhere.log_survival(z)
        is_unseen = np.isfinite(z) & self._unseen.contains(ends)
        ratios = passed + np.logaddexp(known, np.where(is_unseen, unseen, -np.inf))
        return np.where(expected.answered | ~self._unseen.contains(lasers[..., :2]), ratios, 0.0)

    def _log_density(self, z: Floats, starts: Floats, own: Ints, expected: Prediction) -> Floats:
        """Return the log-density (n_poses, n_rays) of readings (n_poses or 1, n_rays) [m] that this laser may have."""
        found, _ = ray_likelihoods(self.graph, z, starts, own)
        if self.sensor.range_max >= self.graph.sensor.range_max:
            return found
        return np.where(np.isposinf(z), np.log(np.maximum(self._missing(expected), MIN_DENSITY)), found)

    def _missing(self, expected: Prediction) -> Floats:
        """Return the probability (n_poses, n_rays) of no return within the reach of this laser."""
        none = expected.p_no_return
        if self.sensor.range_max >= self.graph.sensor.range_max:
            return none
        return np.asarray(1.0 - (1.0 - none) * expected.cdf(self.sensor.range_max))

    def _anywhere(self) -> float:
        """Compute the distribution of readings over poses anywhere in the place; return the evidence of the graph's own."""
        poses = self.seen.draw(self.priors.n_anywhere, np.random.default_rng(0))
        repeated = max(round(0.5 / self.priors.independent), 1)  # neighbouring rays show little that is new
        rays = self.own[self.of_pose][::repeated]
        found = self.graph.predict(poses, rays=rays)
        top = self.sensor.range_max
        n_none = float(self._missing(found)[found.answered].sum())
        self.anywhere = AnyReading.of(found.ranges[found.answered], n_none, top)
        self._unseen = UnseenSpace.of(self.seen, self.anywhere)
        drawn = self.graph.sample(poses, 1, 0, rays=rays, residual_memory=False)[0]
        drawn = np.where(drawn >= top, np.inf, drawn)
        density = self._log_density(drawn, poses, rays, found)
        s = self.priors.predicted
        ratios = np.logaddexp(math.log(s) + density - self.anywhere.log_density(drawn), math.log(1 - s))
        return float(ratios[found.answered].mean())
