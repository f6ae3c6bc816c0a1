"""What is refused of a log before anything is made of it, unless the user insists, and what was taken for granted."""

from __future__ import annotations

import numpy as np

from logs.jumps import find_jumps
from logs.notes import assumptions_of
from logs.run import Pairing, RangeSensor, Run
from sensorgraph.errors import SensorgraphError
from sensorgraph.models.cones.settings import measures_cones
from sensorgraph.types import Floats
from sensorgraph.world.orientation import MAX_ERROR_RATIO, orientation

SCATTERED = 0.25
"""Share of the steps that jump, above which the poses are no drive but places one by one."""
STANDS_STILL = 1e-3
"""[m, rad] poses that change less in all of a run are all the same."""
LEAST_WAY = 0.5
"""[m] that wheels drive beyond doubt."""


def log_notes(*runs: Run) -> list[str]:
    """Return what was assumed, mended or left out when runs were read, each once and with the name of its log."""
    return list(
        dict.fromkeys(
            f"{run.meta.get('source', 'the run')}: {note}" for run in runs for note in assumptions_of(run)
        )
    )


def check_jumps(
    run: Run,
    pairing: Pairing,
    *,
    force: bool,
    name: str | None = None,
    last: tuple[Floats, Floats] = (np.zeros(0), np.zeros((0, 3))),
) -> None:
    """Refuse a run whose pose jumps between consecutive scans; with `force`, take it as it is.

    Poses that jump at every other scan are no drive: where the scans themselves fit together at these poses
    (`orientation`), they are single measurements, and are taken.

    Parameters
    ----------
    last : stamp (1,) and pose (1, 3) of the scan before, where the run is a piece of a log

    Raises
    ------
    SensorgraphError : it jumps farther than a robot drives
    """
    if force:
        return
    stamps = np.concatenate([last[0], run.stamps[pairing.paired]])
    poses = np.concatenate([last[1], pairing.poses[pairing.paired]])
    jumps = find_jumps(stamps, poses, is_timed=run.meta.get("clock") != "assumed")
    if jumps is None or (jumps.share > SCATTERED and _fits_itself(run)):
        return
    raise SensorgraphError(
        f"{name or run.meta.get('source', 'the run')}: {jumps}; expected poses along which a robot can drive: check the "
        "clocks and where the poses are from (sensorgraph inspect), or set `force` to use them as they are"
    )


def check_moves(run: Run) -> None:
    """Refuse a run whose wheels drive while its reference stands.

    Raises
    ------
    SensorgraphError : the poses are all the same, and the odometry moves
    """
    still = len(run.poses) > 1 and float(np.ptp(run.poses, axis=0).max()) < STANDS_STILL
    if not still or not len(run.odometry):
        return
    way = float(np.hypot(*np.diff(run.odometry[:, :2], axis=0).T).sum())
    if way > LEAST_WAY:
        raise SensorgraphError(
            f"the poses never change while the wheels drive {way:.1f} m; "
            "name the topic of the reference with `topics` pose=..."
        )


def _fits_itself(run: Run) -> bool:
    """Tell whether end points of the scans fall on each other clearly better than those of turned or mirrored scans.

    Where that cannot be told (a few scans, several sensors as one), they are believed.
    """
    found = orientation(run, None)
    if found is None:
        return True
    others = [value for name, value in found.fits.items() if name != "as logged"]
    return found.fits["as logged"] < MAX_ERROR_RATIO * min(others)


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
    if measures_cones(sensor):
        widest = np.degrees(sensor.cones.max())
        raise SensorgraphError(
            f"{name} measures the nearest surface in cones of {widest:.0f}°; {takes} thin rays: {remedy}"
        )
    if one_place and sensor.is_composite:
        raise SensorgraphError(
            f"{name} has rays from several places; {takes} the rays of one laser: {remedy}"
        )
