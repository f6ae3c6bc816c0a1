"""Inspect a real log, build from one part of it, and evaluate on another.

For your own log (MCAP, bag, CARMEN, CSV), run: python real_log.py intel.log.gz
"""

import sys
from pathlib import Path

import numpy as np

import sensorgraph as sg
from logs.inspection import inspect

NO_RETURN = 81.91  # [m] value that a SICK scanner writes for a missing return


def write_carmen_log(path: Path) -> None:
    """Write a log as CARMEN does: 180 rays, poses of the laser from SLAM, no map, no datasheet."""
    plan = sg.plan("square", cell=1.0, headings=8)
    run = sg.record(plan, seed=7)
    rng = np.random.default_rng(7)
    with path.open("w") as file:
        for k in range(0, run.n_scans, 2):
            x, y, phi = run.poses[3 * k] + rng.normal(0, [0.01, 0.01, 0.002])
            laser = x + 0.1 * np.cos(phi), y + 0.1 * np.sin(phi), phi  # the laser is 10 cm ahead of the base
            ranges = np.where(run.ranges[k, :180] < 4.0, run.ranges[k, :180], NO_RETURN)
            readings = " ".join(f"{r:.2f}" for r in ranges)
            poses = " ".join(f"{value:.4f}" for value in (*laser, *run.odometry[2 * k]))
            stamp = f"{run.stamps[k]:.3f}"
            file.write(f"FLASER 180 {readings} {poses} {stamp} host {stamp}\n")


if len(sys.argv) > 1:
    log = Path(sys.argv[1])
else:
    log = Path("carmen.log")
    write_carmen_log(log)

# Inspect the log before you build: usable topics, missing topics, warnings.
found = inspect(log)
for title, lines in (("usable", found.usable), ("missing", found.missing), ("warnings", found.warnings)):
    print(title, *lines, sep="\n  ")
print(f"{found.pairing}\n")

# Hold out five stretches of the log, build from the rest, and score the held-out stretches.
graph = sg.build(log, split="block")
graph.save(Path("carmen.sensorgraph"))
evaluation = sg.evaluate(graph, log, split="block")
print(f"model {graph.model.name}; poses of the {graph.pose_frame}")
print(f"scored {evaluation.n_rays:,} rays, answered {100 * evaluation.answered:.1f} %")
print(f"median error     {100 * evaluation.all['median_m']:.1f} cm")
print(f"within 10 cm     {100 * evaluation.all['within_0.1m']:.1f} %")
print(f"... answered     {100 * evaluation.answered_only['within_0.1m']:.1f} %")
