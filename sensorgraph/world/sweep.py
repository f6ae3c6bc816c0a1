"""Sweep time of a laser, where robot.yaml and log may disagree."""

from __future__ import annotations

import math
from dataclasses import replace

from logs.run import RangeSensor, Run, rare_times
from logs.sweep import differs
from sensorgraph.world.robot import Robot


def sweep_warning(run: Run, robot: Robot, *, name: str = "robot.yaml") -> str | None:
    """Return a warning if robot.yaml and log disagree about the ray times; None if they agree."""
    logged, described = run.sensor, robot.sensor
    if differs(abs(logged.sweep_time), described.sweep_time):
        return (
            f"a sweep takes {abs(logged.sweep_time):.3g} s in the log and {described.sweep_time:.3g} s in {name} "
            f"(`sensor.sweep_time`), which is used"
        )
    if rare_times(logged) == rare_times(described):
        return None
    return f"the log has {_rare_text(logged)}; {name} has {_rare_text(described)}, which is used"


def _rare_text(sensor: RangeSensor) -> str:
    delay = f"ray 0 at {sensor.first_ray_delay:.3g} s after the stamp"
    if sensor.interlaced_sweeps == 1:
        return f"one sweep per scan and {delay}"
    return f"{sensor.interlaced_sweeps} sweeps per scan, {sensor.sweep_period:.3g} s apart, and {delay}"


def with_sweep_of(run: Run, robot: Robot) -> Run:
    """Return a run with the sweep time of robot.yaml and the sweep direction of the log.

    Drivers often leave `time_increment` at 0, or set a wrong value. The stamp of a scan is that of ray 0,
    which a clockwise laser takes last; it is later by the additional sweep time.
    """
    if sweep_warning(run, robot) is None:
        return run
    described, logged = robot.sensor, run.sensor
    longer = described.sweep_time - abs(logged.sweep_time) if logged.is_clockwise else 0.0
    return replace(
        run,
        stamps=run.stamps + longer * (logged.n_rays - 1) / logged.n_rays,
        sensor=replace(
            run.sensor,
            sweep_time=math.copysign(described.sweep_time, run.sensor.sweep_time),
            interlaced_sweeps=described.interlaced_sweeps,
            sweep_period=described.sweep_period,
            first_ray_delay=described.first_ray_delay,
        ),
    )
