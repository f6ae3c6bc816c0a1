"""From a Nav2 robot to a calibrated MuJoCo twin: a drive, what map and robot.yaml lack, a twin that has it, the proof."""

import subprocess
import sys
from pathlib import Path

import sensorgraph as sg

# Your robot, in a few words; what is not said has a default.
Path("robot.yaml").write_text("{name: rover, sensor: {n_rays: 41, rate: 8.0}}\n")

# Some poses that show the whole room. plan/waypoints.yaml has the steps for Nav2's actions.
plan = sg.plan("square", robot="robot.yaml", views=5)
plan.save("plan")

# Drive, and log: `sensorgraph record --live --until-covered plan -o real.mcap`. Here the embedded robot stands in for
# yours; its laser reads 3 cm too far, and its wheels stand 3 % wider than robot.yaml says.
hidden = [sg.EFFECTS["range_bias"](b=0.03), sg.EFFECTS["wheel_base"](s=0.03)]
real = sg.record("plan", effects=hidden)

# What do the map and robot.yaml not explain?
found = sg.diagnose(real)
for effect in found.effects:
    print("the robot has:", effect)

# A world for MuJoCo that has it, too. drive.py drives the same plan there, and records.
left_out = sg.export("square", "mujoco", "twin", robot="robot.yaml", effects=found.effects)
for line in left_out:
    print("left to drive.py:", line)
subprocess.run([sys.executable, "twin/drive.py", "plan", "-o", "twin.mcap"], check=True, capture_output=True)

# Does the twin differ from the robot?
twin = sg.diagnose(real, simulation="twin.mcap")
print(twin)
