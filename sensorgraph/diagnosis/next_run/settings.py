"""Settings of the next run: every tuned number of `diagnosis/next_run` with its unit and meaning.

They were set on the pairs of effects of `python -m benchmarks.next_run`, and on its two shorter versions,
`--minutes 0.3 --size 0.5` and `--minutes 0.5`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class CandidateSettings:
    """Which motions are considered."""

    n_places: int = 14
    """Places all over the room where motions start."""
    n_shuttles: int = 16
    """Straight ways between two places that are driven there and back."""
    n_sweep_headings: int = 6
    """Headings at each place to either side of which the robot sweeps."""
    sweep_angle: float = float(np.radians(60.0))
    """[rad] of a sweep to either side."""
    min_shuttle: float = 0.6
    """[m] of a shuttle."""
    spare_clearance: float = 0.08
    """[m] beyond the clearance that places keep, where there is that much."""
    cell: float = 0.25
    """[m] of the grid of reachable places."""
    max_spread_places: int = 4000
    """Reachable places from which places far from each other are chosen."""
    n_samples: int = 6
    """Moments at which a motion is looked at; twice as many of a spin."""


@dataclass(frozen=True, kw_only=True)
class DriveSettings:
    """How motions become drives, and with which random drives these are compared."""

    counts: tuple[int, ...] = (1, 2, 4, 7)
    """Motions in a drive: one version each."""
    rounds: tuple[int, ...] = (1, 2)
    """Times that a drive goes through its motions, so that changes with time show: one version each."""
    min_time_share: float = 0.05
    """Share of the longest motion's time, below which a motion is left out."""
    min_time_left: float = 4.0
    """[s] that must be left to go on to another place; half of it for a way back."""
    end_pause: float = 0.2
    """[s] of standing still at the end."""
    n_via_places: int = 24
    """Places over which the way between two motions may lead."""
    corner_cost: float = 0.5
    """[m] of way that a corner costs, since the robot turns on the spot there."""
    max_overtime: float = 1.05
    """Times the duration asked for, that a drive may take."""
    n_random: int = 9
    """Random drives, for comparison."""
    sample_interval: float = 1.0
    """[s] between the moments at which a whole drive is looked at, at most."""
    min_samples: int = 40
    """Moments at which a whole drive is looked at, at least."""


@dataclass(frozen=True, kw_only=True)
class RandomDriveSettings:
    """What one does without a plan: lively driving between random places."""

    pace: tuple[float, float] = (0.4, 1.0)
    """Range of the speeds, over the limits of the robot."""
    p_spin: float = 0.26
    """Chance of a spin before the next place."""
    spin: tuple[float, float] = (0.8, 4.5)
    """[rad] range of a spin."""
    p_pause: float = 0.08
    """Chance of a pause."""
    pause: tuple[float, float] = (0.5, 2.0)
    """[s] range of a pause."""
    n_places: int = 16
    """Places that are drawn, of which the first that can be driven to straight is taken."""


@dataclass(frozen=True, kw_only=True)
class ForecastSettings:
    """How the evidence of a drive is predicted, and how time is allocated among motions."""

    max_rays: int = 46
    """Rays of a scan that are cast; each stands for an equal number of them."""
    max_nats_per_ray: float = 5.0
    """[nats] that a single ray may bring."""
    linear_sigmas: float = 4.0
    """Standard deviations of difference, up to which a ray counts by its linearised residual whatever it met."""
    p_lost: float = 2e-3
    """Chance of a lost or stray ray under any hypothesis."""
    max_p_alternative: float = 2e-3
    """Chance of the other side of an edge in depth, above which a ray does not count."""
    variance_ratio: tuple[float, float] = (0.01, 100.0)
    """Range of the ratio of the variances of two models."""
    half_weight_nats: float = 10.0
    """[nats] of evidence on one question, at which more of it counts half."""
    n_allocation_steps: int = 24
    """Steps of Frank and Wolfe's method."""
    decided_nats: float = 50.0
    """[nats] between an effect and its rival, above which the question is closed."""
    max_questions: int = 3
    """Questions about effects that a run could not show."""


@dataclass(frozen=True, kw_only=True)
class NextRunSettings:
    """All settings of the next run."""

    candidates: CandidateSettings = CandidateSettings()
    drives: DriveSettings = DriveSettings()
    random: RandomDriveSettings = RandomDriveSettings()
    forecast: ForecastSettings = ForecastSettings()


NEXT_RUN = NextRunSettings()
