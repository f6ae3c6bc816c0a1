"""Readings that go along with the robot: of a trailer, of people next to it, or of the ground before a robot that pitches.

If they fill most of the view, the scans seem to move less than the robot, or at random. So do they if wheels slip. Where scans
and odometry contradict each other (`contrast.py`), the readings of two scans decide. A reading supports one motion against the
other if the first places it on what the other scan sees, and the second in space that rays of the other scan crossed.
Readings that also fit if the robot stands support none: they may be fixed to the robot.

Where the odometry is right, the readings that it places in crossed space are dropped, and the scans are tracked again. If that
does not help, and no readings support the scans, all are dropped. Where no readings support either motion, the poses are as uncertain as the two differ.

A motion by the scans that places many readings in crossed space is a wrong match, as of scans that are turned, or of few surfaces
behind much that moves. It counts for nothing, however many readings it explains by chance: more than `CLOSURES.see_through`
of those that the other scan sees. Of robots that were pushed or slipped, it is up to 0.02.

Where the odometry contradicts the scans and does not measure the motion, neither does it during a sweep: a robot that turns by ω
while its odometry stands would be located ω T / 2 off its heading at the stamp of a sweep of the duration T. The track of the scans
measures this motion, and deskews such sweeps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from logs.run import Run
from logs.transforms import compose, invert
from sensorgraph.localization.contrast import Contrast
from sensorgraph.localization.front_end import track
from sensorgraph.localization.missing_odometry import is_measured, without_jumps
from sensorgraph.localization.odometry import odometry_of
from sensorgraph.localization.result import WheelParameters, true_intervals
from sensorgraph.localization.scans import NOISE_MARGIN, ScanPoints, crossed, moved_points, scan_points
from sensorgraph.localization.settings import CLOSURES
from sensorgraph.localization.tracked_run import TrackedRun, motion_of_track
from sensorgraph.localization.wheels import corrected_steps
from sensorgraph.types import Bools, Floats, Ints, ProgressBars, no_progress

MIN_SUPPORTING = 4.0
"""Mean number of readings that support one motion between two scans; fewer may be chance ..."""
MIN_SHARE = 0.1
"""... unless they are this share of the readings of a scan, as with few rays."""
MIN_RATIO = 0.2
"""Ratio of readings that support the odometry to those that support the scans, from which the odometry is right. Where robots
were pushed or slipped (fr079, intel), it was up to 0.07; with a trailer, people or the ground in view, 0.4 or more."""
ROUNDS = 6
"""Maximum number of times that the scans are tracked again; each shows contradictions that larger ones had hidden."""


@dataclass(frozen=True, kw_only=True, eq=False)
class OdometryVerdict:
    """What the readings say of poses that the odometry contradicts."""

    is_false: Bools
    """(n_scans,) The scan lies in a stretch where the odometry is right."""
    is_sure: Bools
    """(n_scans,) ... and no readings of the stretch support the scans, as where wheels slip."""
    doubt: Floats
    """(n_scans, 3) [m, m, rad] Difference from the odometry where no readings decide between the two; 0 elsewhere."""

    @classmethod
    def none(cls, n: int) -> OdometryVerdict:
        """Return a verdict without objection to any of n scans."""
        none = np.zeros(n, dtype=np.bool_)
        return cls(is_false=none, is_sure=none.copy(), doubt=np.zeros((n, 3)))


def with_motion_of_scans(followed: TrackedRun, progress: ProgressBars = no_progress) -> TrackedRun:
    """Return a tracked run whose sweeps are deskewed by the track where it contradicts the odometry, and tracked again.

    Sweeps stay as they are where readings show that the odometry is right, or do not decide.
    """
    run, odometry, tracked = followed.run, followed.odometry, followed.track
    measured = odometry_of(run) if run.sensor.has_ray_delays else None
    if odometry is None or measured is None or tracked.wheels is None:
        return followed
    wheels, usable = tracked.wheels.parameters, is_measured(measured, run.stamps)
    contrast = Contrast.of(run.stamps, tracked.poses, odometry, usable, wheels)
    is_between_pieces = tracked.within(np.diff(tracked.piece) != 0)  # their frames differ
    chosen = contrast.contradicted(run.n_scans) & tracked.matched & ~is_between_pieces
    if not chosen.any():
        return followed
    verdict = verdict_on(run, followed.scans, tracked.poses, odometry, wheels)
    chosen &= ~verdict.is_false & ~verdict.doubt.any(axis=1)
    motion = motion_of_track(run, tracked, without_jumps(measured))
    scans = followed.scans.with_scans_of(scan_points(run, motion), chosen)
    middles = None if followed.middles is None else followed.middles.without(chosen)
    return replace(followed, scans=scans, track=track(scans, run.stamps, odometry, progress), middles=middles)


def without_moving_returns(followed: TrackedRun, progress: ProgressBars = no_progress) -> TrackedRun:
    """Return a tracked run without the readings that go along with the robot, and a note where there are any."""
    run, odometry, measured = followed.run, followed.odometry, odometry_of(followed.run)
    learned = followed.track.wheels
    if odometry is None or measured is None or learned is None:
        return followed
    usable, whole = is_measured(measured, run.stamps), followed.scans
    dropped = np.zeros(len(whole.points), dtype=np.bool_)
    thinned = np.zeros(run.n_scans, dtype=np.bool_)
    for _ in range(ROUNDS):
        wheels = learned.parameters
        contrast = Contrast.of(run.stamps, followed.track.poses, odometry, usable, wheels)
        verdict = _judged(whole, contrast)
        thin, useless = verdict.is_false & ~thinned, verdict.is_sure & thinned
        if not (thin | useless).any():
            break
        for k in np.flatnonzero(useless).tolist():
            dropped[whole.of(k)] = True
        for k in np.flatnonzero(thin).tolist():
            dropped[whole.of(k)] = _goes_along(whole, k, contrast, odometry, wheels)
        thinned |= thin
        scans = whole.without(dropped)
        tracked = track(scans, run.stamps, odometry, progress)
        followed, learned = replace(followed, scans=scans, track=tracked), tracked.wheels or learned
    if not thinned.any():
        return followed
    return replace(followed, notes=(*followed.notes, _note(run.stamps, thinned, dropped, whole)))


def verdict_on(
    run: Run, scans: ScanPoints, poses: Floats, odometry: Floats | None, wheels: WheelParameters | None
) -> OdometryVerdict:
    """Judge the poses (n_scans, 3) [m, m, rad] of all scans by the odometry (n_scans, 3) at the scans, if there is any."""
    measured = odometry_of(run)
    if odometry is None or measured is None or wheels is None:
        return OdometryVerdict.none(run.n_scans)
    contrast = Contrast.of(run.stamps, poses, odometry, is_measured(measured, run.stamps), wheels)
    return _judged(scans, contrast)


def confirms_odometry(scans: ScanPoints, stamps: Floats, poses: Floats, odometry: Floats) -> bool:
    """Return whether the readings show, in most of a stretch, that the odometry is right and not the scans.

    Parameters
    ----------
    stamps : (n_scans,) [s]
    poses, odometry : (n_scans, 3) [m, m, rad] By the scans alone and by the odometry, without errors of the wheels.
    """
    contrast = Contrast.of(stamps, poses, odometry, np.ones(len(stamps), dtype=np.bool_), WheelParameters())
    return bool(_judged(scans, contrast).is_false.mean() > 0.5)


def _judged(scans: ScanPoints, contrast: Contrast) -> OdometryVerdict:
    """Judge each stretch in which the odometry contradicts the scans."""
    found = OdometryVerdict.none(scans.n_scans)
    chosen = np.flatnonzero(contrast.is_contradiction)
    within = contrast.contradicted(scans.n_scans)
    least = min(MIN_SUPPORTING, MIN_SHARE * len(scans.points) / scans.n_scans)
    for start, stop in true_intervals(within):
        own = chosen[(contrast.first[chosen] >= start) & (contrast.last[chosen] < stop)]
        counts = np.array([_supporting(scans, contrast, int(one)) for one in own])
        of_scans, of_moving_scans, of_odometry, n_seen, n_through = counts.mean(axis=0)
        is_mismatch = n_through > CLOSURES.see_through * n_seen
        if of_odometry >= max(least, 0.0 if is_mismatch else MIN_RATIO * of_moving_scans):
            found.is_false[start:stop] = True
            slips = (counts[:, 1] >= least) & (counts[:, 2] < MIN_RATIO * counts[:, 1])
            found.is_sure[start:stop] = not slips.any()
        elif of_scans < least or is_mismatch:
            off = np.abs(contrast.off[own]).max(axis=0)
            found.doubt[start:stop] = [max(off[:2]), max(off[:2]), off[2]]
    return found


def _supporting(scans: ScanPoints, contrast: Contrast, one: int) -> Ints:
    """Count (5,) the readings that support the scans, those of them that do not fit a standing robot, and those for the odometry.

    The last two are those that the other scan sees at the motion by the scans, and those of them in space that its rays crossed.
    """
    total = np.zeros(5, dtype=np.intp)
    i, j = int(contrast.first[one]), int(contrast.last[one])
    seen, driven = contrast.by_scans[one], contrast.by_odometry[one]
    for of, to, a, b in ((j, i, seen, driven), (i, j, invert(seen), invert(driven))):
        by_scans, not_scans = _fits(scans, of, to, a)
        by_odometry, not_odometry = _fits(scans, of, to, b)
        standing, _ = _fits(scans, of, to, np.zeros(3))
        for_scans, for_odometry = by_scans & not_odometry, by_odometry & not_scans
        total += [
            for_scans.sum(),
            (for_scans & ~standing).sum(),
            (for_odometry & ~standing).sum(),
            (by_scans | not_scans).sum(),
            not_scans.sum(),
        ]
    return total


def _fits(scans: ScanPoints, of: int, to: int, motion: Floats) -> tuple[Bools, Bools]:
    """Tell which points of a scan fit another, at `motion` (3,) from it, and which its rays crossed."""
    points = moved_points(scans.points[scans.of(of)], motion)
    seen, through = crossed(points, np.zeros(3), scans, scans.of(to), NOISE_MARGIN)
    return seen & ~through, through


def _goes_along(
    scans: ScanPoints, k: int, contrast: Contrast, odometry: Floats, wheels: WheelParameters
) -> Bools:
    """Tell which points of scan k the odometry places where rays of the scans about a second before or after it crossed."""
    ends = [*contrast.last[contrast.first == k], *contrast.first[contrast.last == k]]
    along = np.zeros(len(scans.points[scans.of(k)]), dtype=np.bool_)
    for other in map(int, ends):
        first, last = min(k, other), max(k, other)
        step = compose(invert(odometry[first]), odometry[last])
        step = corrected_steps(step, wheels.way_scale, wheels.turn_scale, wheels.heading_bias)
        along |= _fits(scans, k, other, step if other == first else invert(step))[1]
    return along


def _note(stamps: Floats, thinned: Bools, dropped: Bools, scans: ScanPoints) -> str:
    """Return the note on the readings that were not used."""
    stretches = true_intervals(thinned)
    start, stop = max(stretches, key=lambda one: stamps[one[1] - 1] - stamps[one[0]])
    more = f" and {len(stretches) - 1} more times" if len(stretches) > 1 else ""
    share = dropped[scans.first[start] : scans.first[stop]].mean()
    return (
        f"from {stamps[start]:.1f} s to {stamps[stop - 1]:.1f} s{more}, {100 * share:.0f} % of the readings contradict the odometry and other "
        "readings confirm it: the laser sees what moves (people, a trailer, the ground), or its bearings were wrong; these readings were not used"
    )
