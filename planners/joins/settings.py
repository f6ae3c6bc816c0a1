"""Tuned parameters of joins, with the command that set each.

Unless stated otherwise they were set with
`python -m benchmarks.coverage_planners --arena --random 10 --first 1` (random offices for development, each
`--drive`), by failed joins and planning time. OMPL's processes import this module.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class JoinSettings:
    """Queries to OMPL, and their certification."""

    max_goals: int = 400
    """Maximum number of goals per query; the nearest ones are used."""
    leg_length: float = 4.0
    """[m] Length of the legs in which a path is searched that OMPL does not find as a whole
    (`python -m benchmarks.coverage_planners --large 42 30`)."""
    queries_per_process: int = 48
    """Number of queries per process; fixed, so that results do not depend on the number of processors."""
    certify_step: float = 0.004
    """[m] between the poses at which the clearance of a car's path is measured."""
    gear_change_cost: float = 0.3
    """[m] Cost of a gear change when a word replaces steering chatter."""
    check_step: float = 0.01
    """[m] between the states of a motion that OMPL checks."""
    clearance_slack: float = 0.002
    """[m] Added to the clearance in OMPL where start and goals allow it. A certified path may be this much below the
    clearance."""


@dataclass(frozen=True, kw_only=True)
class SamplingStage:
    """One attempt of RRTConnect; the stages run in order until one succeeds."""

    window: float
    """[m] around start and goals, within which states are sampled."""
    max_step: float
    """[m] maximum length of the tree's edges."""
    iterations: int
    """Maximum number of iterations."""


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
    """Number of solutions per query; the best is kept."""
    rope_parts: int = 15
    """Number of parts into which a path is cut to be straightened; the time grows with its square."""
    corner_cost: float = 0.5
    """[m] Cost of a corner when solutions are compared, since turning takes time."""


@dataclass(frozen=True, kw_only=True)
class CarPathSettings:
    """OMPL in the state spaces of Reeds and Shepp, and of Dubins."""

    stages: tuple[SamplingStage, ...] = (
        SamplingStage(window=2.0, max_step=1.0, iterations=800),
        SamplingStage(window=np.inf, max_step=2.0, iterations=1_500),
        SamplingStage(window=np.inf, max_step=0.5, iterations=3_000),
    )
    solutions: int = 3
    """Number of solutions per query; the best is kept."""
    direct_goals: int = 16
    """Number of goals to which the shortest curve is tried before OMPL samples."""
    gear_change_cost: float = 0.6
    """[m] Cost of a gear change when solutions are compared: the car must stop."""
    chatter_cost: float = 10.0
    """[m] Cost of an arc too short to steer when solutions are compared."""


JOINS = JoinSettings()
PLANE_PATHS = PlanePathSettings()
CAR_PATHS = CarPathSettings()
