"""What the odometry says between neighbouring key frames, as edges whose three wheel parameters are unknown, too.

Fixed parameters would make a small error of the heading bias a bend of the whole map.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.transforms import compose, invert, wrap
from sensorgraph.localization.front_end import ScanTrack
from sensorgraph.localization.pose_graph import PoseEdges
from sensorgraph.localization.result import WheelParameters
from sensorgraph.localization.settings import WHEELS, WheelSettings
from sensorgraph.localization.wheels import WheelEstimate, corrected_steps, identify_wheels, signed_way
from sensorgraph.types import Floats, Ints


@dataclass(frozen=True, kw_only=True, eq=False)
class WheelEdges:
    """Edges, and how they depend on the parameters of the wheels."""

    edges: PoseEdges
    by_parameters: Floats
    """(n, 3, 3) derivative of the residual (pose's minus wheels' step) by way scale, turn scale and heading bias."""
    prior: Floats
    """(3, 3) information of the parameters before any scan."""


@dataclass(frozen=True, kw_only=True, eq=False)
class WheelSteps:
    """Steps of the odometry between neighbouring key frames, where it can be believed."""

    first: Ints
    """(n,) number of the key frame where the step begins."""
    steps: Floats
    """(n, 3) [m, m, rad] in base_link, as the odometry says; zero without odometry."""
    has_odometry: bool
    settings: WheelSettings = WHEELS

    @staticmethod
    def of(odometry: Floats | None, tracked: ScanTrack) -> WheelSteps:
        """Take the steps of the odometry (n_scans, 3), but across a break of the track or a jump."""
        keys = tracked.key_frames
        first = np.arange(len(keys) - 1)
        if odometry is None:
            return WheelSteps(first=first, steps=np.zeros((len(first), 3)), has_odometry=False)
        is_whole = tracked.piece[1:] == tracked.piece[:-1]
        for jump in tracked.jumps:
            is_whole[(keys[:-1] < jump) & (jump <= keys[1:])] = False
        first = first[is_whole]
        steps = compose(invert(odometry[keys[first]]), odometry[keys[first + 1]])
        return WheelSteps(first=first, steps=steps, has_odometry=True)

    def parameters(self, poses: Floats) -> WheelParameters | None:
        """Identify the wheels by the poses (n_key, 3); None without odometry."""
        if not self.has_odometry:
            return None
        return identify_wheels(self.steps, self._measured(poses), self.settings)

    def at(self, poses: Floats) -> WheelEdges:
        """Return the edges with parameters and noise as the poses (n_key, 3) show them."""
        n = len(self.first)
        measured = self._measured(poses)
        found = self.parameters(poses)
        if found is None or n == 0:
            loose = np.broadcast_to(np.eye(3) / self.settings.unknown_sd**2, (n, 3, 3))
            return WheelEdges(
                edges=PoseEdges(
                    first=self.first, second=self.first + 1, relative=measured, information=loose
                ),
                by_parameters=np.zeros((n, 3, 3)),
                prior=np.eye(3),
            )
        s = self.settings
        relative = corrected_steps(self.steps, found.way_scale, found.turn_scale, found.heading_bias)
        estimate = WheelEstimate(s)
        way = signed_way(self.steps)
        sd = np.array([estimate.deviations(abs(w), t) for w, t in zip(way, relative[:, 2], strict=True)])
        off = measured - relative
        off[:, 2] = wrap(off[:, 2])
        scale = np.clip(1.4826 * np.median(np.abs(off / sd), axis=0), s.least_scatter, s.most_scatter)
        z = off / (sd * scale)
        soft = 1.0 / (1.0 + (z**2).sum(axis=1) / (3.0 * s.slip**2))
        information = np.zeros((n, 3, 3))
        for axis in range(3):
            information[:, axis, axis] = soft / (sd[:, axis] * scale[axis]) ** 2
        turned = 0.5 * np.column_stack([-relative[:, 1], relative[:, 0]])  # by a turn missed on the way
        by = np.zeros((n, 3, 3))
        by[:, :2, 0] = -relative[:, :2] / found.way_scale
        by[:, :2, 1], by[:, 2, 1] = -turned * self.steps[:, 2:], -self.steps[:, 2]
        by[:, :2, 2], by[:, 2, 2] = -turned * way[:, None], -way
        return WheelEdges(
            edges=PoseEdges(
                first=self.first, second=self.first + 1, relative=relative, information=information
            ),
            by_parameters=by,
            prior=np.diag(np.array([s.way_scale_sd, s.turn_scale_sd, s.heading_bias_sd]) ** -2.0),
        )

    def _measured(self, poses: Floats) -> Floats:
        return compose(invert(poses[self.first]), poses[self.first + 1])
