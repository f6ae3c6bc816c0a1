"""Array types shared by the whole package, and the progress callback."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.intp]

Mounts = Mapping[str, Floats]
"""Topic or frame of a sensor -> (3,) [m, m, rad] mount in base_link."""

Progress = Callable[[int, int], None]
"""Called with (done, total) during the work."""
