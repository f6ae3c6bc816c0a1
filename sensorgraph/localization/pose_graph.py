"""Pose graph: poses that best fit steps between neighbours and loop closures, some of which may be false.

The estimate minimises, over all poses x_k = (x, y, phi),

    sum_steps |inv(x_a) ∘ x_b - relative|²_I  +  sum_closures rho(|inv(x_a) ∘ x_b - relative|²_I).

I is the information of an edge, and the first pose is fixed. GTSAM solves it. During mapping rho is Cauchy's
function and the solver is Levenberg-Marquardt. At the end graduated non-convexity separates true closures
from false ones (Yang, Antonante, Tzoumas and Carlone 2020).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from sensorgraph.errors import SensorgraphError
from sensorgraph.types import Bools, Floats, Ints

CAUCHY = 1.0
"""Residual [standard deviations] at which Cauchy's weight of a closure is 1/2 during mapping."""
TOLERANCE = 1e-4
"""Relative decrease of the error at which the optimization stops."""
INLIER_PROBABILITY = 0.999
"""Chi-squared probability within which a closure is an inlier."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseEdges:
    """Measured relative poses between pairs of poses."""

    first: Ints
    """(n,) Index of the pose in whose frame the other is measured."""
    second: Ints
    """(n,) Index of the measured pose."""
    relative: Floats
    """(n, 3) [m, m, rad] Second pose in the frame of the first."""
    information: Floats
    """(n, 3, 3) Information of x, y, phi in the frame of the first."""

    def __len__(self) -> int:
        return len(self.first)

    @staticmethod
    def of(rows: list[tuple[int, int, Floats, Floats]]) -> PoseEdges:
        """Build edges from rows (first, second, relative, information)."""
        return PoseEdges(
            first=np.array([row[0] for row in rows], dtype=np.intp),
            second=np.array([row[1] for row in rows], dtype=np.intp),
            relative=np.array([row[2] for row in rows]).reshape(-1, 3),
            information=np.array([row[3] for row in rows]).reshape(-1, 3, 3),
        )


class PoseGraph:
    """Steps of a track with changing loop closures; it can be solved repeatedly."""

    def __init__(self, poses: Floats, steps: PoseEdges, *, is_doubtful: Bools | None = None) -> None:
        """Take initial poses and the steps.

        Parameters
        ----------
        poses : (n, 3) [m, m, rad]
        steps : Edges between neighbours of the track; they count as inliers.
        is_doubtful : (n_steps,) Steps that closures can contradict; None: no step.
        """
        self.poses = poses.copy()
        rows, doubtful = _rows(steps), np.zeros(len(steps), np.bool_) if is_doubtful is None else is_doubtful
        self._steps = [_factor(row, None) for row, bad in zip(rows, doubtful, strict=True) if not bad]
        self._doubtful = [row for row, bad in zip(rows, doubtful, strict=True) if bad]
        self.is_kept = np.ones(len(self._doubtful), dtype=np.bool_)
        """(n_doubtful,) Doubtful steps that `solve_robustly` kept."""
        self._anchor: Any = _gtsam().PriorFactorPose2(
            0, _gtsam().Pose2(*poses[0]), _gtsam().noiseModel.Isotropic.Sigma(3, 1e-4)
        )

    def solve(self, closures: PoseEdges) -> Floats:
        """Return the poses (n, 3) with Cauchy's function on the closures, and keep them as the next start."""
        graph = self._graph()
        cauchy = _gtsam().noiseModel.mEstimator.Cauchy(CAUCHY)
        for row in (*self._doubtful, *_rows(closures)):
            graph.add(_factor(row, cauchy))
        parameters = _gtsam().LevenbergMarquardtParams()
        parameters.setRelativeErrorTol(TOLERANCE)
        result = _gtsam().LevenbergMarquardtOptimizer(graph, self._values(), parameters).optimize()
        self.poses = self._read(result)
        return self.poses

    def solve_robustly(self, closures: PoseEdges) -> tuple[Floats, Bools]:
        """Return the poses (n, 3), and which closures (n_closures,) are inliers of graduated non-convexity."""
        if not len(closures):
            return self.solve(closures), np.zeros(0, dtype=np.bool_)
        graph = self._graph()
        n_known, n_doubtful = graph.size(), len(self._doubtful)
        for row in (*self._doubtful, *_rows(closures)):
            graph.add(_factor(row, None))
        parameters = _gtsam().GncLMParams()
        parameters.setKnownInliers(list(range(n_known)))
        optimizer = _gtsam().GncLMOptimizer(graph, self._values(), parameters)
        optimizer.setInlierCostThresholdsAtProbability(INLIER_PROBABILITY)
        result = optimizer.optimize()
        self.poses = self._read(result)
        is_inlier = np.asarray(optimizer.getWeights())[n_known:] > 0.5
        self.is_kept = is_inlier[:n_doubtful]
        return self.poses, is_inlier[n_doubtful:]

    def _graph(self) -> Any:
        graph: Any = _gtsam().NonlinearFactorGraph()
        graph.add(self._anchor)
        for factor in self._steps:
            graph.add(factor)
        return graph

    def _values(self) -> Any:
        values: Any = _gtsam().Values()
        for k, pose in enumerate(self.poses):
            values.insert(k, _gtsam().Pose2(*pose))
        return values

    def _read(self, values: Any) -> Floats:
        return np.asarray(_gtsam().utilities.extractPose2(values), dtype=np.float64)


@cache
def _gtsam() -> Any:
    """Return the module gtsam (110 MB), which is loaded when the first pose graph is made."""
    try:
        import gtsam
    except ImportError as missing:
        raise SensorgraphError(
            "a pose graph needs the package gtsam, which is not installed; run `pip install gtsam`"
        ) from missing
    return gtsam


def _rows(edges: PoseEdges) -> list[tuple[int, int, Floats, Floats]]:
    return [
        (int(a), int(b), relative, information)
        for a, b, relative, information in zip(
            edges.first, edges.second, edges.relative, edges.information, strict=True
        )
    ]


def _factor(row: tuple[int, int, Floats, Floats], robust: Any) -> Any:
    """Make a factor; GTSAM expects the information in the frame of the second pose."""
    first, second, relative, information = row
    cos, sin = np.cos(relative[2]), np.sin(relative[2])
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    noise: Any = _gtsam().noiseModel.Gaussian.Information(turn.T @ information @ turn)
    if robust is not None:
        noise = _gtsam().noiseModel.Robust.Create(robust, noise)
    return _gtsam().BetweenFactorPose2(first, second, _gtsam().Pose2(*relative), noise)
