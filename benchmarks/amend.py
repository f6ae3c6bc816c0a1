"""Amended models driven again: numbers hidden in a MuJoCo twin, found by `diagnose`, written by `amend`.

    python -m benchmarks.amend -o DIR [--seeds 4]

A user's MJCF and the "real" robot differ by hidden numbers: laser mount, wheel radii, wheelbase, lag and dead time.
robot.yaml describes the MJCF. The lag that its velocity servo adds is measured by a step, and stated as dead time.
The real robot drives in the shipped square arena. `diagnose` gets its run, the map and the user's robot.yaml, and
`amend` writes what it found into the user's MJCF. All three models then repeat another drive of the real robot,
with its commands:

    gap = rms(run of the real robot - model) / rms(run of the real robot - real model),

for the ranges at the true poses, for the twist of the wheels, and for the final position of segments of 5 s. The
denominator is the noise floor: noise of the laser and of the encoders.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

import sensorgraph as sg
from benchmarks.arguments import heads, parser_of
from benchmarks.hidden_effects.geometry import interpolated
from logs.run import Run
from logs.transforms import compose, invert
from sensorgraph.data.export.drive_mujoco import MujocoWorld
from sensorgraph.exporting.twin import drive_twin
from sensorgraph.world.ray_intersection import nearest_walls
from sensorgraph.world.raycast import cast_laser
from sensorgraph.world.robot import Robot, parse_robot

ROBOT = """name: bot
footprint_radius: 0.2
limits: {v: 0.4, omega: 1.0, a: 0.5, alpha: 2.0}
sensor: {mount: [0.1, 0.0, 0.0], n_rays: 181, range_max: 8.0, sigma: 0.01, rate: 10, height: 0.3}
wheels: {radius: 0.10, base: 0.40, rate: 20}
actuators: {tau: 0.1, delay: 0.0}
"""
"""Without the lag of the servo."""
TRUTH_STEP = 0.01
"""[s] Step of the comparison."""
SEGMENT = 5.0
"""[s] Length of a repeated segment."""
WARM_UP = 2.0
"""[s] Time before a segment in which lag and delay settle."""
VIEWS = 24
"""Number of views of the drive that is diagnosed."""


@dataclass(frozen=True, kw_only=True)
class Numbers:
    """Numbers of one model."""

    mount: tuple[float, float, float] = (0.1, 0.0, 0.0)
    left: float = 0.10
    """[m] Radius."""
    right: float = 0.10
    base: float = 0.40
    tau: float = 0.1
    delay: float = 0.0


def mjcf(n: Numbers) -> str:
    """Return a robot with wheels, a caster ball, and a laser on a body for itself."""
    history = f' delay="{n.delay}" nsample="{round(n.delay / 0.001) + 2}"' if n.delay else ""
    wheels = "".join(
        f"""
      <body name="{side}_wheel" pos="0 {y} {radius - 0.1}">
        <joint name="{side}_wheel" type="hinge" axis="0 1 0" armature="0.01"/>
        <geom type="ellipsoid" size="{radius} 0.02 {radius}" mass="0.5" friction="2 0.005 0.0001"
              solref="0.002 1" priority="1"/>
      </body>"""
        for side, y, radius in (("left", n.base / 2, n.left), ("right", -n.base / 2, n.right))
    )
    motors = "".join(
        f"""
    <general name="{side}" joint="{side}_wheel" gainprm="20" biastype="affine" biasprm="0 0 -20"
             dyntype="filterexact" dynprm="{n.tau}"{history}/>"""
        for side in ("left", "right")
    )
    return f"""<mujoco model="bot">
  <compiler angle="radian"/>
  <option timestep="0.001" cone="elliptic" impratio="200" integrator="implicitfast"/>
  <worldbody>
    <geom type="plane" size="20 20 .1"/>
    <body name="base_link" pos="0 0 0.1">
      <freejoint name="base"/>
      <geom type="cylinder" size="0.19 0.05" pos="0 0 0.02" mass="10" contype="0" conaffinity="0"/>
      <geom type="sphere" size="0.02" pos="0.15 0 -0.08" mass="0.05" friction="0 0 0" condim="1" priority="1"/>
      <geom type="sphere" size="0.02" pos="-0.15 0 -0.08" mass="0.05" friction="0 0 0" condim="1" priority="1"/>{wheels}
      <body name="laser" pos="{n.mount[0]} {n.mount[1]} 0.2" euler="0 0 {n.mount[2]}"> <!-- data sheet -->
        <site name="ray" zaxis="1 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator>{motors}
  </actuator>
  <sensor>
    <rangefinder name="scan" site="ray" cutoff="8"/>
  </sensor>
</mujoco>
"""


class Twin(MujocoWorld):
    """A model driven by twists; its controller assumes the radius and the wheelbase of robot.yaml."""

    has_motors = True
    walls: np.ndarray

    def __init__(self, text: str, robot: Robot) -> None:
        self.robot, self.model = robot, mujoco.MjModel.from_xml_string(text)
        self.data = mujoco.MjData(self.model)

    @property
    def mount(self) -> np.ndarray:
        """(3,) [m, m, rad] Laser in base_link."""
        laser = self.model.body("laser")
        return np.array([*laser.pos[:2], 2 * np.arctan2(laser.quat[3], laser.quat[0])])

    def cast(self, ox: np.ndarray, oy: np.ndarray, ux: np.ndarray, uy: np.ndarray) -> np.ndarray:
        """Cast rays; the walls are those of the arena."""
        ranges, _ = nearest_walls(self.walls, *(part.ravel() for part in (ox, oy, ux, uy)))
        return ranges.reshape(ox.shape)


def with_servo_lag(robot: Robot) -> Robot:
    """Return the robot with the dead time of its own MJCF, which only has a filter and a velocity servo.

    After a step of the command, the mean time of the response ∫ (1 - v / v_end) dt is the time constant of the filter
    plus the lag of the servo.
    """
    twin, v, step = Twin(mjcf(Numbers()), robot), 0.2, 0.001
    twin.place(np.zeros(3))
    speeds = np.array([twin.step(v, 0.0, step)[1][0] for _ in range(round(20 * robot.actuators.tau / step))])
    mean_time = float(np.sum(1 - speeds / speeds[-1]) * step)
    return replace(robot, actuators=replace(robot.actuators, delay=mean_time - robot.actuators.tau))


def draw(rng: np.random.Generator) -> Numbers:
    """Draw the hidden numbers, some three to eight times what a careful setup has."""

    def sign() -> float:
        return float(rng.choice([-1.0, 1.0]))

    mean, diff = 0.1 / (1 + sign() * rng.uniform(0.012, 0.03)), sign() * rng.uniform(0.006, 0.012)
    return Numbers(
        mount=(
            0.1 + sign() * rng.uniform(0.015, 0.03), sign() * rng.uniform(0.015, 0.03), sign() * rng.uniform(0.01, 0.03),
        ),
        left=mean * (1 + diff / 2), right=mean * (1 - diff / 2), base=0.4 / (1 + sign() * rng.uniform(0.015, 0.04)),
        tau=0.1 + rng.uniform(0.06, 0.12), delay=round(rng.uniform(0.06, 0.12), 3),
    )  # fmt: skip


def drive(text: str, robot: Robot, arena: sg.Arena, seed: int, views: int) -> tuple[Run, Twin]:
    """Drive a plan in the model and record it with the model's laser."""
    twin = Twin(text, robot)
    twin.walls = arena.walls
    placed = replace(robot, sensor=replace(robot.sensor, mount=twin.mount))
    plan = sg.plan(arena, robot, views=views, seed=seed)
    run = drive_twin(twin, plan.trajectory, arena, placed, (), seed=seed)
    return replace(run, sensor=robot.sensor), twin


def repeat(twin: Twin, run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Repeat the commands of a run in segments; return twists at the odometry stamps, and final positions."""
    twists, ends = [], []
    starts = np.arange(WARM_UP, run.cmd_stamps[-1] - SEGMENT, SEGMENT)
    for start in starts:
        first = np.searchsorted(run.cmd_stamps, start - WARM_UP)
        begin = run.cmd_stamps[first]
        twin.place(run.poses_at(begin))
        stamps, poses, speeds = [], [], []
        for k in range(round((SEGMENT + WARM_UP) / TRUTH_STEP)):
            t = begin + k * TRUTH_STEP
            command = run.commands[np.searchsorted(run.cmd_stamps, t + 1e-9, side="right") - 1]
            pose, twist = twin.step(*command, TRUTH_STEP)
            stamps.append(t + TRUTH_STEP)
            poses.append(pose)
            speeds.append(twist)
        at = run.odom_stamps[(run.odom_stamps >= start) & (run.odom_stamps < start + SEGMENT)]
        # an encoder shows the mean over its period
        means = (np.array(speeds) + np.array([speeds[0], *speeds[:-1]])) / 2
        travelled = np.cumsum(means * TRUTH_STEP, axis=0)
        rate = 1 / float(np.median(np.diff(run.odom_stamps)))
        before, after = (interpolated(t, np.array(stamps), travelled) for t in (at - 1 / rate, at))
        twists.append((after - before) * rate)
        a, b = (interpolated(t, np.array(stamps), np.array(poses)) for t in (start, start + SEGMENT))
        ends.append(compose(invert(a), b))
    return np.concatenate(twists), np.array(ends)


def errors(run: Run, twin: Twin, arena: sg.Arena) -> np.ndarray:
    """Return the rms of ranges [m], twist in standard deviations, and position and heading of segments."""
    lasers = compose(run.poses_at(run.stamps), twin.mount)
    off = run.ranges - cast_laser(arena.walls, lasers, run.sensor.bearings, np.inf)[0]
    off = off[np.isfinite(off)]
    twists, ends = repeat(twin, run)
    starts = np.arange(WARM_UP, run.cmd_stamps[-1] - SEGMENT, SEGMENT)
    inside = np.concatenate(
        [np.flatnonzero((run.odom_stamps >= t) & (run.odom_stamps < t + SEGMENT)) for t in starts]
    )
    wheels = twin.robot.wheels
    twist_off = (run.odom_twists[inside] - twists) / [wheels.sigma_v, wheels.sigma_omega]
    end_off = ends - compose(invert(run.poses_at(starts)), run.poses_at(starts + SEGMENT))
    # a ray that passes an edge differs by metres, so that the median of the squares would hide it and the mean is all of it
    limited = np.minimum(np.abs(off), 0.05)
    return np.sqrt([np.mean(each**2) for each in (limited, twist_off, end_off[:, :2], end_off[:, 2])])


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for models and reports")
    parser.add_argument("--seeds", type=int, default=4)
    args = parser.parse_args()
    robot, arena = with_servo_lag(parse_robot(ROBOT)), sg.load_arena("square")
    print(f"the user's model: dead time {1e3 * robot.actuators.delay:.1f} ms")
    args.out.mkdir(parents=True, exist_ok=True)
    print(heads("seed", "", "ranges", "twist", "position after 5 s", "heading after 5 s", text=2))
    for seed in range(args.seeds):
        hidden = draw(np.random.default_rng([56, seed]))
        user = args.out / f"bot_{seed}.xml"
        user.write_text(mjcf(Numbers()), encoding="utf-8")
        real = mjcf(hidden)
        run, _ = drive(real, robot, arena, seed=2 * seed, views=VIEWS)
        report = sg.diagnose(run, arena=arena, robot=robot)
        effects = report.effects
        found = sg.amend(user, effects)
        (args.out / f"bot_{seed}.diff").write_text(found.diff, encoding="utf-8")
        amended = found.files[0].text.decode()
        (args.out / f"amended_{seed}.xml").write_text(amended, encoding="utf-8")
        other, twin = drive(real, robot, arena, seed=2 * seed + 1, views=VIEWS // 2)
        floor = errors(other, twin, arena)
        print(f"| {seed} | floor | {' | '.join(f'{one:.2g}' for one in floor)} |")
        for name, text in (("user's model", mjcf(Numbers())), ("amended", amended)):
            gap = errors(other, Twin(text, robot), arena) / floor
            print(f"| {seed} | {name} | {' | '.join(f'{one:.3f}' for one in gap)} |")
        print(f"<!-- hidden {hidden}; found {effects}; left out {found.left_out} -->")


if __name__ == "__main__":
    main()
