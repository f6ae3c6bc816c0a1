"""What is refused of a log before anything is made of it, unless the user insists."""

from __future__ import annotations

import numpy as np

from logs.jumps import Jumps, find_jumps
from logs.run import Pairing, RangeSensor, Run
from sensorgraph.errors import SensorgraphError

NARROW_CONE = float(np.radians(5.0))
"""[rad] a narrower cone counts as a thin ray: met at 45°, its nearest surface is 4 % nearer than the ray's."""


def check_jumps(run: Run, pairing: Pairing, *, force: bool, name: str | None = None) -> None:
    """Refuse a run whose pose jumps between consecutive scans; with `force`, take it as it is.

    Raises
    ------
    SensorgraphError : it jumps farther than a robot drives
    """
    poses = pairing.poses[pairing.paired]
    jumps = find_jumps(run.stamps[pairing.paired], poses, is_timed=run.meta.get("clock") != "assumed")
    refuse_jumps(jumps, name or run.meta.get("source", "the run"), force=force)


def refuse_jumps(jumps: Jumps | None, name: str, *, force: bool) -> None:
    """Raise an error that says how far the poses of a run jump, and what to do; not with `force`."""
    if jumps is not None and not force:
        raise SensorgraphError(
            f"{name}: {jumps}; expected poses along which a robot can drive: check the clocks and where the poses "
            "are from (sensorgraph inspect), or set `force` to use them as they are"
        )


def check_rays(sensor: RangeSensor, name: str, *, takes: str, remedy: str, one_place: bool = True) -> None:
    """Refuse wide cones, and rays that start at several places, where these are not understood.

    Parameters
    ----------
    takes : who takes thin rays, for the message
    remedy : what to do
    one_place : rays must start in one place

    Raises
    ------
    SensorgraphError : the sensor has such rays
    """
    widest = float(sensor.cones.max(initial=0.0))
    if widest > NARROW_CONE:
        raise SensorgraphError(
            f"{name} measures the nearest surface in cones of {np.degrees(widest):.0f}°; {takes} thin rays: {remedy}"
        )
    if one_place and sensor.is_composite:
        raise SensorgraphError(
            f"{name} has rays from several places; {takes} the rays of one laser: {remedy}"
        )
