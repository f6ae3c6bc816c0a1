"""Plans for others: waypoints as Nav2 takes them. The trajectory writes its own CSV."""

from __future__ import annotations

import numpy as np

from planners.planning import Plan


def waypoints(plan: Plan) -> str:
    """Return the stops as YAML: poses as geometry_msgs/Pose in frame map, each with the spin made on arrival.

    Nav2's path followers leave out turns on the spot; `spin` [rad, relative, maybe more than a full turn] is what
    its Spin behaviour takes as `target_yaw`.
    """
    lines = ["frame_id: map", "poses:"]
    end = plan.trajectory.poses[-1]
    for x, y, phi, spin in [*plan.stops.tolist(), [*end.tolist(), 0.0]]:
        z, w = np.sin(phi / 2), np.cos(phi / 2)
        lines.append(
            f"- {{position: {{x: {x:.6f}, y: {y:.6f}, z: 0.0}}, "
            f"orientation: {{x: 0.0, y: 0.0, z: {z:.9f}, w: {w:.9f}}}, spin: {spin:.6f}}}"
        )
    return "\n".join(lines) + "\n"
