"""Nuisance parameters: small errors of every set-up, which each fit leaves free."""

from __future__ import annotations

from enum import IntEnum


class Nuisance(IntEnum):
    """One small error of the sensor or its mount; the value is its index among the unknowns of a fit.

    Each is the tolerance-sized copy of one parameter of an effect (`Parameter.nuisance`).
    """

    MOUNT_X = 0
    """[m] the laser sits further ahead."""
    MOUNT_Y = 1
    """[m] the laser sits further left."""
    MOUNT_YAW = 2
    """[rad] the laser is turned counter-clockwise."""
    BIAS = 3
    """[m] added to every return."""
    SCALE = 4
    """[1] relative stretch of every return."""
    DRIFT = 5
    """[m] bias that grows from 0 to this during the run."""
    DELAY = 6
    """[s] the scan was taken earlier than its stamp."""
    SKEW = 7
    """[s] from the first ray of a scan to the last."""


MOUNT = (Nuisance.MOUNT_X, Nuisance.MOUNT_Y, Nuisance.MOUNT_YAW)
POSE_LIKE = (*MOUNT, Nuisance.DELAY)
"""What moves the laser of a scan as an error of its pose does."""
