"""Settings that all models share, with unit, meaning and what set them.

They are constants of compiled code: `planners.kernel` compiles anew after a change of any file that names it, as this one.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class MixtureSettings:
    """How the mixture of what a ray may hit is summarised (`mixture`).

    The window was set by the median error of the mode as printed by `python -m benchmarks.office_graph` and
    `python -m benchmarks.real_logs LOG`; the others bound the error of the summary itself.
    """

    mode_window: float = 6.0
    """Width of the mode's window, in standard deviations of a candidate: all of one surface, little of the next."""
    clear_share: float = 0.999
    """Share of one candidate above which the median is its range: off by less than 0.003 standard deviations."""
    tail_sigmas: float = 6.0
    """Standard deviations beyond which the tail of a candidate counts as nothing: 1e-9."""
    bracket_sigmas: float = 8.0
    """Standard deviations about a candidate within which the median is looked for."""
    max_steps: int = 40
    """Of that search; five are usual."""
    min_step: float = 1e-8
    """Standard deviations at which it ends."""
    min_weight: float = 1e-12
    """Of all candidates, below which nothing is said of a return."""


MIXTURE = MixtureSettings()
"""The settings of the mixture."""
