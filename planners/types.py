"""The array types that the whole package shares, and how long work tells its progress."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.intp]
Int32s = NDArray[np.int32]
Int16s = NDArray[np.int16]

Progress = Callable[[int, int], None]
"""Called with (done, total) while work goes on."""

Status = Callable[[str], None]
"""Called with a few words on what is worked on now, and how good it is already."""
