"""The array types that the whole package shares, and how long work tells its progress."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.intp]

Progress = Callable[[int, int], None]
"""Called with (done, total) while work goes on."""

ProgressBars = Callable[[str, str], AbstractContextManager[Progress]]
"""Open a progress bar by (title, unit)."""
