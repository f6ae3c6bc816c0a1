"""Poses that agree best with steps between neighbours and with loop closures, some of which may be false.

GTSAM solves it: Levenberg-Marquardt with Cauchy's function on the closures while the map is made, graduated non-convexity
at the end (Yang, Antonante, Tzoumas and Carlone 2020), which tells the false closures from the true ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np

from sensorgraph.localization.settings import GRAPH, GraphSettings
from sensorgraph.types import Bools, Floats, Ints


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseEdges:
    """What is measured between pairs of poses."""

    first: Ints
    """(n,) index of the pose in whose frame it is measured."""
    second: Ints
    """(n,) index of the pose that is measured."""
    relative: Floats
    """(n, 3) [m, m, rad] the second in the first."""
    information: Floats
    """(n, 3, 3) of x, y, phi in the first's frame."""

    def __len__(self) -> int:
        return len(self.first)

    @staticmethod
    def of(rows: list[tuple[int, int, Floats, Floats]]) -> PoseEdges:
        """Put edges (first, second, relative, information) together."""
        return PoseEdges(
            first=np.array([row[0] for row in rows], dtype=np.intp),
            second=np.array([row[1] for row in rows], dtype=np.intp),
            relative=np.array([row[2] for row in rows]).reshape(-1, 3),
            information=np.array([row[3] for row in rows]).reshape(-1, 3, 3),
        )


class PoseGraph:
    """Steps of the track, to which closures can be added; solved as often as wanted."""

    def __init__(self, poses: Floats, steps: PoseEdges, settings: GraphSettings = GRAPH) -> None:
        """Take poses (n, 3) to start from, and steps that are true whatever the closures say."""
        self.settings = settings
        self.poses = poses.copy()
        self._steps = [_factor(row, None) for row in _rows(steps)]
        self._anchor: Any = gtsam.PriorFactorPose2(
            0, gtsam.Pose2(*poses[0]), gtsam.noiseModel.Isotropic.Sigma(3, 1e-4)
        )

    def solve(self, closures: PoseEdges) -> Floats:
        """Return poses (n, 3) with Cauchy's function on the closures, and remember them."""
        graph = self._graph()
        cauchy = gtsam.noiseModel.mEstimator.Cauchy(self.settings.cauchy)
        for row in _rows(closures):
            graph.add(_factor(row, cauchy))
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setRelativeErrorTol(self.settings.tolerance)
        result = gtsam.LevenbergMarquardtOptimizer(graph, self._values(), parameters).optimize()
        self.poses = self._read(result)
        return self.poses

    def solve_robustly(self, closures: PoseEdges) -> tuple[Floats, Bools]:
        """Return poses (n, 3) and which closures (n_closures,) are true, by graduated non-convexity."""
        if not len(closures):
            return self.solve(closures), np.zeros(0, dtype=np.bool_)
        graph = self._graph()
        n_known = graph.size()
        for row in _rows(closures):
            graph.add(_factor(row, None))
        parameters = gtsam.GncLMParams()
        parameters.setKnownInliers(list(range(n_known)))
        optimizer = gtsam.GncLMOptimizer(graph, self._values(), parameters)
        optimizer.setInlierCostThresholdsAtProbability(self.settings.inlier_probability)
        result = optimizer.optimize()
        self.poses = self._read(result)
        return self.poses, np.asarray(optimizer.getWeights())[n_known:] > 0.5

    def _graph(self) -> Any:
        graph: Any = gtsam.NonlinearFactorGraph()
        graph.add(self._anchor)
        for factor in self._steps:
            graph.add(factor)
        return graph

    def _values(self) -> Any:
        values: Any = gtsam.Values()
        for k, pose in enumerate(self.poses):
            values.insert(k, gtsam.Pose2(*pose))
        return values

    def _read(self, values: Any) -> Floats:
        return np.asarray(gtsam.utilities.extractPose2(values), dtype=np.float64)


def _rows(edges: PoseEdges) -> list[tuple[int, int, Floats, Floats]]:
    return [
        (int(a), int(b), relative, information)
        for a, b, relative, information in zip(
            edges.first, edges.second, edges.relative, edges.information, strict=True
        )
    ]


def _factor(row: tuple[int, int, Floats, Floats], robust: Any) -> Any:
    """Make a factor; gtsam wants the information in the second pose's frame."""
    first, second, relative, information = row
    cos, sin = np.cos(relative[2]), np.sin(relative[2])
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    noise: Any = gtsam.noiseModel.Gaussian.Information(turn.T @ information @ turn)
    if robust is not None:
        noise = gtsam.noiseModel.Robust.Create(robust, noise)
    return gtsam.BetweenFactorPose2(first, second, gtsam.Pose2(*relative), noise)
