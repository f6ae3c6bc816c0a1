"""Settings of the next run: every tuned number of `diagnosis/next_run`, with its unit and meaning.

They were set on the pairs of effects of `python -m benchmarks.next_run`, and on its two shorter versions,
`--minutes 0.3 --size 0.5` and `--minutes 0.5`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class CandidateSettings:
    """Candidate motions."""

    n_places: int = 14
    """Number of places in the whole room at which motions start, or through which the paths between them lead."""
    n_sweep_headings: int = 6
    """Number of headings at each place for sweeps."""
    sweep_angle: float = float(np.radians(60.0))
    """[rad] of a sweep to either side."""
    spare_clearance: float = 0.08
    """[m] additional clearance of places, where available."""
    cell: float = 0.25
    """[m] cell size of the grid of reachable places."""
    max_spread_places: int = 4000
    """Maximum number of reachable places among which distant ones are chosen."""
    n_samples: int = 6
    """Number of sample moments of a motion; twice as many for a spin."""


@dataclass(frozen=True, kw_only=True)
class DriveSettings:
    """Composition of drives from motions, and random drives for comparison."""

    counts: tuple[int, ...] = (1, 4)
    """Numbers of motions in a drive, one version each."""
    rounds: tuple[int, ...] = (1, 2)
    """Numbers of passes through the motions, so that changes over time are observable; one version each."""
    end_pause: float = 0.2
    """[s] standstill at the end."""
    max_overtime: float = 1.05
    """Maximum duration of a drive, as a multiple of the requested one."""
    n_random: int = 9
    """Number of random drives for comparison."""
    sample_interval: float = 1.0
    """[s] maximum interval between the sample moments of a whole drive."""
    min_samples: int = 40
    """Minimum number of sample moments of a whole drive."""


@dataclass(frozen=True, kw_only=True)
class RandomDriveSettings:
    """Driving without a plan: frequent turns and moves between random places."""

    pace: tuple[float, float] = (0.4, 1.0)
    """Range of the speeds, as shares of the robot's limits."""
    p_spin: float = 0.26
    """Probability of a spin before the next place."""
    spin: tuple[float, float] = (0.8, 4.5)
    """[rad] range of a spin."""
    n_places: int = 16
    """Number of places that are drawn; the first with a free straight path is taken."""


@dataclass(frozen=True, kw_only=True)
class ForecastSettings:
    """Prediction of the evidence of a drive, and allocation of time among motions."""

    max_rays: int = 46
    """Maximum number of rays of a scan that are cast; each represents an equal number of rays."""
    max_nats_per_ray: float = 5.0
    """[nats] maximum evidence of a single ray."""
    linear_sigmas: float = 4.0
    """Difference in standard deviations, up to which a ray counts by its linearised residual on any wall."""
    p_lost: float = 2e-3
    """Probability of a missing return or an outlier under any hypothesis."""
    max_p_alternative: float = 2e-3
    """Probability of reading the other side of a depth edge, above which a ray does not count."""
    n_allocation_steps: int = 24
    """Number of steps of the Frank-Wolfe method."""
    decided_nats: float = 50.0
    """[nats] lead of an effect over its rival, above which the question is closed."""
    max_questions: int = 3
    """Maximum number of questions about effects that a run could not show."""


@dataclass(frozen=True, kw_only=True)
class NextRunSettings:
    """All settings of the next run."""

    candidates: CandidateSettings = CandidateSettings()
    drives: DriveSettings = DriveSettings()
    random: RandomDriveSettings = RandomDriveSettings()
    forecast: ForecastSettings = ForecastSettings()


NEXT_RUN = NextRunSettings()
