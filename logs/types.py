"""The array types that the whole package shares, and the callback for progress."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.intp]

Mounts = Mapping[str, Floats]
"""Topic or frame of a sensor -> (3,) [m, m, rad] where it sits in base_link."""

Progress = Callable[[int, int], None]
"""Called with (done, total) while work goes on."""
