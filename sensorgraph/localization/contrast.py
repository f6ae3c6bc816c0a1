"""Notes on what scans and odometry of a located run contradict each other about: slip, a wrong mount, a laser that sways.

From scan i to the first scan j that is `SPAN` later, the located poses move by a, and the odometry, corrected by the
identified wheels, by b. The contrast is inv(b) ∘ a; its standard deviation is that of the odometry for the longer of the two
motions.

A laser that is mounted d [m] away from its stated place moves, while the robot turns by θ, by (I - R(-θ)) d in addition. This is
linear in d, which a robust regression estimates first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from logs.run import Run
from logs.transforms import compose, invert
from sensorgraph.localization.missing_odometry import is_measured
from sensorgraph.localization.odometry import odometry_of
from sensorgraph.localization.result import Status, WheelParameters, true_intervals
from sensorgraph.localization.settings import N_REWEIGHTED, SIGNIFICANT
from sensorgraph.localization.wheels import WheelEstimate, corrected_steps
from sensorgraph.robust import SIGMA_OF_MAD, robust_sigma
from sensorgraph.types import Bools, Floats, Ints

SPAN = 1.0
"""[s] Time over which motions are compared: long enough that slip is larger than the noise of two scans."""
LEAST = 0.1
"""[m, m, rad] Least significant difference between scans and odometry that counts, ahead, left and in heading."""
LEAST_OFFSET = 0.03
"""[m] Distance of the laser from its stated place below which it is not worth a note ..."""
MIN_TURNS = 0.1
"""[rad²] Sum of squared turns below which nothing shows this distance."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Contrast:
    """Motions of a run by the scans and by the odometry."""

    first: Ints
    """(n,) Scan at the start of a motion."""
    last: Ints
    """(n,) Scan at its end."""
    by_scans: Floats
    """(n, 3) [m, m, rad] in base_link."""
    by_odometry: Floats
    """(n, 3) The same by the odometry, corrected by the wheels."""
    offset: Floats
    """(2,) [m] From the stated place of the laser to where it seems to be, ahead and left; 0 if nothing shows it."""
    off: Floats
    """(n, 3) [m, m, rad] Difference of the two motions, without that by the offset."""
    z: Floats
    """(n, 3) The same in standard deviations of the odometry."""
    is_contradiction: Bools
    """(n,) The difference exceeds the odometry's noise."""

    @classmethod
    def of(
        cls, stamps: Floats, poses: Floats, odometry: Floats, usable: Bools, wheels: WheelParameters
    ) -> Contrast:
        """Compare the motions.

        Parameters
        ----------
        stamps : (n_scans,) [s]
        poses, odometry : (n_scans, 3) [m, m, rad] Located poses, and the odometry at the scans.
        usable : (n_scans,) Pose and odometry are known.
        """
        after = np.searchsorted(stamps, stamps + SPAN)
        first = np.flatnonzero(after < len(stamps))
        last = np.maximum(after[first], first + 1)
        both = usable[first] & usable[last]
        first, last = first[both], last[both]
        a = compose(invert(poses[first]), poses[last])
        b = compose(invert(odometry[first]), odometry[last])
        b = corrected_steps(b, wheels.way_scale, wheels.turn_scale, wheels.heading_bias)
        off = compose(invert(b), a)
        offset = _offset(off, b[:, 2], float(np.mean(last - first)) if len(first) else 1.0)
        off[:, :2] -= _moved_by_turns(b[:, 2]) @ offset
        longer, turn = (np.maximum(size(a), size(b)) for size in (_way, lambda one: np.abs(one[:, 2])))
        z = np.abs(off) / WheelEstimate().deviations(longer, turn)
        large = np.asarray(((z > SIGNIFICANT) & (np.abs(off) > LEAST)).any(axis=1))
        return cls(
            first=first,
            last=last,
            by_scans=a,
            by_odometry=b,
            z=z,
            offset=offset,
            off=off,
            is_contradiction=large,
        )

    def notes(self, stamps: Floats) -> tuple[str, ...]:
        """Return a note on the longest contradiction, and one on differences that the odometry's noise does not explain."""
        notes = []
        if self.offset.any():
            ahead, left = self.offset
            notes.append(
                f"scans and odometry agree if the laser is {100 * abs(ahead):.0f} cm {'ahead of' if ahead > 0 else 'behind'} and "
                f"{100 * abs(left):.0f} cm {'left' if left > 0 else 'right'} of its stated place: either the mount is wrong, and so "
                "are the poses of base_link by the same amount, or the robot turns about another point than the origin of base_link"
            )
        if self.is_contradiction.any():
            notes.append(self._contradiction(stamps))
        other = ~self.is_contradiction
        if other.any() and np.median(self.z[other, :2], axis=0).max() > 1 / SIGMA_OF_MAD:
            notes.append(
                f"scans and odometry differ by {100 * np.median(_way(self.off[other])):.0f} cm within {SPAN:.0f} s (median), which wheels do "
                "not explain: the laser moves on the robot, as on a mast that sways, or its stamps scatter; poses follow the laser"
            )
        return tuple(notes)

    def contradicted(self, n: int) -> Bools:
        """Return which of n scans are within a motion that the odometry contradicts."""
        within = np.zeros(n, dtype=np.bool_)
        for i, j in zip(self.first[self.is_contradiction], self.last[self.is_contradiction], strict=True):
            within[i : j + 1] = True
        return within

    def _contradiction(self, stamps: Floats) -> str:
        """Return the note on the longest stretch of contradictions."""
        stretches = true_intervals(self.contradicted(len(stamps)))
        start, stop = max(stretches, key=lambda one: stamps[one[1] - 1] - stamps[one[0]])
        scans, odometry = self._driven(start, stop - 1)
        inside = (self.first >= start) & (self.last < stop)
        off = self.off[inside]
        more = f" and {len(stretches) - 1} more times" if len(stretches) > 1 else ""
        return (
            f"scans and odometry contradict each other from {stamps[start]:.1f} s to {stamps[stop - 1]:.1f} s{more}, by up to "
            f"{_way(off).max():.1f} m and {np.degrees(np.abs(off[:, 2]).max()):.0f}° within {SPAN:.0f} s: there the scans move "
            f"by {scans[0]:.1f} m and {np.degrees(scans[1]):.0f}°, the odometry by {odometry[0]:.1f} m and "
            f"{np.degrees(odometry[1]):.0f}°. The wheels slip or the robot is pushed, so that the scans are right; or the laser "
            "sees what goes along with the robot (people, a trailer, the ground), so that the odometry is"
        )

    def _driven(self, start: int, stop: int) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return distance [m] and turn [rad] by the scans and by the odometry from one scan to another, in steps of `SPAN`."""
        steps, k = [], int(np.searchsorted(self.first, start))
        while k < len(self.first) and self.last[k] <= stop:
            steps.append(k)
            k = int(np.searchsorted(self.first, self.last[k]))
        both = []
        for moved in (self.by_scans[steps], self.by_odometry[steps]):
            both.append((float(_way(moved).sum()), float(np.abs(moved[:, 2]).sum())))
        return both[0], both[1]


def _moved_by_turns(turns: Floats) -> Floats:
    """Return the matrices I - R(-θ) (n, 2, 2) of turns θ (n,) [rad]."""
    c, s = np.cos(turns), np.sin(turns)
    return np.stack([np.stack([1.0 - c, -s], axis=-1), np.stack([s, 1.0 - c], axis=-1)], axis=-2)


def _offset(off: Floats, turns: Floats, overlap: float) -> Floats:
    """Return the offset (2,) [m] of the laser from its stated place; 0 if it is small, or not significant.

    Parameters
    ----------
    off : (n, 3) [m, m, rad] Differences of the motions by scans and by odometry.
    turns : (n,) [rad] Turns by the odometry.
    overlap : Number of motions that share the same odometry.
    """
    rows, values = _moved_by_turns(turns).reshape(-1, 2), off[:, :2].ravel()
    found: Floats = np.zeros(2)
    weight = np.ones(len(values))
    for _ in range(N_REWEIGHTED):  # Cauchy's weights
        information = rows.T @ (rows * weight[:, None])
        if np.trace(information) < MIN_TURNS or np.linalg.cond(information) > 1e6:
            return np.zeros(2)
        found = np.asarray(np.linalg.solve(information, rows.T @ (weight * values)), dtype=np.float64)
        left = values - rows @ found
        sigma = robust_sigma(left) + 1e-6
        weight = 1.0 / (1.0 + (left / (2.0 * sigma)) ** 2)
    error = sigma * float(np.sqrt(overlap * np.linalg.inv(information).diagonal().max()))
    return found if np.hypot(*found) > max(LEAST_OFFSET, SIGNIFICANT * error) else np.zeros(2)


def _way(steps: Floats) -> Floats:
    return np.hypot(steps[:, 0], steps[:, 1])


def contrast_notes(
    run: Run, poses: Floats, odometry: Floats | None, status: Sequence[Status], wheels: WheelParameters | None
) -> tuple[str, ...]:
    """Return the notes on a located run; none without odometry, and none where it is missing.

    Parameters
    ----------
    poses, odometry : (n_scans, 3) [m, m, rad] Located poses, and the odometry at the scans.
    status : (n_scans,) Of the poses; only those that are ok count.
    """
    measured = odometry_of(run)
    if odometry is None or wheels is None or measured is None:
        return ()
    usable = (np.array(status) == "ok") & is_measured(measured, run.stamps)
    return Contrast.of(run.stamps, poses, odometry, usable, wheels).notes(run.stamps)
