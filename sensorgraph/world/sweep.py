"""How long a laser sweeps, where a robot file and a log may disagree."""

from __future__ import annotations

import math
from dataclasses import replace

from logs.run import RangeSensor, Run, rare_times
from logs.sweep import differs
from sensorgraph.world.robot import Robot


def sweep_warning(run: Run, robot: Robot, *, name: str = "robot.yaml") -> str | None:
    """Say where a robot file and a log disagree about how long a sweep of the laser takes; None where they agree."""
    logged, described = run.sensor, robot.sensor
    if differs(abs(logged.sweep_time), described.sweep_time):
        return (
            f"the log says that a sweep takes {abs(logged.sweep_time):.3g} s, sensor.sweep_time of {name} is "
            f"{described.sweep_time:.3g} s, which counts"
        )
    if rare_times(logged) == rare_times(described):
        return None
    return f"the log says that {_rare_text(logged)}, {name} that {_rare_text(described)}; {name} counts"


def _rare_text(sensor: RangeSensor) -> str:
    said = f"ray 0 is {sensor.first_ray_delay:.3g} s after the stamp"
    if sensor.interlaced_sweeps == 1:
        return f"one sweep makes a scan and {said}"
    return f"{sensor.interlaced_sweeps} sweeps {sensor.sweep_period:.3g} s apart make a scan and {said}"


def with_sweep_of(run: Run, robot: Robot) -> Run:
    """Return a run whose laser sweeps for as long as a robot file says, in the direction that the log says.

    Drivers often leave `time_increment` at 0, or get it wrong. The stamp of a scan is that of ray 0, which a clockwise laser
    takes last: it comes later by what the sweep is longer.
    """
    if sweep_warning(run, robot) is None:
        return run
    said, logged = robot.sensor, run.sensor
    longer = said.sweep_time - abs(logged.sweep_time) if logged.is_clockwise else 0.0
    return replace(
        run,
        stamps=run.stamps + longer * (logged.n_rays - 1) / logged.n_rays,
        sensor=replace(
            run.sensor,
            sweep_time=math.copysign(said.sweep_time, run.sensor.sweep_time),
            interlaced_sweeps=said.interlaced_sweeps,
            sweep_period=said.sweep_period,
            first_ray_delay=said.first_ray_delay,
        ),
    )
