"""Identify a controller: fit polynomials of the robot's readings to its commands, then drive with them."""

import json
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import sensorgraph as sg
from sensorgraph.cli import run


def shell(command: str) -> None:
    """Run `sensorgraph ...` as in a shell, without its output."""
    with redirect_stdout(StringIO()):
        assert run(command.split()) == 0


# A wall follower drives round the square for four minutes. The plan only sets the start and the duration.
sg.plan("square", planner="wall_following", start=(1.0, 0.5, 0.0), duration=240.0).save("plan")
shell("record plan --arena square --controller wall_following --seed 4 -o wall.mcap")

# Explain each command by the mean range between 45 and 90 degrees, counted from the robot's right.
for name, signal in (("turn", "cmd_omega"), ("speed", "cmd_v")):
    found = sg.identify("wall.mcap", output=signal, inputs=["L45-90"], lags=1)
    print(found.model.equation(digits=3))
    print(f"  r on the held-out half: {found.scores['one_step'].r:.2f}\n")
    Path(f"{name}.json").write_text(json.dumps(found.report()))

# Drive with the two polynomials, from the same start, with other noise.
shell("record plan --arena square --controller turn.json,speed.json --seed 5 -o copy.mcap")
for label, log in (("wall follower", "wall.mcap"), ("polynomials", "copy.mcap")):
    drive = sg.read(log)
    nearest = drive.ranges.min(axis=1).mean()
    print(
        f"{label:<14} {drive.stamps[-1]:.0f} s, {nearest:.2f} m from the wall on average, {drive.meta['contacts']} contacts"
    )
