"""Hypotheses about laser and wheels, whose evidence adds up over the last minutes of driving."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.ndimage import median_filter

from logs.transforms import compose, difference, invert
from sensorgraph.effects.latency import LATENCY
from sensorgraph.effects.wheel_slip import WHEEL_SLIP
from sensorgraph.models.base import Prediction
from sensorgraph.robust import MAJORITY
from sensorgraph.types import Bools, Floats
from sensorgraph.watching.belief_lag import BeliefLag
from sensorgraph.watching.evidence import Baseline, FaultDoubt, Pair, doubt_of
from sensorgraph.watching.laser_errors import BlockedSectors, MissingReturns, RangeErrors, in_a_block
from sensorgraph.watching.odometry_errors import OdometryErrors
from sensorgraph.watching.readings import GraphReadings
from sensorgraph.watching.scan_input import ScanInput
from sensorgraph.watching.settings import (
    BELIEF_FAULT,
    DISTANCE_FAULTS,
    FAULTS_PER_HOUR,
    LASER_FAULTS,
    MISSING_FAULT,
    ROBOT,
    FaultPrior,
    RobotPriors,
)

SURE = 1e-3
"""Probability that the tracked pose is wrong, above which a scan says nothing about the robot."""
STEPS = 40
"""Number of recent steps that are searched for slip and dead encoders."""
MOVING = 0.03
"""[m] Shortest step that shows these."""
LONGEST_STEP = 2.0
"""[s] A robot whose scans are further apart drives unseen meanwhile."""
SLIPPING = 0.1
"""Least share of the way that wheels lose by slip; odometry that errs otherwise is not that of wheels that slip."""


class RobotHealth:
    """Collects evidence about one robot; `update` takes one tracked scan after the other."""

    def __init__(
        self,
        readings: GraphReadings,
        baseline: Mapping[str, Baseline] | None = None,
        priors: RobotPriors = ROBOT,
    ) -> None:
        self.readings, self.priors = readings, priors
        self.baseline = dict(baseline or {})
        self.motion = Pair(OdometryErrors, priors.period)
        self.belief = Pair(BeliefLag, priors.period)
        self.ranges = Pair(RangeErrors, priors.period)
        self.missing = Pair(MissingReturns, priors.period)
        self.sectors = BlockedSectors(readings, priors)
        self.log_odds = math.log(FAULTS_PER_HOUR / 3600.0 * 2 * priors.period)
        self._steps: deque[tuple[Floats, Floats]] = deque(maxlen=STEPS)
        self._last: tuple[float, Floats, Floats] | None = None
        self._since: dict[str, float] = {}
        self._waiting: tuple[Floats, float, Floats, float] | None = None
        """Step, its time [s], pose and weight of the last scan: the twist at its time lies between two steps."""

    @property
    def usable(self) -> Bools:
        """Which of the compared rays no sector covers."""
        return np.asarray(~self.sectors.rays())

    def lose(self) -> None:
        """The pose is not sure: the next motion is not compared."""
        self._last = self._waiting = None
        for motion in self.motion.both:
            motion.forget_pose()
        for belief in self.belief.both:
            belief.forget_pose()

    def update(self, now: ScanInput, pose: Floats, prediction: Prediction, stands: Bools) -> None:
        """Take a scan whose tracked pose (3,) is sure, with the prediction of the compared rays there.

        Parameters
        ----------
        stands : (n_rays,) The predicted surface was seen lately.
        """
        stamp, odometry = now.observation.stamp, now.observation.odometry
        dt = 0.0 if self._last is None else stamp - self._last[0]
        ranges = now.observation.ranges
        for one in self.ranges.both:
            one.add(self.readings, now.scan, prediction, ranges, now.weight)
        self._add_coverage(ranges, prediction, stands, now.weight, dt)
        is_moving = False
        if (
            self._last is not None and not 0.0 < dt < LONGEST_STEP
        ):  # the way meanwhile is no step: begin again
            self.lose()
        for lag in self.belief.both:
            lag.add(stamp, pose, now.observation.believed)
        if odometry is not None and self._last is not None:
            step = compose(invert(self._last[1]), odometry)
            is_moving = float(np.hypot(step[0], step[1]) + abs(step[2])) > 0.01
            self._add_motion(step, dt, pose, now.weight)
            if np.hypot(step[0], step[1]) > MOVING or np.hypot(*(pose - self._last[2])[:2]) > MOVING:
                self._steps.append((step, compose(invert(self._last[2]), pose)))
        if odometry is not None:
            self._last = stamp, odometry, pose
        if is_moving:
            for pair in (self.motion, self.belief, self.ranges, self.missing):
                pair.advance(dt)

    def _add_motion(self, step: Floats, dt: float, pose: Floats, weight: float) -> None:
        """Take a step (3,) in a time [s] and the pose (3,) at its end; it counts when the next step is known.

        The twist at the pose is the mean one over both steps: stamps of one scan each may be too close or too far apart.
        """
        if self._waiting is not None:
            before, dt_before, pose_before, weight_before = self._waiting
            twist = (before + step)[[0, 2]] / (dt_before + dt)
            for motion in self.motion.both:
                motion.add(before, twist, pose_before, weight_before)
        self._waiting = step, dt, pose, weight

    def _add_coverage(
        self, ranges: Floats, prediction: Prediction, stands: Bools, weight: float, dt: float
    ) -> None:
        """Count readings that are missing or too close where the graph predicts a surface within the laser's limits.

        A graph may have been built with a laser that reaches farther, or nearer. Where a surface was not seen lately, it may be
        gone, and the space behind it may be larger than the laser's reach: a reading that is missing there shows no blocked sector.
        """
        z, sensor = ranges[self.readings.rays], self.readings.sensor
        near, mode, p_none = self.priors.near, prediction.mode[0], prediction.p_no_return[0]
        low, high = max(2 * near, sensor.range_min + near), sensor.range_max - near
        asked = prediction.answered[0] & (mode > low) & (mode < high) & ~np.isnan(z)
        is_none = np.isposinf(z) | (z >= sensor.range_max)
        is_covered = is_none | (z < near)
        self.sectors.add(is_covered, p_none, asked & (stands | ~is_none), weight, dt)
        counted = asked & self.usable & ~in_a_block(is_none & asked, asked)
        if counted.sum() >= 20:
            excess = float((is_none - p_none)[counted].mean())
            for one in self.missing.both:
                one.add(excess, weight)

    @property
    def belief_age(self) -> float:
        """[s] Age of the believed pose relative to the tracked one: the usual one, and what is named."""
        doubt, clock = self._of_belief()
        named = doubt.parameters[BELIEF_FAULT.parameter] if doubt.p > MAJORITY else 0.0
        return self.baseline.get(BELIEF_FAULT.name, Baseline()).value + named + clock

    def _of_belief(self) -> tuple[FaultDoubt, float]:
        """Return the doubt about the age of the believed pose, and the time [s] of its clock after that of the scans.

        The tracked pose has the stamp of the scan. If this is wrong, a belief is right that agrees with the clock of the odometry
        or, since the odometry may be late, with that of the scans.
        """
        scans = next(doubt for doubt in self._of(DISTANCE_FAULTS, self.motion) if doubt.name == LATENCY.name)
        clock = self.baseline.get(LATENCY.name, Baseline()).value
        clock += scans.parameters["s"] if scans.p > MAJORITY else 0.0
        found = [(self._of((BELIEF_FAULT,), self.belief, -one)[0], one) for one in (0.0, clock)]
        return min(found, key=lambda each: each[0].nats)

    def doubts(self, stamp: float) -> list[FaultDoubt]:
        """Return all hypotheses, the most probable first."""
        missing = self._of((MISSING_FAULT,), self.missing)
        found = [
            *self._of(DISTANCE_FAULTS, self.motion),
            self._of_belief()[0],
            *self._of(LASER_FAULTS, self.ranges),
            *(doubt if doubt.parameters["share"] > 0 else replace(doubt, p=0.0) for doubt in missing),
            *self._of_sectors(),
            *self._of_steps(),
        ]
        out = []
        for doubt in found:
            if doubt.p > 0.5:
                self._since.setdefault(doubt.name, stamp)
            else:
                self._since.pop(doubt.name, None)
            out.append(replace(doubt, since=self._since.get(doubt.name, stamp)))
        return sorted(out, key=lambda doubt: -doubt.p)

    def _of(self, faults: Sequence[FaultPrior], pair: Pair[Any], shift: float = 0.0) -> list[FaultDoubt]:
        """Return the doubt about each fault, from the collection that makes it more probable, with values moved by a shift."""
        found = [
            [
                doubt_of(
                    fault,
                    float(value) + shift,
                    float(error),
                    self.log_odds,
                    self.baseline.get(fault.name),
                    one.freedom,
                )
                for fault, value, error in zip(faults, *one.estimates(), strict=True)
            ]
            for one in pair.both
        ]
        return [max(each, key=lambda doubt: doubt.p) for each in zip(*found, strict=True)]

    def _of_sectors(self) -> list[FaultDoubt]:
        blocked = np.flatnonzero(self.sectors.blocked())
        if len(blocked) == 0:
            return []
        runs = np.split(blocked, np.flatnonzero(np.diff(blocked) > 1) + 1)
        blocked = max(runs, key=len)  # the widest of several
        nats = float(self.sectors.nats[blocked].max())
        middles = self.sectors.middle[blocked]
        width = self.priors.sector
        parameters = {
            "from_rad": float(middles.min() - width / 2),
            "to_rad": float(middles.max() + width / 2),
        }
        p = float(1.0 / (1.0 + math.exp(-nats - self.sectors.log_odds)))
        return [
            FaultDoubt(
                name="blocked_sector",
                p=p,
                nats=nats,
                parameters=parameters,
                stderr=dict.fromkeys(parameters, width / 2),
            )
        ]

    def _of_steps(self) -> list[FaultDoubt]:
        """Return doubts about an encoder and about slip, from steps that odometry and tracking state differently.

        The odometry of a robot with one dead encoder turns in proportion to its distance, whatever the robot does. A scan with
        a wrong stamp makes two steps odd, in opposite directions; the median over three steps leaves it out.
        """
        if len(self._steps) < 10:
            return []
        driven, true = (np.array(steps) for steps in zip(*self._steps, strict=True))
        off = median_filter(difference(true, driven), (3, 1), mode="nearest")
        odd = (np.hypot(off[:, 0], off[:, 1]) > 0.5 * np.maximum(np.hypot(*driven[:, :2].T), MOVING)) | (
            np.abs(off[:, 2]) > 0.15
        )
        share = float(odd.mean())
        if share < 0.3:
            return []
        slope = float(driven[:, 0] @ driven[:, 2] / max(driven[:, 0] @ driven[:, 0], 1e-9))
        left = float(
            ((driven[:, 2] - slope * driven[:, 0]) ** 2).sum() / max((driven[:, 2] ** 2).sum(), 1e-9)
        )
        nats = 5.0 * float(odd.sum())
        p = float(1.0 / (1.0 + math.exp(-min(nats + self.log_odds, 50.0))))
        if abs(slope) > 0.5 and left < 0.02:
            side = "left" if slope > 0 else "right"
            return [
                FaultDoubt(
                    name=f"dead_encoder_{side}", p=p, nats=nats, parameters={"rad_per_m": slope}, stderr={}
                )
            ]
        stated, way = (float(np.hypot(steps[odd, 0], steps[odd, 1]).sum()) for steps in (driven, true))
        name, lacking = WHEEL_SLIP.name, 1.0 - way / max(stated, 1e-9)
        if lacking < SLIPPING:  # wheels that slip state a longer way than the robot drives
            name, lacking = "odometry_unlike_motion", share
        return [FaultDoubt(name=name, p=p, nats=nats, parameters={"share": lacking}, stderr={})]
