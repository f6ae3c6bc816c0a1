"""From Nav2 and back: plan on a ROS map, drive with Nav2's actions, and plan the missing bins of a cut run."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml
from PIL import Image

import sensorgraph as sg

# The files that `ros2 run nav2_map_server map_saver_cli -f lab` writes, here for a room of 3 m x 2.5 m.
cells = np.full((60, 70), 205, dtype=np.uint8)  # unknown
cells[5:55, 5:65] = 254  # free
cells[[4, 55], 4:66] = cells[4:56, [4, 65]] = 0  # walls
cells[25:33, 30:40] = 0  # a table
Image.fromarray(cells).save("lab.pgm")
Path("lab.yaml").write_text(
    "{image: lab.pgm, resolution: 0.05, origin: [0, 0, 0], negate: 0, occupied_thresh: 0.65, free_thresh: 0.25}\n"
)

# Plan steps that Nav2 can drive: straight lines and turns on the spot.
plan = sg.plan("lab.yaml", planner="stop_and_spin", cell=0.5, headings=8)
print(plan)
plan.save("plan")
steps = yaml.safe_load(Path("plan/waypoints.yaml").read_text())["steps"]
print(f"\n{len(steps)} steps for Nav2; the first three:")
for step in steps[:3]:
    print(" ", step)

# Drive. Your robot logs with `ros2 bag record`; here the simulated robot logs until its battery is empty.
run = sg.record("plan")
half = run.n_scans // 2
broken = replace(run, stamps=run.stamps[:half], ranges=run.ranges[:half])
print(f"\nlogged {half} of {run.n_scans} scans")

# Plan the missing bins: the logged poses count as visits, on the plan or off it.
rest = sg.plan("lab.yaml", resume=broken, planner="stop_and_spin", cell=0.5, headings=8)
print(rest)

# Build from the first half, and plan the bins with the largest expected error of this graph first.
graph = sg.build(broken)
following = sg.plan("lab.yaml", priority=graph, budget=60.0, cell=0.5, headings=8)
print("\nlargest expected error first, one minute:")
print(following)
