"""Calibrate a MuJoCo twin of a Nav2 robot: drive, find the missing effects, export them, and compare."""

import subprocess
import sys
from pathlib import Path

import sensorgraph as sg

# Describe your robot; omitted values have defaults.
Path("robot.yaml").write_text("{name: rover, sensor: {n_rays: 41, rate: 8.0}}\n")

# Plan a few poses that show the whole room. plan/waypoints.yaml has the steps for Nav2's actions.
plan = sg.plan("square", robot="robot.yaml", views=5)
plan.save("plan")

# Drive and log: `sensorgraph record --live --until-covered plan -o real.mcap`. Here a simulated robot replaces
# yours. Its laser reads 3 cm too far, and its wheelbase is 3 % larger than in robot.yaml.
hidden = [sg.EFFECTS["range_bias"](b=0.03), sg.EFFECTS["wheel_base"](s=0.03)]
real = sg.record("plan", effects=hidden)

# Find the effects that the map and robot.yaml do not explain.
found = sg.diagnose(real)
for effect in found.effects:
    print("the robot has:", effect)

# Export a MuJoCo world with these effects. drive.py drives the same plan there and records it.
left_out = sg.export("square", "mujoco", "twin", robot="robot.yaml", effects=found.effects)
for line in left_out:
    print("left to drive.py:", line)
subprocess.run(
    [sys.executable, "twin/drive.py", "plan", "-o", "twin.mcap"], check=True, stdout=subprocess.DEVNULL
)

# Compare the twin with the robot.
twin = sg.diagnose(real, simulation="twin.mcap")
print(twin)
