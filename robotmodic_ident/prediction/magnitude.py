"""Outputs measured without their sign, such as a pulse counter that measures the speed of a wheel but not its direction.

The model describes the signed output. The measured magnitudes take the signs of the free run.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from robotmodic_ident.estimation.simulation_error import initial_outputs
from robotmodic_ident.prediction.recursion import Recursion, Segment
from robotmodic_ident.types import Floats

MAX_START = 20
"""[samples] maximum length of the start of a segment from which its first signs are estimated."""
MAX_ROUNDS = 5
"""Maximum number of updates of the first signs from the resulting free run."""


def with_signs(recursion: Recursion, segment: Segment) -> Segment:
    """Return a segment whose measured magnitudes have the signs of the free run that fits its start best."""
    measured = segment.measured
    known = np.isfinite(measured)
    n = min(int(known.argmin()) if not known.all() else len(known), MAX_START)
    if n <= recursion.look_back:
        return segment
    best, least = measured, np.inf
    for first in range(n):  # try both signs, with one change of sign at sample `first`
        for side in (1.0, -1.0):
            start = measured.copy()
            start[:n] *= np.where(np.arange(n) < first, -side, side)
            run, error = _settled(recursion, segment, start, n)
            if error < least:
                best, least = np.copysign(measured, np.where(np.isfinite(run), run, start)), error
    return replace(segment, measured=np.where(known, best, measured))


def _settled(recursion: Recursion, segment: Segment, start: Floats, n: int) -> tuple[Floats, float]:
    """Return the free run with self-consistent signs, and its sum of squares over the first n magnitudes."""
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
