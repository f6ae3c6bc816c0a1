"""Draws of a run from the model `narmax`, scan by scan; drawn readings are the lags of later ones."""

from __future__ import annotations

import numpy as np

from sensorgraph.models.narmax.model import RayNarmax
from sensorgraph.models.narmax.parameters import ONE_STEP, START
from sensorgraph.models.narmax.recursion import RunState
from sensorgraph.models.narmax.sequences import ScanSequence
from sensorgraph.types import Floats


class DrawnRun:
    """State of a drawn run; the first scans, without history, are drawn from the start equation."""

    def __init__(self, model: RayNarmax, period: float) -> None:
        self.model, self.period = model, period
        self.poses: list[Floats] = []
        self.state: RunState | None = None
        self.missing = np.zeros(model.n_rays, dtype=np.bool_)

    def scan(self, pose: Floats, uniform: Floats, normal: Floats) -> Floats:
        """Draw the next scan (n_rays,) [m] at a pose (3,) from random numbers (n_rays,); +inf: no return."""
        model, lags = self.model, self.model.form.lags
        first = not self.poses
        self.poses = [*self.poses, pose][-(max(lags, 1) + 1) :]
        n = len(self.poses)
        motion = ScanSequence(
            poses=np.array(self.poses),
            stamps=self.period * np.arange(n, dtype=np.float64),
            sequence=np.zeros(n, dtype=np.intp),
        )
        equations = model.equations(motion)
        self.state = self.state or RunState(equations)
        has_history = n > lags
        raw = self.state.predicted(equations, n - 1) if has_history else equations.start[n - 1]
        error = model.sigma[ONE_STEP if has_history else START] * normal
        reading = np.clip(raw + error, *equations.limits)
        self.state.advance(reading, error if has_history else np.zeros(len(error)))
        chance = model.no_return_chances(motion, None if first else self.missing)[-1]
        self.missing = uniform < chance
        return np.where(self.missing, np.inf, reading)
