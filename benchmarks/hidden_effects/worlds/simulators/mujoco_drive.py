"""A two-wheeled base on a floor, driven by contact forces: MuJoCo makes slip, lag and load transfer, not this file."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from benchmarks.hidden_effects.geometry import interpolated, wrapped
from benchmarks.hidden_effects.log import Floats
from benchmarks.hidden_effects.worlds.simulators.hidden import Secrets
from benchmarks.hidden_effects.worlds.simulators.rooms import Pilot

STEP = 0.002
"""[s] of the physics."""
TAU = 0.09
"""[s] time constant of the wheels' velocity loops."""
MASS = 14.0
"""[kg]"""
LASER_HEIGHT = 0.30


@dataclass(frozen=True, kw_only=True)
class Base:
    """A base as built, and what its robot.yaml will say."""

    radius: float = 0.10
    base: float = 0.40
    control_period: float = 0.02
    """[s] of the loop that reads commands: 50 Hz."""
    transport: float = 0.004
    """[s] mean and scatter of a command's way to the base."""
    tick: float = 0.001
    """[m] of one encoder tick at the rim."""
    odom_rate: float = 20.0
    integration: str = "midpoint"
    """`rectangle`, `midpoint` or `exact`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Driven:
    """A drive as it truly was, at the steps of the physics."""

    times: Floats
    poses: Floats
    """(n, 3) of base_link."""
    wheels: Floats
    """(n, 2) [rad] left and right wheel."""
    cmd_stamps: Floats
    commands: Floats

    def pose_at(self, when: Floats) -> Floats:
        """Return poses (..., 3), phi unwrapped."""
        return interpolated(when, self.times, self.poses)

    def wheels_at(self, when: Floats) -> Floats:
        """Return wheel angles (..., 2) [rad]."""
        return interpolated(when, self.times, self.wheels)


def model_xml(base: Base, secrets: Secrets) -> str:
    """Return the MJCF of floor and robot."""
    diff = secrets.value("wheel_radius_diff", "s")
    scale = 1 + secrets.value("wheel_radius", "s")
    left, right = base.radius / scale * (1 + diff / 2), base.radius / scale * (1 - diff / 2)
    half = base.base / (1 + secrets.value("wheel_base", "s")) / 2
    # one time constant along and about: the mass sits at the wheels
    inertia = MASS * half**2
    load = MASS * base.radius**2 / 2 + 0.5 * 0.4 * base.radius**2
    tau = TAU + secrets.value("actuator_lag", "tau")
    slope, towards = secrets.value("tilted_floor", "slope"), secrets.value("tilted_floor", "towards")
    gx, gy = 9.81 * np.sin(slope) * np.array([np.cos(towards), np.sin(towards)])

    def wheel(name: str, y: float, r: float) -> str:
        return (
            f'<body name="{name}" pos="0 {y:.6f} {r - base.radius:.6f}"><joint name="{name}" type="hinge" axis="0 1 0"/>'
            f'<geom type="ellipsoid" size="{r:.6f} 0.012 {r:.6f}" mass="0.4" friction="1.1 0.002 0.0001"/></body>'
        )

    def caster(x: float) -> str:
        return (
            f'<geom type="sphere" size="0.03" pos="{x} 0 {0.03 - base.radius}" mass="0.05" '
            'condim="1" priority="1"/>'
        )

    return f"""<mujoco>
  <option timestep="{STEP}" integrator="Euler" cone="elliptic" impratio="20" gravity="{gx} {gy} -9.81"/>
  <worldbody>
    <geom type="plane" size="30 30 0.1" friction="1 0.005 0.0001"/>
    <body name="robot" pos="0 0 {base.radius}"><freejoint/>
      <inertial pos="0 0 0.02" mass="{MASS}" diaginertia="{0.6 * inertia} {0.6 * inertia} {inertia}"/>
      {wheel("left", half, left)}{wheel("right", -half, right)}{caster(0.15)}{caster(-0.15)}
    </body>
  </worldbody>
  <actuator><velocity joint="left" kv="{load / tau}"/><velocity joint="right" kv="{load / tau}"/></actuator>
</mujoco>"""


def drive(base: Base, pilot: Pilot, secrets: Secrets, duration: float, rng: np.random.Generator) -> Driven:
    """Let the pilot steer for `duration` [s]; commands wait for the next tick of the base."""
    model = mujoco.MjModel.from_xml_string(model_xml(base, secrets))
    data = mujoco.MjData(model)
    start = pilot.start()
    data.qpos[:2], data.qpos[3], data.qpos[6] = start[:2], np.cos(start[2] / 2), np.sin(start[2] / 2)
    n = round(duration / STEP)
    poses, wheels = np.zeros((n, 3)), np.zeros((n, 2))
    per_command, per_tick = round(pilot.period / STEP), round(base.control_period / STEP)
    phase = int(rng.integers(per_tick))
    queue: list[tuple[float, tuple[float, float]]] = []
    stamps, commands = [], []
    now = (0.0, 0.0)
    late, phi = secrets.value("dead_time", "L"), start[2]
    payload = secrets.get("payload")
    body = model.body("robot").id
    for k in range(n):
        t = k * STEP
        pose = np.array([data.qpos[0], data.qpos[1], 2 * np.arctan2(data.qpos[6], data.qpos[3])])
        phi += wrapped(float(pose[2] - phi))
        poses[k], wheels[k] = (pose[0], pose[1], phi), data.qpos[7:9]
        if k % per_command == 0:
            sent = pilot.command(poses[k])
            stamps.append(t)
            commands.append(sent)
            queue.append((t + late + base.transport * (1 + 0.5 * abs(rng.normal())), sent))
        if k % per_tick == phase:
            while queue and queue[0][0] <= t:
                now = queue.pop(0)[1]
            data.ctrl[:] = _set_points(now, base, secrets)
        if payload is not None and k == round(payload["when"] * n):
            model.body_mass[body] *= payload["factor"]
            model.body_inertia[body] *= payload["factor"]
        _drag(data, body, phi, secrets)
        mujoco.mj_step(model, data)
    return Driven(
        times=np.arange(n) * STEP,
        poses=poses,
        wheels=wheels,
        cmd_stamps=np.array(stamps),
        commands=np.array(commands),
    )


def _set_points(command: tuple[float, float], base: Base, secrets: Secrets) -> Floats:
    """Return the speeds [rad/s] that the firmware asks of the left and the right wheel."""
    v, omega = command
    v = float(np.clip(v, *(np.array([-1, 1]) * secrets.value("speed_saturation", "v_max", 9.0))))
    rim = np.array([v - omega * base.base / 2, v + omega * base.base / 2])
    return np.where(np.abs(rim) < secrets.value("stiction", "v"), 0.0, rim) / base.radius


def _drag(data: mujoco.MjData, body: int, phi: float, secrets: Secrets) -> None:
    """Let a jammed caster, 0.15 m behind and 0.1 m to the left, drag on the floor."""
    force = secrets.value("caster_drag", "force")
    if not force:
        return
    ahead = np.array([np.cos(phi), np.sin(phi)])
    v = float(data.qvel[:2] @ ahead)
    push = -force * np.tanh(v / 0.02)
    data.xfrc_applied[body, :2] = push * ahead
    data.xfrc_applied[body, 5] = -0.1 * push


def bench_test(base: Base) -> tuple[float, float, float, float]:
    """Measure what a careful user would: rolling radius, track, time constant and dead time, on an empty floor.

    Returns
    -------
    (radius [m], base [m], tau [s], delay [s])
    """
    turns = []
    for v, omega in ((0.3, 0.0), (0.0, 0.8)):
        pilot = _Steps(v, omega)
        turns.append(drive(base, pilot, Secrets(), 6.0, np.random.default_rng(1)))  # type: ignore[arg-type]
    straight, spin = turns
    k0, k1 = round(2.0 / STEP), round(5.9 / STEP)
    way = float(np.hypot(*(straight.poses[k1, :2] - straight.poses[k0, :2])))
    radius = way / float(np.mean(straight.wheels[k1] - straight.wheels[k0]))
    rim = radius * float(np.diff(spin.wheels[k1] - spin.wheels[k0])[0])
    track = rim / float(spin.poses[k1, 2] - spin.poses[k0, 2])
    speed = np.gradient(straight.wheels.mean(axis=1) * radius, STEP)
    t = straight.times - 1.0
    best = (np.inf, TAU, 0.0)
    for tau in np.arange(0.06, 0.16, 0.0025):
        for delay in np.arange(0.0, 0.05, 0.0025):
            fit = 0.3 * (1 - np.exp(-np.maximum(t - delay, 0) / tau))
            best = min(best, (float(np.square(speed - fit).sum()), float(tau), float(delay)))
    return radius, track, best[1], best[2]


class _Steps:
    """Stand for a second, then drive at once as fast as asked."""

    period = 0.05

    def __init__(self, v: float, omega: float) -> None:
        self.v, self.omega, self.k = v, omega, -1

    def start(self) -> Floats:
        return np.zeros(3)

    def command(self, pose: Floats) -> tuple[float, float]:
        self.k += 1
        return (self.v, self.omega) if self.k * self.period >= 1.0 else (0.0, 0.0)
