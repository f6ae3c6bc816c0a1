"""Tell whether any drive in a room could show an effect, by the effect's own condition of observability.

A forecast compares two models ray by ray. An effect may need more, for example readings of the floor, before the
search of a diagnosis finds it. `Diagnostics.unobservable` is the condition that the report applies to a run; here it is
applied to spins at places in the whole room.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from planners.arena import Arena
from sensorgraph.diagnosis.next_run.candidate_motions import DrivableSpace, MotionKind, candidate_motions
from sensorgraph.diagnosis.next_run.design import motion_samples
from sensorgraph.diagnosis.next_run.forecast import planned_scans
from sensorgraph.diagnosis.scan.exposure import RunExposure
from sensorgraph.diagnosis.scan.fit import cast, fit, start_state
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import Amendment
from sensorgraph.world.robot import Robot


class RoomExposure:
    """Surfaces, ranges and angles that a drive anywhere in a room would meet; computed at the first question."""

    def __init__(self, arena: Arena, robot: Robot, *, seed: int = 0, minutes: float = 2.0) -> None:
        self.arena, self.robot, self.seed, self.duration = arena, robot, seed, 60.0 * minutes

    @cached_property
    def _spins(self) -> tuple[RunExposure, float]:
        """Exposure of spins at all places, and its share of the readings of a run that stays at one place."""
        space = DrivableSpace.of(self.arena, self.robot)
        motions = candidate_motions(space, np.random.default_rng(self.seed))
        spins = [motion for motion in motions if motion.kind is MotionKind.SPIN]
        samples = [motion_samples(motion, self.robot, self.duration) for motion in spins]
        scans = planned_scans(samples, self.arena, self.robot, self.duration)
        expected = cast(scans, ()).expected
        scans.ranges[:] = np.where(expected.p_return > 0.5, expected.reading, np.inf)
        fitted = fit(scans, (), start_state(scans, SCAN.noise), SCAN.noise, outer=1, inner=1)
        sensor = self.robot.sensor
        share = scans.ranges.size / len(spins) / (self.duration * sensor.rate * sensor.n_rays)
        return RunExposure(scans, fitted, SCAN.selection.threshold), share

    def can_show(self, a: Amendment) -> bool:
        """Tell whether a run could show an effect that acts everywhere; True for effects without a condition."""
        condition = a.effect.diagnostics.unobservable
        if condition is None or a.place:
            return True
        exposure, share = self._spins
        return not condition(exposure, a.parameters, exposure.need_of(a.effect) * min(share, 1.0))
