"""Settings of the model `cells`, with unit and meaning; the modules hold the constants of the algorithms.

The modules use the instance `CELLS`. Some settings are constants of compiled code: `planners.kernel` recompiles after a
change of their values. The values were set on public logs of real floors. The criterion is the error on held-out
stretches, as printed by

    python -m benchmarks.real_logs LOG [LOG ...] --others

The shipped coefficients of visibility were learned with these values. They must be learned again (`--learn`) after a
change of the cells, of the reach or of the key frames.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class CellSettings:
    """Cells, the scans that are counted in them, and the rays that are answered."""

    cell_size: float = 0.05
    """[m] Side of a cell; 3.5 to 7 cm give similar errors."""
    max_reach: float = 10.0
    """[m] Longer ranges count as no return within reach."""
    min_range: float = 0.1
    """[m] Shorter ranges are not used."""
    max_ray_spacing: float = math.radians(0.34)
    """[rad] Gaps between neighbouring rays that are wider are filled with virtual rays."""
    key_frame_distance: float = 0.4
    """[m] Minimum motion between key frames; only key frames are counted, so that counts are independent."""
    key_frame_turn: float = math.radians(20.0)
    """[rad] Minimum turn between key frames; one of both limits suffices."""
    first_sigma: float = 0.03
    """[m] Initial standard deviation of a range about the face that stops the ray, including the noise of poses."""
    ridge: float = 2.0
    """Precision of the prior of the coefficients of visibility around the shipped ones."""
    max_unseen_length: float = 0.10
    """[m] Maximum length in cells that no training ray crossed for a ray to be answered."""


CELLS = CellSettings()
"""The settings that the modules use."""
