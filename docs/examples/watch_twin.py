"""Watch a robot in MuJoCo that is carried away, meets a moved shelf, and gets a thumb on its laser."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import logs
import sensorgraph as sg
from logs.transforms import compose, invert
from sensorgraph.watching.observation import observations


def drive(arena, name):
    """Drive the plan in a MuJoCo world of an arena, and record it."""
    sg.export(arena, "mujoco", name)
    command = [sys.executable, f"{name}/drive.py", "plan", "-o", f"{name}.mcap"]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return logs.read(f"{name}.mcap")


# Build the graph of the office from a drive in MuJoCo.
sg.plan("office", views=16).save("plan")
graph = sg.build(drive("office", "yesterday"))

# Today a shelf stands 60 cm further into the room.
arena = json.loads(Path("plan/arena.geojson").read_text())
for feature in arena["features"]:
    if feature["properties"]["name"] == "shelf_1":
        (ring,) = feature["geometry"]["coordinates"]
        feature["geometry"]["coordinates"] = [[[x - 0.6, y] for x, y in ring]]
Path("today.geojson").write_text(json.dumps(arena))
run = drive("today.geojson", "today")
scans = list(observations(run))  # stamp, ranges, odometry, and the pose that the robot believes

# Somebody carries the robot away, as far as it drives in 25 s. Its belief goes on from where it was, until somebody corrects
# it after 20 s.
lifted, put = (int(np.searchsorted(run.stamps, t)) for t in (50.0, 75.0))
before, after = scans[lifted], scans[put]
carried = [
    replace(
        one,
        stamp=one.stamp - 25.0,
        odometry=compose(before.odometry, compose(invert(after.odometry), one.odometry)),
        believed=one.believed
        if one.stamp > after.stamp + 20.0
        else compose(before.believed, compose(invert(after.believed), one.believed)),
    )
    for one in scans[put:]
]

# In the last 15 s, a thumb covers 20 rays.
for k, one in enumerate(carried):
    if one.stamp > carried[-1].stamp - 15.0:
        covered = one.ranges.copy()
        covered[100:120] = 0.04
        carried[k] = replace(one, ranges=covered)

said = ("", "", "")
for status in sg.watch(graph, scans[:lifted] + carried):
    words = (status.pose.status, f"{len(status.changes)} changes", *(fault.name for fault in status.faults))
    if words != said:
        print(f"{status.t:.0f} s:", "; ".join(status.sentences()))
    said = words
