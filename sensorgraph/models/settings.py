"""Settings that all models share, with unit, meaning and the experiment that set them.

They are constants of compiled code: `planners.kernel` recompiles after a change of their values.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class MixtureSettings:
    """Settings of the summary of a ray's mixture (`mixture`).

    The window was set by the median error of the mode as printed by `python -m benchmarks.office_graph` and
    `python -m benchmarks.real_logs LOG`; the others bound the numerical error of the summary.
    """

    mode_window: float = 6.0
    """Width of the mode's window, in standard deviations of a candidate: all of one surface, little of the next."""
    clear_share: float = 0.999
    """Share of one candidate above which the median is its range; the error is below 0.003 standard deviations."""
    tail_sigmas: float = 6.0
    """Standard deviations beyond which the tail of a candidate is neglected: 1e-9."""
    bracket_sigmas: float = 8.0
    """Half width of the bracket of the median, in standard deviations of a candidate."""
    max_steps: int = 40
    """Maximum number of Newton steps; five are usual."""
    min_step: float = 1e-8
    """Step at which the iteration ends, in standard deviations."""
    min_weight: float = 1e-12
    """Total weight of the candidates below which a return is not predicted."""


MIXTURE = MixtureSettings()
"""The settings that the modules use."""
