"""From a plan to a sensorgraph: plan, record, build, evaluate, predict, review."""

from pathlib import Path

import numpy as np

import sensorgraph as sg

here = Path(__file__).parent
arena, robot = sg.load_arena(here / "lab.geojson"), sg.load_robot(here / "robot.yaml")

# Plan: every reachable place in every heading. Coarse bins keep the drive short.
plan = sg.plan(arena, robot, cell=0.5, headings=8)
print(f"{plan}\n")

# Record: the simulated robot drives the plan, with lag, drift and noise. Or log your own robot.
run = sg.record(plan, path="run.mcap")
print(f"{run.n_scans} scans of {run.sensor.n_rays} rays")

# Build: identify the faces that stop rays, and from them the equation of every ray.
graph = sg.build("run.mcap")
graph.save(Path("lab.sensorgraph"))
print("\nThe ray straight ahead, on the first face (c and s: cosine and sine of phi):")
print("\n".join(graph.equation(90).splitlines()[2:5]) + "\n")

# Evaluate: score the graph on a run that it has not seen.
other = sg.record(sg.plan(arena, robot, cell=0.5, headings=8, seed=1), seed=1)
evaluation = sg.evaluate(graph, other)
print(f"answered                    {100 * evaluation.answered:.1f} %")
print(f"median error                {100 * evaluation.all['median_m']:.1f} cm; sensor noise 1 cm")
print(f"answered and within 10 cm   {100 * evaluation.answered_only['within_0.1m']:.1f} %\n")

# Predict: any pose, also one that the robot has never visited.
pose = [3.0, 1.0, np.pi / 2]
predicted = sg.predict(graph, pose)
print(f"at {pose[0]:.1f}, {pose[1]:.1f}, heading north, the ray ahead is {predicted.ranges[0, 90]:.3f} m")
print(f"sigma {predicted.sigma[0, 90]:.3f} m, answered: {predicted.answered[0, 90]}")

# Review: open it with `rerun review.rrd`.
sg.review(run, "review.rrd", graph=graph, plan=plan)
