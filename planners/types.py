"""Array types of the package, and the callbacks by which long work reports its progress."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.intp]
Int16s = NDArray[np.int16]
Int32s = NDArray[np.int32]

ROUND_OFF = 1e-9
"""[m, rad, m/s, rad/s] Smaller lengths, angles and speeds are round-off; so are smaller shares."""
SAME_PLACE = 1e-6
"""[m, rad] Corners that are nearer are one, and coordinates that differ by less are equal."""
MAX_COORDINATE = 1e8
"""[m] Maximum distance from the origin of map; a larger coordinate is an error."""

Progress = Callable[[int, int], None]
"""Called with (done, total) during long work."""

Status = Callable[[str], None]
"""Called with a short text on the current step and the quality of the result so far."""
