"""Held-out scans of a log: the same selection for building and for evaluating."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from logs.run import Run
from sensorgraph.errors import SensorgraphError
from sensorgraph.types import Bools

Split = Literal["every10", "block"]
SPLITS: tuple[str, ...] = get_args(Split)
N_STRETCHES, STRETCH_SHARE = 5, 0.02


def held_out(run: Run | int, split: str | None) -> Bools:
    """Return a mask (n_scans,) of the held-out scans; all False without a split.

    `every10`: scans 9, 19, 29, ... (counted from 0).
    `block`: five contiguous stretches of 2 % of the scans each (at least one scan), centred at 10, 30, 50, 70
    and 90 % of the log. There is no gap around a stretch: its first and last scans have near neighbours in the
    training part.
    """
    n = run if isinstance(run, int) else run.n_scans
    held = np.zeros(n, dtype=np.bool_)
    if split is None:
        return held
    if split not in SPLITS:
        raise SensorgraphError(f"split is {split!r}, expected one of {', '.join(SPLITS)}")
    if n < 2 * N_STRETCHES:
        raise SensorgraphError(
            f"{n} scans are too few to hold some out; give a log of {2 * N_STRETCHES} scans or more"
        )
    if split == "every10":
        held[9::10] = True
        return held
    length = max(1, round(STRETCH_SHARE * n))
    for i in range(N_STRETCHES):
        start = round((2 * i + 1) / (2 * N_STRETCHES) * n - length / 2)
        held[start : start + length] = True
    return held
