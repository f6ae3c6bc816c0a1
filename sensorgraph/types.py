"""Array types of the whole package, and types of progress reports."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.intp]

RayChoice = NDArray[np.integer] | Sequence[int] | None
"""Indices of rays, or a mask (n_rays,) of bool; None: all rays."""

Progress = Callable[[int, int], None]
"""Function that is called with (done, total) during the work."""

ProgressBars = Callable[[str, str], AbstractContextManager[Progress]]
"""Function of (title, unit) that opens a progress bar, one for each stage of the work."""


def no_progress(label: str, unit: str) -> AbstractContextManager[Progress]:
    """Show nothing."""
    return nullcontext(lambda done, total: None)
