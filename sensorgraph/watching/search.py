"""A search for other poses in parallel with the tracking, whose results follow the robot meanwhile.

A search of the whole place takes half a second or more, and a robot moves on. So a thread searches, and what it finds is used when
the scans' clock has advanced by a stated time: a log has the same result on each machine.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from logs.transforms import compose, invert
from sensorgraph.localization.branch_and_bound import SearchWindow
from sensorgraph.localization.global_search import LocalView, find_places
from sensorgraph.localization.known_map import KnownMap
from sensorgraph.types import Bools, Floats
from sensorgraph.watching.kept_scans import KeptScans
from sensorgraph.watching.modes import Mode, moved_on
from sensorgraph.watching.scan_input import ScanInput, odometry_deviations
from sensorgraph.watching.settings import TrackingPriors

Motion = tuple[Floats, Floats, ScanInput]
"""Motion (3,) [m, m, rad] up to a scan, its standard deviations (3,), and the scan."""


class PlaceSearch:
    """A search of the surroundings of a pose, whose results are used at the next scan, and of the whole place.

    Parameters
    ----------
    kept : Scans that are searched for.
    window : Surroundings of base_link at the last of them; None: only the whole place is searched.
    sees : Tells at which poses (n, 3) the graph has seen something. A robot at another pose is elsewhere.
    now : Scan at which the search begins.
    waits : Whether a result that is due is waited for. If not, it is used as soon as it is there.
    """

    def __init__(
        self,
        kept: KeptScans,
        window: SearchWindow | None,
        place: KnownMap,
        sees: Callable[[Floats], Bools],
        priors: TrackingPriors,
        now: ScanInput,
        *,
        waits: bool = True,
    ) -> None:
        self.place, self.priors, self.sees, self.waits = place, priors, sees, waits
        self.ready: list[Mode] = []
        """Poses that were found, the most probable last, at the last scan that was followed; without probabilities."""
        step = compose(invert(kept.last_drift), now.drift)
        self._since: list[Motion] = [(step, odometry_deviations(step, priors), now)]
        begun, view, pool = now.observation.stamp, kept.view(), ThreadPoolExecutor(1)
        windows = [(begun, window)] if window is not None else []
        self._parts = [
            (due, pool.submit(self._found, view, each))
            for due, each in (*windows, (begun + priors.search_time, None))
        ]
        pool.shutdown(wait=False)

    @property
    def is_done(self) -> bool:
        """Whether all that was found has been taken."""
        return not self._parts and not self.ready

    def follow(self, step: Floats, deviations: Floats, now: ScanInput) -> None:
        """Move the poses by the odometry (3,), whose standard deviations are (3,), and match the next scan there."""
        self.ready = [moved_on(mode, self.place, step, deviations, now) for mode in self.ready]
        if self._parts:
            self._since.append((step, deviations, now))
        while self._parts and now.observation.stamp > self._parts[0][0]:
            found = self._parts[0][1]
            if not (self.waits or found.done()):
                return
            modes, n = found.result()
            for motion in self._since[n:]:
                modes = [moved_on(mode, self.place, *motion) for mode in modes]
            self.ready += modes
            del self._parts[0]

    def _found(self, view: LocalView, window: SearchWindow | None) -> tuple[list[Mode], int]:
        """Return the poses found, after a number of the motions since the view."""
        found = find_places(view, self.place, window=window).poses
        found = found[self.sees(found)][: self.priors.n_modes]
        modes, n = [Mode.found_at(pose) for pose in found[::-1]], 0
        while n < len(self._since):  # it grows meanwhile
            modes = [moved_on(mode, self.place, *self._since[n]) for mode in modes]
            n += 1
        return modes, n
