"""A real log: look at it, build from one part, evaluate on another.

Give a log of your own (MCAP, bag, CARMEN, CSV): python real_log.py intel.log.gz
"""

import sys
from pathlib import Path

import numpy as np

import sensorgraph as sg
from logs.inspection import inspect

NOTHING_SEEN = 81.91  # what a SICK scanner writes then


def write_carmen_log(path: Path) -> None:
    """Write a log such as CARMEN wrote: 180 rays, poses of the laser from SLAM, no map, no datasheet."""
    plan = sg.plan("square", cell=1.0, headings=8)
    run = sg.record(plan, seed=7)
    rng = np.random.default_rng(7)
    with path.open("w") as file:
        for k in range(0, run.n_scans, 2):
            x, y, phi = run.poses[3 * k] + rng.normal(0, [0.01, 0.01, 0.002])
            laser = x + 0.1 * np.cos(phi), y + 0.1 * np.sin(phi), phi  # it sits 10 cm ahead
            ranges = np.where(run.ranges[k, :180] < 4.0, run.ranges[k, :180], NOTHING_SEEN)
            readings = " ".join(f"{r:.2f}" for r in ranges)
            poses = " ".join(f"{value:.4f}" for value in (*laser, *run.odometry[2 * k]))
            stamp = f"{run.stamps[k]:.3f}"
            file.write(f"FLASER 180 {readings} {poses} {stamp} host {stamp}\n")


if len(sys.argv) > 1:
    log = Path(sys.argv[1])
else:
    log = Path("somebody.log")
    write_carmen_log(log)

# Look before you build: what is usable, what is missing, what looks wrong.
found = inspect(log)
for title, lines in (("usable", found.usable), ("missing", found.missing), ("warnings", found.warnings)):
    print(title, *lines, sep="\n  ")
print(f"{found.pairing}\n")

# Hold five stretches out of the log, build from the rest, and score the stretches.
graph = sg.build(log, split="block")
graph.save(Path("somebody.sensorgraph"))
evaluation = sg.evaluate(graph, log, split="block")
print(f"model {graph.model.name}; poses of the {graph.pose_frame}")
print(f"scored {evaluation.n_rays:,} rays, answered {100 * evaluation.answered:.1f} %")
print(f"median error     {100 * evaluation.all['median_m']:.1f} cm")
print(f"within 10 cm     {100 * evaluation.all['within_0.1m']:.1f} %")
print(f"... if answered  {100 * evaluation.answered_only['within_0.1m']:.1f} %")
