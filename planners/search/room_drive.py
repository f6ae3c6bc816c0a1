"""The drive through one room, and the curve of a search by a robot that turns in place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planners.curve import Curve, curve_of_pieces
from planners.search.motion_primitives import MotionPrimitives
from planners.search.search import SearchResult
from planners.types import Floats, Ints


@dataclass(frozen=True, kw_only=True, eq=False)
class RoomDrive:
    """The drive through one room, from rest to rest."""

    curve: Curve
    stops: Floats
    """(n, 4) [m, m, rad, rad] pose at the start of each revolution, and its angle."""
    left: int
    """Number of bins of the room that the drive does not cover."""

    @property
    def ends(self) -> tuple[Floats, Floats]:
        """Poses (3,) at rest at the start and at the end."""
        poses = self.curve.sample(np.array([0.0, self.curve.duration]))[0]
        return poses[0], poses[1]


def spin_curve(result: SearchResult, primitives: MotionPrimitives, alpha: float) -> Curve:
    """Return the curve of a drive with a continuous spin: spin up, the primitives, spin down.

    Parameters
    ----------
    alpha : [rad/s²] Angular acceleration of spinning up and down.
    """
    omega = primitives.omega
    modes = _modes(result, primitives)
    n = len(result.sequence)
    v = primitives.speeds[modes]
    ramp = omega / alpha
    dt = np.concatenate([[ramp], np.full(n, primitives.unit), [ramp]])
    twists = np.zeros((n + 2, 2))
    twists[1:, 1] = omega
    twists[1:-1, 0] = v[:-1]
    rates = np.zeros((n + 2, 2))
    rates[1:-1, 0] = np.diff(v) / primitives.unit
    rates[[0, -1], 1] = alpha, -alpha
    heading = primitives.first_heading + primitives.heading_step * result.start[2] - 0.5 * omega * ramp
    labels = np.full(n + 2, "drift")
    labels[[0, -1]] = "turn"
    return curve_of_pieces(np.array([*result.start[:2], heading]), dt, twists, rates, labels)


def _modes(result: SearchResult, primitives: MotionPrimitives) -> Ints:
    """Return the modes (n + 1,) before each primitive and after the last."""
    modes = np.empty(len(result.sequence) + 1, dtype=np.int64)
    modes[0] = int(result.start[3])
    then = primitives.next_mode.tolist()
    mode = int(modes[0])
    for k, j in enumerate(result.sequence.tolist()):
        mode = then[mode][j]
        modes[k + 1] = mode
    return modes
