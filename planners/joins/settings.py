"""The tuned numbers of joins: what they mean, and the command that set them.

Unless said otherwise they were set with `python benchmarks/coverage_planners.py --arena --random 10 --first 1` (random
offices for development, each `--drive`): joins that failed, and planning time. OMPL's processes import this file.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class JoinSettings:
    """How joins are asked for, and certified."""

    max_goals: int = 400
    """Goals of one query; the nearest ones."""
    leg_length: float = 4.0
    """[m] A path that OMPL does not find as a whole is searched for in legs of this length
    (`python -m benchmarks.large_floor --side 42 --rooms 30`)."""
    queries_per_process: int = 48
    """Queries of one process; so results do not depend on the count of processors."""
    certify_step: float = 0.004
    """[m] between the poses at which the clearance of a car's drive is measured."""
    gear_change_cost: float = 0.3
    """[m] that a change of gear costs when a word replaces steering chatter."""
    check_step: float = 0.01
    """[m] between the states of a motion that OMPL checks."""
    clearance_slack: float = 0.002
    """[m] OMPL keeps so much more than the clearance where start and goal do. Where they do not, it may keep so much less."""


@dataclass(frozen=True, kw_only=True)
class SamplingStage:
    """One attempt of RRTConnect; stages follow each other until one succeeds."""

    window: float
    """[m] around start and goals, within which states are sampled."""
    max_step: float
    """[m] of the tree's longest edge."""
    iterations: int
    """Iterations until the stage gives up."""


@dataclass(frozen=True, kw_only=True)
class PlanePathSettings:
    """OMPL in the plane, for robots that turn in place."""

    stages: tuple[SamplingStage, ...] = (
        SamplingStage(window=1.0, max_step=0.3, iterations=1_000),
        SamplingStage(window=4.0, max_step=1.0, iterations=2_000),
        SamplingStage(window=np.inf, max_step=2.0, iterations=4_000),
        SamplingStage(window=0.3, max_step=0.05, iterations=8_000),
        SamplingStage(window=1.5, max_step=0.1, iterations=8_000),
    )
    """Most paths are short; the last two stages find gaps that the coarser ones miss."""
    solutions: int = 2
    """Solutions of each query, of which the best is kept."""
    rope_parts: int = 15
    """Parts that a path is cut into to be pulled straight; the time grows with its square."""
    corner_cost: float = 0.5
    """[m] that a corner costs when solutions are compared, since turning takes time."""


@dataclass(frozen=True, kw_only=True)
class CarPathSettings:
    """OMPL in the state spaces of Reeds and Shepp, and of Dubins."""

    stages: tuple[SamplingStage, ...] = (
        SamplingStage(window=2.0, max_step=1.0, iterations=800),
        SamplingStage(window=np.inf, max_step=2.0, iterations=1_500),
        SamplingStage(window=np.inf, max_step=0.5, iterations=3_000),
    )
    solutions: int = 3
    """Solutions of each query, of which the best is kept."""
    direct_goals: int = 16
    """Goals to which the shortest curve is tried before OMPL samples."""
    gear_change_cost: float = 0.6
    """[m] that a change of gear costs when solutions are compared: the car must stop."""
    chatter_cost: float = 10.0
    """[m] that an arc too short to steer costs when solutions are compared."""


JOINS = JoinSettings()
PLANE_PATHS = PlanePathSettings()
CAR_PATHS = CarPathSettings()
