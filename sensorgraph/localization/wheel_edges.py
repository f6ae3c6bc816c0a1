"""Odometry constraints between neighbouring key frames, with the three wheel parameters as unknowns.

The residual of edge e is r_e = inv(x_a) ∘ x_b - step_e(s, k, b), with distance scale s, turn scale k and
heading bias b. With fixed parameters a small error of the heading bias would bend the whole map.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.transforms import compose, difference, invert
from sensorgraph.localization.pose_graph import PoseEdges
from sensorgraph.localization.result import WheelParameters
from sensorgraph.localization.scan_track import ScanTrack
from sensorgraph.localization.settings import CAUCHY, FRONT_END, SIGNIFICANT, WHEELS
from sensorgraph.localization.wheels import (
    MAX_SCATTER,
    MIN_SCATTER,
    STRETCHES,
    WheelEstimate,
    corrected_steps,
    identify_wheels,
    signed_distance,
)
from sensorgraph.robust import SIGMA_OF_MAD
from sensorgraph.types import Bools, Floats, Ints

UNKNOWN_SD = 1.0
"""[m, rad] Standard deviation of a step of which nothing is known."""


@dataclass(frozen=True, kw_only=True, eq=False)
class WheelEdges:
    """Edges, and their dependence on the wheel parameters."""

    edges: PoseEdges
    by_parameters: Floats
    """(n, 3, 3) Derivative of the residual (pose step minus wheel step) with respect to distance scale, turn
    scale and heading bias."""
    prior: Floats
    """(3, 3) Prior information of the parameters."""
    pull: Floats
    """(3,) Gradient of |q - q_0|²_prior / 2 at the parameters q of the edges; q_0 are those of a calibrated robot."""


@dataclass(frozen=True, kw_only=True, eq=False)
class WheelSteps:
    """Odometry steps between neighbouring key frames, without breaks and jumps."""

    first: Ints
    """(n,) Number of the key frame at the start of the step."""
    steps: Floats
    """(n, 3) [m, m, rad] Steps in base_link from the odometry; zero without odometry."""
    has_odometry: bool
    is_seen: Bools | None = None
    """(n, 3) The scans determine the step ahead, left and its turn; None: of all. The others do not identify the wheels."""
    deviations: Floats | None = None
    """(n, 3) [m, m, rad] Standard deviations of a step without odometry: ahead, left, turn; None: `UNKNOWN_SD`. With
    odometry, those of a step of a robot that is pushed."""

    @staticmethod
    def of(odometry: Floats | None, tracked: ScanTrack, stamps: Floats) -> WheelSteps:
        """Take the steps of the odometry (n_scans, 3) at stamps (n_scans,) [s], except across a break of the track or a jump."""
        keys = tracked.key_frames
        first = np.arange(len(keys) - 1)
        if odometry is None:
            deviations, none = tracked.motion_deviations, np.zeros((len(first), 3))
            return WheelSteps(first=first, steps=none, has_odometry=False, deviations=deviations)
        is_whole = (tracked.piece[1:] == tracked.piece[:-1]) | tracked.is_carried
        for jump in tracked.jumps:
            is_whole[(keys[:-1] < jump) & (jump <= keys[1:])] = False
        first = first[is_whole]
        steps = compose(invert(odometry[keys[first]]), odometry[keys[first + 1]])
        seen = np.einsum("nii->ni", tracked.projections) > 0.5
        is_seen = seen[first] & seen[first + 1] & ~tracked.is_carried[first, None]
        rates = np.array([FRONT_END.speed_sd, FRONT_END.speed_sd, FRONT_END.turn_rate_sd])
        took = np.maximum(np.diff(stamps[keys])[first], 0.0)
        return WheelSteps(
            first=first, steps=steps, has_odometry=True, is_seen=is_seen, deviations=took[:, None] * rates
        )

    def parameters(self, poses: Floats, least: Floats | None = None) -> WheelParameters | None:
        """Identify the wheel parameters from the poses (n_key, 3), with standard errors of at least `least` (3,).

        Without odometry they are None.
        """
        if not self.has_odometry:
            return None
        seen = self.is_seen
        both = None if seen is None else np.column_stack([seen[:, 0] & seen[:, 1], seen[:, 2]])
        found = identify_wheels(self.steps, self._measured(poses), is_seen=both)
        return found if least is None else found.at_least(least)

    def at(self, poses: Floats) -> WheelEdges:
        """Return the edges at the poses (n_key, 3), with wheel parameters and noise estimated from them."""
        n = len(self.first)
        measured = self._measured(poses)
        found = self.parameters(poses)
        if found is None or n == 0:
            sd = np.full((n, 3), UNKNOWN_SD) if self.deviations is None else self.deviations
            loose = np.eye(3) / sd[:, None, :] ** 2
            return self._edges(measured, loose, np.zeros((n, 3, 3)), np.eye(3), np.zeros(3))
        relative = corrected_steps(self.steps, found.way_scale, found.turn_scale, found.heading_bias)
        way = signed_distance(self.steps)
        sd = WheelEstimate().deviations(np.abs(way), relative[:, 2])
        off = difference(measured, relative)
        scale = self._scatter(off / sd)
        z = off / (sd * scale)
        soft = 1.0 / (1.0 + (z**2).sum(axis=1) / (3.0 * CAUCHY**2))
        information = np.zeros((n, 3, 3))
        for axis in range(3):
            information[:, axis, axis] = soft / (sd[:, axis] * scale[axis]) ** 2
        self._limit(information, off, sd)
        turned = 0.5 * np.column_stack(
            [-relative[:, 1], relative[:, 0]]
        )  # derivative by a turn that the odometry misses during the step
        by = np.zeros((n, 3, 3))
        by[:, :2, 0] = -relative[:, :2] / found.way_scale
        by[:, :2, 1], by[:, 2, 1] = -turned * self.steps[:, 2:], -self.steps[:, 2]
        by[:, :2, 2], by[:, 2, 2] = -turned * way[:, None], -way
        prior = np.array([WHEELS.scale_sd, WHEELS.scale_sd, WHEELS.heading_bias_sd]) ** -2.0
        off_prior = np.array([found.way_scale - 1.0, found.turn_scale - 1.0, found.heading_bias])
        return self._edges(relative, information, by, np.diag(prior), prior * off_prior)

    def _edges(
        self, relative: Floats, information: Floats, by_parameters: Floats, prior: Floats, pull: Floats
    ) -> WheelEdges:
        edges = PoseEdges(first=self.first, second=self.first + 1, relative=relative, information=information)
        return WheelEdges(edges=edges, by_parameters=by_parameters, prior=prior, pull=pull)

    def _scatter(self, off: Floats) -> Floats:
        """Return the noise (3,) of the wheels relative to the standard deviations, from steps (n, 3) that the scans determine.

        Where the scans do not, the poses follow the wheels. From too few steps, the noise is the usual one.
        """
        is_seen = np.ones(off.shape, dtype=np.bool_) if self.is_seen is None else self.is_seen
        if is_seen.all():
            return np.clip(SIGMA_OF_MAD * np.median(np.abs(off), axis=0), MIN_SCATTER, MAX_SCATTER)
        out = np.ones(3)
        for axis, seen in enumerate(is_seen.T):
            if seen.sum() >= STRETCHES:
                found = SIGMA_OF_MAD * float(np.median(np.abs(off[seen, axis])))
                out[axis] = np.clip(found, MIN_SCATTER, MAX_SCATTER)
        return out

    def _limit(self, information: Floats, off: Floats, sd: Floats) -> None:
        """Limit the information (n, 3, 3) of steps that slip, where the scans do not determine all of the motion.

        If the robot is pushed, wheels that err where the scans see it do not measure the motion that they do not see.
        """
        if self.is_seen is None or self.deviations is None:
            return
        slips = (np.abs(off) > SIGNIFICANT * sd).any(axis=1) & ~self.is_seen.all(axis=1)
        for axis in range(3):
            least = np.maximum(self.deviations[slips, axis], sd[slips, axis]) ** -2.0
            information[slips, axis, axis] = np.minimum(information[slips, axis, axis], least)

    def _measured(self, poses: Floats) -> Floats:
        return compose(invert(poses[self.first]), poses[self.first + 1])
