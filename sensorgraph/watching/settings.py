"""Priors of `watch`. Each is a rate, a size or a share with its unit; none is a threshold on a score."""

from __future__ import annotations

from dataclasses import dataclass

from sensorgraph.effects.latency import LATENCY
from sensorgraph.effects.mount_yaw import MOUNT_YAW
from sensorgraph.effects.range_bias import RANGE_BIAS
from sensorgraph.effects.range_scale import RANGE_SCALE
from sensorgraph.effects.wheel_radius import WHEEL_RADIUS
from sensorgraph.effects.wheel_radius_diff import WHEEL_RADIUS_DIFF


@dataclass(frozen=True, kw_only=True)
class ReadingPriors:
    """How a reading relates to the graph."""

    predicted: float = 0.8
    """Prior share of the readings that come from the place as the graph knows it; others come from anything."""
    n_rays: int = 180
    """Number of rays that are compared with the graph."""
    n_pose_rays: int = 60
    """Number of these that weigh poses."""
    n_anywhere: int = 400
    """Number of poses from which the distribution of any reading in the place is computed."""
    independent: float = 0.125
    """Share of independent readings in a scan of a graph without a residual memory; on the intel log, the correlation of
    residuals of 60 rays gives 0.09 to 0.16."""


@dataclass(frozen=True, kw_only=True)
class TrackingPriors:
    """Motion of the robot and of its errors."""

    carried: float = 1.0 / 36_000.0
    """[1/s] Rate at which a robot is carried away or back, or its tracking fails: once in 10 hours."""
    belief: float = 0.01
    """Prior probability that the robot is right where it contradicts the tracking."""
    start: float = 0.9
    """Prior probability that the first believed pose is right."""
    start_deviations: tuple[float, float, float] = (0.25, 0.25, 0.1)
    """[m, m, rad] Standard deviations of the first believed pose, and of any later one."""
    tolerance: tuple[float, float] = (0.3, 0.105)
    """[m, rad] A believed pose that is further away is off."""
    stamp: float = 0.05
    """[s] Standard deviation of the stamps of believed poses."""
    right: float = 4.0
    """[nats] Log-odds that a belief is right, at most: those of one error in a minute."""
    most_of_one: float = 3.0
    """[nats] Evidence of one statement about a belief within the tolerance, at most."""
    place_size: tuple[float, float] = (0.1, 0.05)
    """[m, rad] Sides of the cells that count as different places."""
    odometry_floor: tuple[float, float, float] = (0.005, 0.005, 0.003)
    """[m, m, rad] Standard deviations of a step of the odometry, of any length."""
    odometry_per_metre: tuple[float, float, float] = (0.08, 0.04, 0.06)
    """[m, m, rad] per metre driven."""
    odometry_per_turn: tuple[float, float, float] = (0.02, 0.02, 0.08)
    """[m, m, rad] per radian turned."""
    unknown_speed: tuple[float, float, float] = (0.7, 0.3, 0.8)
    """[m/s, m/s, rad/s] Standard deviations of the motion without odometry."""
    map_floor: tuple[float, float, float] = (0.01, 0.01, 0.003)
    """[m, m, rad] Standard deviations of a pose in the map of the graph."""
    update_distance: float = 0.1
    """[m] Distance between updates; `update_turn` and `update_period` likewise."""
    update_turn: float = 0.05
    """[rad]"""
    update_period: float = 0.5
    """[s]"""
    independent_distance: float = 0.2
    """[m] Distance after which a scan counts as new evidence; a shorter one counts its share."""
    independent_turn: float = 0.2
    """[rad]"""
    independent_period: float = 4.0
    """[s] The same for a robot that stands."""
    max_speed: float = 3.0
    """[m/s] A faster step of the odometry is a jump."""
    answered: float = 0.15
    """Share of answered rays below which the graph does not know the surroundings."""
    alone: float = 5.0
    """[m] Distance driven outside what the graph knows after which the believed pose is as probable as ours."""
    surroundings: float = 5.0
    """[m] Distance after which surroundings that the graph does not know are others."""
    dropped: float = 25.0
    """[nats] A mode that is less probable than the best by more is no longer followed."""
    n_modes: int = 5
    """Number of poses that are followed at once."""
    n_kept: int = 5
    """Number of scans that a search joins."""
    search_time: float = 0.5
    """[s] after which the results of a search of the whole place are used: about the time that it takes."""
    keep_distance: float = 0.3
    """[m] Distance between these; `keep_turn` likewise."""
    keep_turn: float = 0.3
    """[rad]"""
    usual_distance: float = 5.0
    """[m] Distance over which the usual evidence of a scan is averaged."""


@dataclass(frozen=True, kw_only=True)
class PlacePriors:
    """How places change, and how often."""

    cell: float = 0.1
    """[m] Side of a cell."""
    changed: float = 0.01
    """Prior probability that a cell has changed."""
    for_a_while: float = 0.025
    """Share of the time for which a cell is changed for a while: by people, open doors, or where the graph errs from one view."""
    stay: float = 45.0
    """[s] Mean time for which a cell is changed for a while: a person stays, or the robot sees it from one side."""
    least_difference: float = 0.15
    """[m] A reading that ends closer to the outline of the predicted scan does not show a change."""
    pass_gap: float = 10.0
    """[s] Time without a change in sight after which another pass is counted."""
    least_cells: int = 2
    """Number of cells of the smallest change."""
    moved: float = 0.5
    """Share of the things gone that were moved within the place."""
    way: float = 0.5
    """[m] Standard deviation of their ways along x and y; what is carried further is gone at one place and new at another."""
    like: float = 0.5
    """Standard deviation of the logarithm of the ratio of two sizes of one thing, of which one side is seen."""
    unlike: float = 1.0
    """The same for two things."""


@dataclass(frozen=True, kw_only=True)
class FaultPrior:
    """Prior of one fault of laser or wheels."""

    name: str
    parameter: str
    size: float
    """Standard deviation of the size of a fault."""
    tolerance: float
    """Standard deviation of a healthy robot, or of the graph."""


FAULTS_PER_HOUR = 0.01
"""Rate of each fault."""
DISTANCE_FAULTS = (
    FaultPrior(name=WHEEL_RADIUS.name, parameter="scale", size=0.05, tolerance=0.003),
    FaultPrior(name="turn_scale", parameter="scale", size=0.08, tolerance=0.005),
    FaultPrior(name=WHEEL_RADIUS_DIFF.name, parameter="rad_per_m", size=0.05, tolerance=0.003),
    FaultPrior(name=MOUNT_YAW.name, parameter="rad", size=0.05, tolerance=0.003),
    FaultPrior(name="mount_x", parameter="m", size=0.1, tolerance=0.01),
    FaultPrior(name="mount_y", parameter="m", size=0.1, tolerance=0.01),
    FaultPrior(name=LATENCY.name, parameter="s", size=0.1, tolerance=0.02),
)
"""In the order of the states of `odometry_errors`."""
LASER_FAULTS = (
    FaultPrior(name=RANGE_BIAS.name, parameter="m", size=0.05, tolerance=0.005),
    FaultPrior(name=RANGE_SCALE.name, parameter="scale", size=0.03, tolerance=0.003),
)
BELIEF_FAULT = FaultPrior(name="pose_latency", parameter="s", size=0.3, tolerance=TrackingPriors.stamp)
MISSING_FAULT = FaultPrior(name="missing_returns", parameter="share", size=0.1, tolerance=0.01)


@dataclass(frozen=True, kw_only=True)
class RobotPriors:
    """Evidence about laser and wheels."""

    period: float = 60.0
    """[s] of driving after which evidence starts anew; the older of two collections is up to twice as old."""
    sector: float = 0.087
    """[rad] Width of the sectors that may be blocked."""
    sector_window: float = 5.0
    """[s] of driving over which a sector is judged."""
    near: float = 0.35
    """[m] A shorter reading, where the graph predicts a longer one, may be something on the laser."""
    blocked: float = 0.95
    """Probability of such a reading, or of none, in a blocked sector."""
    stray: float = 0.04
    """The same in a sector that is not blocked, beyond what the graph predicts."""


READINGS, TRACKING, PLACE, ROBOT = ReadingPriors(), TrackingPriors(), PlacePriors(), RobotPriors()
