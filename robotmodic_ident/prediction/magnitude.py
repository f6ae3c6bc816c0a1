"""Outputs that are measured without their sign: a counter of pulses tells how fast a wheel turns, not which way.

The model is of the signed output; what was measured gets the signs of its free run.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from robotmodic_ident.estimation.simulation_error import initial_outputs
from robotmodic_ident.prediction.recursion import Recursion, Segment
from robotmodic_ident.types import Floats

MAX_START = 20
"""[samples] at the start of a segment that tell its first signs."""
MAX_ROUNDS = 5
"""Times that the signs of a start are taken from the free run that they led to."""


def with_signs(recursion: Recursion, segment: Segment) -> Segment:
    """Return a segment whose measured magnitudes have the signs of the free run that meets its start best."""
    measured = segment.measured
    known = np.isfinite(measured)
    n = min(int(known.argmin()) if not known.all() else len(known), MAX_START)
    if n <= recursion.look_back:
        return segment
    best, least = measured, np.inf
    for first in range(n):  # both signs at first, and one change later
        for side in (1.0, -1.0):
            start = measured.copy()
            start[:n] *= np.where(np.arange(n) < first, -side, side)
            run, error = _settled(recursion, segment, start, n)
            if error < least:
                best, least = np.copysign(measured, np.where(np.isfinite(run), run, start)), error
    return replace(segment, measured=np.where(known, best, measured))


def _settled(recursion: Recursion, segment: Segment, start: Floats, n: int) -> tuple[Floats, float]:
    """Return the free run from signs that it agrees with, and what it leaves of the first n magnitudes."""
    run, error = np.full(len(start), np.nan), np.inf
    for _ in range(MAX_ROUNDS):
        signed = replace(segment, measured=start)
        run = recursion.run(signed, free=True, initial=initial_outputs(recursion, signed, n))[0]
        run[: recursion.look_back] = np.where(
            np.isfinite(run[: recursion.look_back]), run[: recursion.look_back], start[: recursion.look_back]
        )
        rest = np.abs(run[:n]) - np.abs(start[:n])
        error = float(rest @ rest) if np.isfinite(rest).all() else np.inf
        new = start.copy()
        new[:n] = np.copysign(start[:n], run[:n])
        if not np.isfinite(error) or (new[:n] == start[:n]).all():
            break
        start = new
    return run, error
