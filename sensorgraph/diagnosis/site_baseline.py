"""The baseline of a site: what good runs show though nothing is wrong, and how a later run is judged against it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.special import stdtrit

from sensorgraph.diagnosis.scan.goodness_of_fit import GoodnessOfFit
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.diagnosis.scan.site_sizes import BaselineInterval, WindowEstimate, baseline_intervals
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.types import Floats
from sensorgraph.world.robot import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class SiteBaseline:
    """What runs known to be good say of their site, its poses and its sensor."""

    robot: Robot
    """With the tolerances of the poses, and the resolution of the sensor, that the runs showed."""
    known: tuple[Amendment, ...]
    """What the run itself shows: part of the simulator from now on."""
    noise_bounds: NoiseBounds
    """Noise, held near what the runs showed."""
    not_looked_for: tuple[str, ...]
    """Effects that a map like this one cannot show."""
    runs: tuple[tuple[tuple[WindowEstimate, ...], ...], ...]
    """Of each run, as a whole and cut finer: what its windows showed though nothing was wrong."""

    @property
    def n_runs(self) -> int:
        """Count of good runs, or of stretches of them."""
        return len(self.runs)

    def to_dict(self, name: str) -> dict[str, Any]:
        """Return what was learnt, as plain data for the report; for a run as long as the first.

        Parameters
        ----------
        name : of the runs
        """
        first = self.runs[0][0][0]
        windows = self.similar_windows(first.n_scans)
        intervals = baseline_intervals(windows)
        clutter = self.clutter_nats(windows, intervals, first.n_scans, first.n_readings)
        bounds = self.noise_bounds
        return {
            "run": name,
            "runs": self.n_runs,
            "tolerances": asdict(self.robot.tolerances),
            "resolution": self.robot.sensor.resolution,
            "noise": {
                "core": bounds.core,
                "tail": bounds.tail,
                "loss": bounds.loss,
                "stray": bounds.stray,
                "pose": bounds.min_pose_scale,
                "most": bounds.max_scale,
            },
            "known": {a.name: dict(a.parameters) for a in self.known},
            "clutter_floor_nats": {effect: round(nats, 1) for effect, nats in clutter.items()},
            "usual_sizes": {effect: interval.limits(effect) for effect, interval in intervals.items()},
            "not_looked_for": list(self.not_looked_for),
        }

    def similar_windows(self, n_scans: int) -> list[WindowEstimate]:
        """Return windows of the good runs that are nearly as long; shorter ones too, where these are few."""
        levels = []
        for cuts in self.runs:
            apart = [abs(np.log(level[0].n_scans / n_scans)) for level in cuts]
            levels.append(cuts[int(np.argmin(apart)) :])
        windows: list[WindowEstimate] = []
        for depth in range(max(len(level) for level in levels)):
            windows += [w for finer in levels for level in finer[depth : depth + 1] for w in level]
            if len(windows) >= SCAN.site.min_windows:
                break
        return windows

    def clutter_nats(
        self,
        windows: Sequence[WindowEstimate],
        intervals: Mapping[str, BaselineInterval],
        n_scans: int,
        n_readings: int,
    ) -> dict[str, float]:
        """Return, per effect, what clutter may bring it though nothing is wrong [nats], in a run of this length.

        Smooth effects of the whole sensor with a baseline interval are left out: the interval is the sharper test. An
        effect that no good run gave a reason to try may still be tried in the next: where clutter has brought others more
        than a name takes, it pays the least of these.
        """
        nats = {
            name: most
            for name, most in self._most_nats(windows, n_readings).items()
            if not _has_sharper_test(name, intervals)
        }
        least = min((n for n in nats.values() if n > SCAN.selection.threshold), default=0.0)
        if least == 0.0:
            return nats
        looked_for = [
            name
            for name, effect in EFFECTS.items()
            if effect.channel == "scan" and not _has_sharper_test(name, intervals)
        ]
        return {**dict.fromkeys(looked_for, least), **nats}

    def _most_nats(self, windows: Sequence[WindowEstimate], n_readings: int) -> dict[str, float]:
        """Return, per effect, what clutter may bring it in a run of so many readings though nothing is wrong [nats]."""
        gained: dict[str, list[float]] = {}
        for w in windows:
            size = float(np.sqrt(n_readings / w.n_readings))
            for name, gain in w.gains.items():
                gained.setdefault(name, []).append(gain if _is_local(name) else gain * size)
        return {
            name: max(values) * self._clutter_factor(name, np.array(values))
            for name, values in gained.items()
        }

    def _clutter_factor(self, name: str, gained: Floats) -> float:
        """Return what a name takes, over the most that clutter alone has brought: more, where windows differ much.

        Parameters
        ----------
        gained : (n,) [nats] in each of the windows where clutter brought anything
        """
        site = SCAN.site
        if self.n_runs == 1:
            return site.local_clutter_factor if _is_local(name) else site.clutter_factor
        if EFFECTS[name].place != "sector":  # a run has many walls and spots, and its gain is of the worst
            return site.min_clutter_factor
        if len(gained) < site.min_windows or gained.min() <= 0:
            return site.clutter_factor
        logs = np.log(gained)  # of a further window: a prediction interval
        t = stdtrit(len(logs) - 1, site.confidence)
        far = t * logs.std(ddof=1) * np.sqrt(1 + 1 / len(logs))
        factor = np.exp(logs.mean() + far) / gained.max()
        return float(np.clip(factor, site.min_clutter_factor, site.max_clutter_factor))

    def apply_to(self, data: ScanData) -> ScanData:
        """Return the data of a later run, to be judged against this baseline.

        Its poses may be the laser's own: a mount that has moved since shows as a difference.
        """
        windows = self.similar_windows(data.n_scans)
        intervals = baseline_intervals(windows)
        floors = self.clutter_nats(windows, intervals, data.n_scans, data.ranges.size)
        clutter = {name: max(nats - SCAN.selection.threshold, 0.0) for name, nats in floors.items()}
        clutter |= dict.fromkeys(self.not_looked_for, float("inf"))
        leads = {
            name: nats
            for name, nats in self._most_nats(windows, data.ranges.size).items()
            if _has_sharper_test(name, intervals)
        }
        return replace(
            data,
            laser_frame=False,
            clutter_nats=clutter,
            clutter_leads=leads,
            baseline_intervals=intervals,
            memo={},
        )

    def discount(self, doubt: GoodnessOfFit, data: ScanData) -> GoodnessOfFit:
        """Take back a doubt that is no larger than the good runs' own, and count only the misfit beyond that."""
        site = SCAN.site
        windows = [w for cuts in self.runs for level in cuts[:2] for w in level]
        own = max(w.misfit / w.n_readings for w in windows) * data.ranges.size
        beyond = doubt.misfit - site.misfit_factor * own
        is_clear = doubt.threshold <= 0 or doubt.statistic > site.doubt_factor * doubt.threshold
        if beyond > 0 and is_clear:
            return replace(doubt, misfit=site.doubt_share * beyond)
        return replace(doubt, statement="", deviation=None, misfit=0.0, failed=frozenset())


def _has_sharper_test(name: str, intervals: Mapping[str, BaselineInterval]) -> bool:
    """Tell whether an effect is a smooth one of the whole sensor, whose size is held against those of good runs."""
    return name in intervals and bool(EFFECTS[name].nuisances)


def _is_local(name: str) -> bool:
    """Tell whether an effect sits at one place of the site: a longer run shows it no more than a shorter one."""
    return EFFECTS[name].place in ("wall", "obstacle", "spot")
