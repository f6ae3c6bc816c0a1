"""The array types that the whole package shares, and how long work tells its progress."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.intp]

Progress = Callable[[int, int], None]
"""Called with (done, total) while work goes on."""

ProgressBars = Callable[[str, str], AbstractContextManager[Progress]]
"""Open a progress bar by (title, unit): one for each stage of long work."""


def no_progress(label: str, unit: str) -> AbstractContextManager[Progress]:
    """Show nothing."""
    return nullcontext(lambda done, total: None)
