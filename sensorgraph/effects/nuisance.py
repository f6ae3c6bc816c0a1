"""Nuisance parameters: small errors of each setup, which each fit estimates."""

from __future__ import annotations

from enum import IntEnum


class Nuisance(IntEnum):
    """A small error of the sensor or its mount; the value is its index among the unknowns of a fit.

    Each nuisance corresponds to one parameter of an effect (`Parameter.nuisance`), limited by the tolerance.
    """

    MOUNT_X = 0
    """[m] Shift of the laser forward."""
    MOUNT_Y = 1
    """[m] Shift of the laser to the left."""
    MOUNT_YAW = 2
    """[rad] Turn of the laser, counter-clockwise."""
    BIAS = 3
    """[m] Offset of each return."""
    SCALE = 4
    """[1] Relative stretch of each return."""
    DRIFT = 5
    """[m] Bias at the end of the run, which grows from 0."""
    DELAY = 6
    """[s] Age of the scan at its stamp."""
    SKEW = 7
    """[s] Time from the first ray of a scan to the last."""


MOUNT = (Nuisance.MOUNT_X, Nuisance.MOUNT_Y, Nuisance.MOUNT_YAW)
POSE_LIKE = (*MOUNT, Nuisance.DELAY)
"""Nuisances that move the laser of a scan like an error of its pose."""
