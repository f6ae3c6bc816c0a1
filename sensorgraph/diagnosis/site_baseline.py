"""Baseline of a site: what known-good runs show, and how a later run is compared with them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from sensorgraph.diagnosis.scan.goodness_of_fit import GoodnessOfFit
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.diagnosis.scan.site_sizes import (
    BaselineInterval,
    SitePrior,
    WindowEstimate,
    baseline_intervals,
)
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.world.robot import Robot


@dataclass(frozen=True, kw_only=True, eq=False)
class SiteBaseline:
    """Effects, tolerances and noise that known-good runs of a site show."""

    robot: Robot
    """With the pose tolerances and the sensor resolution that the runs showed."""
    known: tuple[Amendment, ...]
    """Effects that the runs show; they become part of the simulator."""
    noise_bounds: NoiseBounds
    """Limits of the noise, close to what the runs showed."""
    not_looked_for: tuple[str, ...]
    """Effects that a map of this kind cannot show."""
    runs: tuple[tuple[tuple[WindowEstimate, ...], ...], ...]
    """Estimates of each run, for the whole run and for shorter windows."""

    @property
    def n_runs(self) -> int:
        """Number of known-good runs, or of parts of them."""
        return len(self.runs)

    def to_dict(self, name: str) -> dict[str, Any]:
        """Return the baseline as plain data for the report, for a run as long as the first.

        Parameters
        ----------
        name : Of the runs.
        """
        first = self.runs[0][0][0]
        windows = self.similar_windows(first.n_scans)
        intervals = baseline_intervals(windows)
        clutter = self.clutter_nats(windows, intervals, first.n_readings)
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
                "most": bounds.max_scale,
            },
            "known": {a.name: dict(a.parameters) for a in self.known},
            "clutter_floor_nats": {effect: round(nats, 1) for effect, nats in clutter.items()},
            "usual_sizes": {effect: interval.limits(effect) for effect, interval in intervals.items()},
            "not_looked_for": list(self.not_looked_for),
        }

    def similar_windows(self, n_scans: int) -> list[WindowEstimate]:
        """Return windows of the known-good runs of nearly the same length; also shorter ones, if these are few."""
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
        n_readings: int,
    ) -> dict[str, float]:
        """Return the evidence [nats] that clutter may give to each effect in a run of this length.

        Smooth whole-sensor effects with a baseline interval are omitted: the interval is the sharper test.
        """
        return {
            name: most
            for name, most in self._most_nats(windows, n_readings).items()
            if not _has_sharper_test(name, intervals)
        }

    def _most_nats(self, windows: Sequence[WindowEstimate], n_readings: int) -> dict[str, float]:
        """Return the evidence [nats] that clutter may give to each effect in a run with this number of readings."""
        factor = SCAN.site.clutter_factor_of_one if self.n_runs == 1 else SCAN.site.clutter_factor
        most: dict[str, float] = {}
        for w in windows:
            size = float(np.sqrt(n_readings / w.n_readings))
            for name, gain in w.gains.items():
                most[name] = max(most.get(name, 0.0), factor * gain * (1.0 if _is_local(name) else size))
        return most

    def apply_to(self, data: ScanData) -> ScanData:
        """Return the data of a later run, prepared for comparison with this baseline.

        Its poses may be those of the laser itself: a mount that has moved since then shows as a difference.
        """
        windows = self.similar_windows(data.n_scans)
        intervals = baseline_intervals(windows)
        floors = self.clutter_nats(windows, intervals, data.ranges.size)
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
            site=SitePrior(floors=clutter, leads=leads, intervals=intervals),
            memo={},
        )

    def discount(self, fit: GoodnessOfFit, data: ScanData) -> GoodnessOfFit:
        """Remove unmodelled structure no larger than that of the known-good runs; keep only the excess misfit."""
        windows = [w for cuts in self.runs for level in cuts[:2] for w in level]
        own = max(w.misfit / w.n_readings for w in windows) * data.ranges.size
        told = fit.told
        if told is not None:
            beyond = told.misfit - SCAN.site.clutter_factor_of_one * own
            if beyond > 0:
                return replace(fit, told=replace(told, misfit=beyond))
        return replace(fit, told=None)


def _has_sharper_test(name: str, intervals: Mapping[str, BaselineInterval]) -> bool:
    """Tell whether an effect is a smooth whole-sensor effect, whose size is compared with known-good runs."""
    return name in intervals and bool(EFFECTS[name].nuisances)


def _is_local(name: str) -> bool:
    """Tell whether an effect has one place in the site, so that its evidence does not grow with the run."""
    return EFFECTS[name].place in ("wall", "obstacle", "spot")
