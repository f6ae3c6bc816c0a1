"""`TrackerState`: what the laser odometry knows after a scan."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sensorgraph.localization.line_map import LineMap
from sensorgraph.localization.wheels import WheelEstimate, slip_of
from sensorgraph.types import Floats


@dataclass
class TrackerState:
    """State of the tracker."""

    wheels: WheelEstimate | None
    key_frames: list[int] = field(default_factory=list)
    piece: list[int] = field(default_factory=list)
    edges: list[Floats] = field(default_factory=list)
    motion_deviations: list[Floats] = field(default_factory=list)
    is_carried: list[bool] = field(default_factory=list)
    projections: list[Floats] = field(default_factory=list)
    determined_at: float = 0.0
    """[s] Stamp of the last key frame whose scan determines all directions, or of the first one."""
    jumps: list[int] = field(default_factory=list)
    surfaces: LineMap | None = None
    last_matched: int = 0
    """Last matched scan."""
    agreement: float = 0.0
    """Share of its points that fit the key frames."""
    usual_agreement: float = 0.5
    """Moving average of this share."""
    failures: list[int] = field(default_factory=list)
    """Scans without a match since then."""
    last_unmatched: tuple[int, LineMap] | None = None
    """The last of these, and the surfaces that it observed."""
    velocity: Floats = field(default_factory=lambda: np.zeros(3))
    """[m/s, m/s, rad/s] Velocity in base_link from the last two matches."""
    slip: Floats = field(default_factory=lambda: np.zeros(3))
    """[m/s, m/s, rad/s] Error of the odometry's speed at the last match, if it slips; otherwise zero."""

    def learn_slip(self, off: Floats, deviations: Floats | None, since: float) -> None:
        """Take the error (3,) [m, m, rad] of a prediction over `since` [s] as slip, if it is beyond the odometry's noise.

        Slip lasts, as of a robot that is pushed or that spins its wheels: the next prediction has this error as its deviation.
        """
        if deviations is None or self.wheels is None:
            return
        noise = np.sqrt(np.maximum(deviations**2 - (self.slip * since) ** 2, 0.0))
        self.slip = slip_of(off, noise) / since
