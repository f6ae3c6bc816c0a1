"""Array types shared by the whole package, the progress callback, and the options of reading."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.intp]

ROUNDING = 1e-6
"""[m, rad, s] Smaller differences are rounding."""
SCANS_AT_A_TIME = 4096
"""Number of scans that are processed together; only memory depends on it."""

Mounts = Mapping[str, Floats]
"""Topic or frame of a sensor -> (3,) [m, m, rad] mount in base_link."""

Progress = Callable[[int, int], None]
"""Called with (done, total) during the work."""


class ReadOptions(NamedTuple):
    """How a file is read."""

    topics: Mapping[str, str] | None = None
    """Role -> topic, for non-standard topic names."""
    progress: Progress | None = None
    no_return: str | None = None
    """Encoding of a missing return, one of `NO_RETURNS`; None: detected from the readings."""
    mounts: Mounts | None = None
    """Mounts of sensors that apply if the log has no transform."""
    heights: tuple[float, float] | None = None
    """[m] lowest and highest point of a point cloud that is read as a laser; None: its ring nearest the horizontal."""
