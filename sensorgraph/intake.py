"""What is refused of a log before anything is made of it, unless the user insists."""

from __future__ import annotations

from logs.jumps import Jumps, find_jumps
from logs.run import Pairing, RangeSensor, Run
from sensorgraph.errors import SensorgraphError


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


def check_one_laser(sensor: RangeSensor, name: str, *, takes: str, remedy: str) -> None:
    """Refuse rays that start at several places, or measure within a cone, where these are not understood.

    Parameters
    ----------
    takes : who takes the thin rays of one place, for the message
    remedy : what to do

    Raises
    ------
    SensorgraphError : the sensor has such rays
    """
    if sensor.is_composite or sensor.cones.any():
        what = "rays from several places" if sensor.is_composite else "a cone for each ray"
        raise SensorgraphError(f"{name} has {what}; {takes} the thin rays of one laser: {remedy}")
