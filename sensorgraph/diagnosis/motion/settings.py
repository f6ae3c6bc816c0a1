"""Settings that the modules of the motion channels share, with unit and meaning.

A number that one module reads is a constant of that module. Unless it says otherwise, a value was set on the development
cases of the hidden-effects benchmark:

    python -m benchmarks.hidden_effects generate --world own --suite SUITE --n N -o DIR
    python -m benchmarks.hidden_effects answer DIR

SUITE is one of singles, none, pairs, triples and foreign.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class EvidenceSettings:
    """Regressions of wheels and motors, and the size of an error of dead reckoning."""

    temperature: float = 4.0
    """Divisor of the evidence before it becomes a probability, since models are wrong in more ways than noise."""
    huber_limit: float = 3.0
    """Limit of Huber's loss, in standard deviations."""
    cluster: float = 2.0
    """[s] within which errors may be correlated, beyond the whitening filter; over longer times, the reference is
    more accurate than the wheels."""
    reckoning_time: float = 60.0
    """[s] duration of dead reckoning, after which the error of a simulation is evaluated."""
    n_pieces: int = 6
    """Number of pieces of the run in which scales, gains or delays may differ."""
    scale_sigma: float = 0.1
    """Prior standard deviation of a coefficient of structure, unless its family says otherwise: of a scale, a gain, an
    angle [rad], a speed [m/s], a turn rate [rad/s], a clock offset [s], or a jump [m, rad]."""
    max_gap: float = 0.35
    """[s] maximum gap in poses, odometry or commands, across which motion is compared."""


EVIDENCE = EvidenceSettings()
"""The settings of both channels."""
