"""Odometry whose positions contradict its heading: found by the course of its positions, and corrected.

A robot on wheels drives along its heading, ahead or backwards. The true heading is a phi, where phi is the stated one and
the scans measure the factor a, 1 or a unit. The course of the positions is s phi + c, modulo a half turn.

| s | c | cause |
|---|---|---|
| a | 0 | none |
| a | other | the heading has another zero than the positions, as that of a compass |
| 2 a | any | a twist in the frame of the odometry was integrated as if it were that of the robot |
| -a | any | the positions are mirrored: y to the right, or x and y exchanged |
| 1 | any | the positions were integrated with a heading in another unit (a is not 1) |

A robot that can drive sideways may have any course, so that the scans must confirm each correction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from logs.motion import Motion
from logs.transforms import compose, invert
from sensorgraph.types import Floats

MIN_STEP = 0.05
"""[m] Length of the steps whose course is compared, well above the resolution of an odometry."""
MIN_ALIGNED = 0.9
"""Mean resultant length of the differences of course and heading, doubled, from which the robot drives along its heading ..."""
MAX_UNALIGNED = 0.6
"""... and below which it does not: 1 for equal angles, 0 for random ones (Mardia and Jupp 2000)."""
MAX_SPREAD = 1.0 - MIN_ALIGNED
"""Circular variance of the course about a multiple of the heading, up to which this multiple is s ..."""
MIN_SPREAD = 0.02
"""... and above which it is not that of a sound odometry."""
MIN_BETTER = 0.5
"""Share of this variance, and of the differences between scans and odometry, that a correction leaves at most."""
MIN_OFFSET = 0.1
"""Sine of the least angle of a heading to its course that is corrected; less is an error of the mount, or slip."""


def course_steps(poses: Floats, least: float = MIN_STEP) -> tuple[Floats, Floats]:
    """Return steps (m, 2) [m] of a length `least` or more, and the mean heading (m,) [rad] during each.

    Parameters
    ----------
    poses : (n, 3) [m, m, rad] Odometry, its heading without jumps of a full turn.
    least : [m] 0: from one pose to the next.
    """
    chosen = poses
    if least > 0:
        way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
        chosen = poses[np.unique(np.searchsorted(way, np.arange(0.0, way[-1], least)))]
    return np.diff(chosen[:, :2], axis=0), (chosen[1:, 2] + chosen[:-1, 2]) / 2.0


def alignment(poses: Floats, factor: float, least: float = MIN_STEP) -> complex:
    """Return the mean of exp(2i (course - factor * heading)), weighted by length; 1 for a robot that hardly moves.

    Its length is 1 if the course fits the heading up to a constant, and its angle is twice this constant.
    """
    steps, heading = course_steps(poses, least)
    length = np.hypot(*steps.T)
    if length.sum() < MIN_STEP:
        return 1.0 + 0.0j
    off = np.arctan2(steps[:, 1], steps[:, 0]) - factor * heading
    return complex((length * np.exp(2j * off)).sum() / length.sum())


def with_course(motion: Motion, turn_factor: float, stretch: Steps) -> tuple[Motion, str] | None:
    """Return odometry whose positions and heading agree, and a note; None if there is no such cause, or the scans deny it.

    The course of the whole drive decides on s and c, the stretch that the scans show confirms the correction.

    Parameters
    ----------
    turn_factor : Factor from the stated heading to the true one, which remains for the caller to apply.
    """
    causes = {
        turn_factor: "",
        2.0 * turn_factor: "its twist is in the frame of the odometry instead of the robot's",
        -turn_factor: "its positions are mirrored",
        **({} if turn_factor == 1.0 else {1.0: "it was integrated with the heading in this unit"}),
    }
    fits = {factor: _best_alignment(motion.poses, factor) for factor in causes}
    spread = {factor: 1.0 - abs(fit) for factor, fit in fits.items()}
    best = min(causes, key=lambda factor: spread[factor])
    if spread[turn_factor] < MIN_SPREAD or spread[best] > MIN_BETTER * spread[turn_factor]:
        best = turn_factor
    offset = float(np.angle(fits[best])) / 2.0
    if spread[best] > MAX_SPREAD or (best == turn_factor and abs(np.sin(offset)) < MIN_OFFSET):
        return None
    if best != turn_factor:
        changed = [_moved_along(motion.poses, best, turn_factor, offset)]
        note = f"the odometry moves along another heading than it states, since {causes[best]}: corrected"
    else:
        changed = [motion.poses + [0.0, 0.0, one / turn_factor] for one in (offset, offset + np.pi)]
        note = "the course of the odometry differs from its heading by a constant, and that of the scans does not: corrected"
    found = min(
        (replace(motion, poses=poses) for poses in changed), key=lambda one: stretch.misfit(one, turn_factor)
    )
    is_confirmed = stretch.misfit(found, turn_factor) < MIN_BETTER * stretch.misfit(motion, turn_factor)
    return (found, note) if is_confirmed else None


def _best_alignment(poses: Floats, factor: float) -> complex:
    """Return the alignment of steps between poses or of longer ones: whichever fits better, as coarse positions need these."""
    return max((alignment(poses, factor, least) for least in (0.0, MIN_STEP)), key=abs)


def _moved_along(poses: Floats, factor: float, turn_factor: float, offset: float) -> Floats:
    """Return poses (n, 3) whose steps go along the heading times `turn_factor`, mostly ahead; they go along `factor` times it."""
    steps, heading = course_steps(poses, 0.0)
    way = (steps[:, 0] + 1j * steps[:, 1]) * np.exp(-1j * (factor * heading + offset))
    ahead = way if way.real.sum() >= 0 else -way
    places = np.concatenate([[0.0], np.cumsum(ahead * np.exp(1j * turn_factor * heading))])
    return np.column_stack([places.real, places.imag, poses[:, 2]])


@dataclass(frozen=True, kw_only=True, eq=False)
class Steps:
    """Steps of the robot by the scans alone."""

    stamps: Floats
    """(m + 1,) [s]"""
    seen: Floats
    """(m, 3) [m, m, rad] Motion ahead and left in the frame of each pose, and turn."""
    moving: float
    """[m] Length of a step that has a direction."""
    fewest: int
    """Minimum number of such steps."""

    def misfit(self, motion: Motion, turn_factor: float) -> float:
        """Return the mean difference of the directions by odometry and scans, as the chord of unit vectors; 0 if unknown."""
        poses = motion.at(self.stamps) * [1.0, 1.0, turn_factor]
        driven = compose(invert(poses[:-1]), poses[1:])
        a, b = (steps[:, 0] + 1j * steps[:, 1] for steps in (self.seen, driven))
        use = (np.abs(a) > self.moving) & (np.abs(b) > 0)
        if use.sum() < self.fewest:
            return 0.0
        return float(np.abs(a[use] / np.abs(a[use]) - b[use] / np.abs(b[use])).mean())
