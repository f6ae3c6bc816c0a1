"""Plans for other software: waypoints for Nav2, and a command profile. `trajectory` writes the trajectory CSV."""

from __future__ import annotations

import numpy as np

from planners.arena import wrap
from planners.curve import Curve
from planners.planning import Plan
from planners.types import Floats

COMMAND_RATE = 20.0
"""[Hz] of cmd_vel.csv."""
MIN_STEP = 0.01
"""[m, rad] Shorter moves and turns are left out of the steps."""
SPIN_ALLOWANCE = 3.0
"""Time allowance of a spin in Nav2, as a multiple of its planned duration ..."""
MIN_SPIN_ALLOWANCE = 10.0
"""... and its minimum [s]."""


def waypoints(plan: Plan) -> str:
    """Return the stops of a plan as YAML; see `stops_yaml`."""
    return stops_yaml(plan.curve, plan.stops, plan.trajectory.poses[-1])


def stops_yaml(curve: Curve, stops: Floats, end: Floats) -> str:
    """Return stops (n, 4) and the last pose (3,) as YAML: geometry_msgs/Pose in map, and the spin made on arrival.

    Nav2's path followers skip turns on the spot. `spin` [rad, relative, may exceed a full turn] is the
    `target_yaw` of Nav2's Spin behaviour. If the drive consists of straight moves and turns on the spot,
    `steps` lists the actions to send, one after the other. A drive that turns while it moves has no steps:
    see docs/pages/how-to/nav2.md.
    """
    lines = ["frame_id: map", "poses:"]
    every = [*stops.tolist(), [*end.tolist(), 0.0]]
    for x, y, phi, spin in every:
        z, w = np.sin(phi / 2), np.cos(phi / 2)
        lines.append(
            f"- {{position: {{x: {x:.6f}, y: {y:.6f}, z: 0.0}}, "
            f"orientation: {{x: 0.0, y: 0.0, z: {z:.9f}, w: {w:.9f}}}, spin: {spin:.6f}}}"
        )
    if np.isin(curve.labels, ("drift", "drive")).any():
        lines.append(
            "steps: []  # it turns while it moves: drive trajectory.csv, see docs/pages/how-to/nav2.md"
        )
    else:
        lines += ["steps:", *_steps(np.array(every), curve)]
    return "\n".join(lines) + "\n"


def _steps(every: Floats, curve: Curve) -> list[str]:
    """Return the actions: FollowPath to a pose by its index, backward where needed, and Spin."""
    top = float(abs(curve.twists[:, 1]).max())
    lines: list[str] = []
    here = curve.poses[0, :2]
    for k, (x, y, phi, spin) in enumerate(every.tolist()):
        leg = np.array([x, y]) - here
        if np.hypot(*leg) > MIN_STEP:
            backward = abs(float(wrap(np.arctan2(leg[1], leg[0]) - phi))) > np.pi / 2
            lines.append(f"- {{action: FollowPath, pose: {k}, backward: {str(backward).lower()}}}")
            here = np.array([x, y])
        if abs(spin) > MIN_STEP:
            allowed = max(SPIN_ALLOWANCE * abs(spin) / top, MIN_SPIN_ALLOWANCE)
            lines.append(f"- {{action: Spin, target_yaw: {spin:.6f}, time_allowance: {allowed:.1f}}}")
    return lines


def commands(curve: Curve, rate: float = COMMAND_RATE) -> tuple[Floats, Floats]:
    """Return stamps (n,) [s] and twists (n, 2) [m/s, rad/s], each held until the next; the last one stops the robot.

    Each twist is the mean over its holding time, so distance and turn add up to those of the curve.
    """
    dt = np.diff(np.append(curve.starts, curve.duration))[:, None]
    done = np.vstack([np.zeros(2), np.cumsum(curve.twists * dt + 0.5 * curve.rates * dt * dt, axis=0)])
    n = int(np.ceil(curve.duration * rate - 1e-9))
    stamps = np.arange(n + 1) / rate
    at = np.minimum(stamps, curve.duration)
    k = np.clip(np.searchsorted(curve.starts, at, side="right") - 1, 0, len(curve.starts) - 1)
    within = (at - curve.starts[k])[:, None]
    total = done[k] + curve.twists[k] * within + 0.5 * curve.rates[k] * within * within  # (n + 1, 2) [m, rad]
    return stamps, np.vstack([np.diff(total, axis=0) * rate, np.zeros(2)])


def commands_csv(curve: Curve, rate: float = COMMAND_RATE) -> str:
    """Return `commands` as CSV with columns t, linear_x, angular_z: geometry_msgs/Twist to publish at stamp t."""
    stamps, twists = commands(curve, rate)
    rows = [f"{t:.3f},{v:.6f},{omega:.6f}" for t, (v, omega) in zip(stamps, twists.tolist(), strict=True)]
    return "\n".join(["t,linear_x,angular_z", *rows]) + "\n"
