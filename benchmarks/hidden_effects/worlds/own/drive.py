"""The drive: a random errand through the room, carried out by motors and wheels."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
import shapely

from benchmarks.hidden_effects.geometry import Room, interpolated, largest_part
from benchmarks.hidden_effects.log import Floats
from benchmarks.hidden_effects.worlds.own.robot import COMMAND_PERIOD, BaseLoop, RobotSpec

SIMULATION_STEP = 0.01
"""[s] of the integrated truth."""
CLEARANCE = 0.32
"""[m] the errand keeps from walls."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Leg:
    """One part of an errand: drive to a point, turn by an angle, or wait."""

    kind: str
    """goto | back | spin | pause"""
    target: tuple[float, float] = (0.0, 0.0)
    amount: float = 0.0
    """spin: [rad], signed; pause: [s]; back: [m]"""
    speed: float = 0.3
    """goto, back: [m/s]; spin: [rad/s]"""
    is_arc: bool = False
    """Turn while driving rather than in place."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrueMotors:
    """What stands between command and wheel, and between wheel and body."""

    tau: float
    """[s] of the first-order motors."""
    dead_time: float = 0.0
    """[s]"""
    v_max: float = math.inf
    """[m/s] the wheels reach."""
    slip: float = 0.0
    """Relative loss of body motion inside `slip_patch`."""
    slip_patch: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """x, y, r [m]"""
    late_gain: tuple[float, float] = (math.inf, 1.0)
    """After this time [s] the motors reach this share of the command."""
    backlash: float = 0.0
    """[rad/s] turn commands below this do nothing."""
    base_loop: BaseLoop | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class TrueDrive:
    """What the robot truly did."""

    stamps: Floats
    """(n,) [s], every SIMULATION_STEP."""
    poses: Floats
    """(n, 3) [m, m, rad] base_link in map, phi not wrapped."""
    wheels: Floats
    """(n, 2) [m/s, rad/s] as the wheels turn."""
    cmd_stamps: Floats
    commands: Floats
    """(n_commands, 2) [m/s, rad/s] set points."""

    def at(self, stamps: Floats) -> Floats:
        """Interpolate poses (..., 3) at stamps (...) [s]."""
        return interpolated(stamps, self.stamps, self.poses)

    def travelled(self, stamps: Floats) -> Floats:
        """Return way and turn of the wheels (n, 2) [m, rad] up to stamps (n,) [s]."""
        total = np.concatenate(
            [np.zeros((1, 2)), np.cumsum((self.wheels[1:] + self.wheels[:-1]) / 2 * SIMULATION_STEP, axis=0)]
        )
        return interpolated(stamps, self.stamps, total)


@dataclass(eq=False)
class Errand:
    """Legs drawn on demand, so that a trip fills any duration."""

    room: Room
    rng: np.random.Generator
    tight: shapely.Geometry = field(init=False)
    wide: shapely.Geometry = field(init=False)
    seen: list[Floats] = field(default_factory=list)
    queue: deque[Leg] = field(default_factory=deque)
    direction: int = 1
    paces: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        free = self.room.free()
        self.tight, self.wide = largest_part(free.buffer(-CLEARANCE)), largest_part(free.buffer(-0.5))
        shapely.prepare(self.tight)
        shapely.prepare(self.wide)
        self.direction = int(self.rng.choice([-1, 1]))

    def start(self) -> Floats:
        """Draw a first pose (3,)."""
        return np.array([*self._points(1)[0], self.rng.uniform(-np.pi, np.pi)])

    def _points(self, n: int) -> Floats:
        x0, y0, x1, y1 = self.wide.bounds
        found: list[Floats] = []
        area = self.tight if self.rng.random() < 0.5 else self.wide
        while len(found) < n:
            points = self.rng.uniform((x0, y0), (x1, y1), size=(3 * n, 2))
            found += list(points[shapely.contains_xy(area, points[:, 0], points[:, 1])])
        return np.array(found[:n])

    def next(self, pose: tuple[float, float, float]) -> Leg:
        """Return the next leg for a robot at `pose`."""
        if not self.queue:
            self._plan(pose)
        return self.queue.popleft()

    def _pace(self) -> float:
        """Return a speed [m/s]; slow, middling and full ones take turns."""
        if not self.paces:
            self.paces = self.rng.permutation([0.4, 0.28, self.rng.uniform(0.15, 0.4)]).tolist()
        return self.paces.pop()

    def _plan(self, pose: tuple[float, float, float]) -> None:
        rng, here = self.rng, np.array(pose[:2])
        chance = rng.random()
        if chance < 0.26:
            self.direction = -self.direction
            amount = self.direction * rng.uniform(0.8, 4.5)
            self.queue.append(Leg(kind="spin", amount=amount, speed=float(rng.uniform(0.3, 1.0))))
            return
        if chance < 0.34:
            self.queue.append(Leg(kind="pause", amount=float(rng.uniform(0.5, 2.0))))
            return
        if chance < 0.41:
            way = rng.uniform(0.25, 0.8)
            behind = here - way * np.array([math.cos(pose[2]), math.sin(pose[2])])
            if self.tight.contains(shapely.LineString([here, behind])):
                self.queue.append(Leg(kind="back", amount=float(way), speed=float(rng.uniform(0.1, 0.25))))
                return
        best, score = None, -np.inf
        for point in self._points(16):
            way = float(np.linalg.norm(point - here))
            if way < 0.5 or not self.tight.contains(shapely.LineString([here, point])):
                continue
            new = min((float(np.linalg.norm(point - old)) for old in self.seen[-25:]), default=3.0)
            value = min(way, 2.5) + 1.5 * min(new, 2.0) + rng.normal(0, 0.6)
            if value > score:
                best, score = point, value
        if best is None:
            # boxed in: turn, or leave by a short step
            amount = float(rng.choice([-1, 1]) * rng.uniform(0.5, 2))
            self.queue.append(Leg(kind="spin", amount=amount, speed=0.6))
            return
        self.seen.append(best)
        pace, target = self._pace(), (float(best[0]), float(best[1]))
        is_arc = bool(rng.random() < 0.4 and self.wide.contains(shapely.LineString([here, best])))
        self.queue.append(Leg(kind="goto", target=target, speed=pace, is_arc=is_arc))


@dataclass(eq=False)
class Delivery:
    """Which command the motors follow at a time; with a base loop each waits for its way and for a tick."""

    motors: TrueMotors
    commands: list[tuple[float, float]] = field(default_factory=list)
    _due: list[float] = field(default_factory=list)
    _now: int = -1

    def __post_init__(self) -> None:
        loop = self.motors.base_loop
        self._rng = np.random.default_rng(0 if loop is None else loop.seed)

    def send(self, u: float, w: float) -> None:
        """Send the next command."""
        loop = self.motors.base_loop
        if loop is not None:
            there = len(self.commands) * COMMAND_PERIOD + loop.transport * self._rng.uniform(0.5, 1.5)
            there += self.motors.dead_time
            period = loop.period * (1 + loop.slow)
            tick = loop.phase + math.ceil((there - loop.phase) / period) * period
            self._due.append(max(tick, self._due[-1]) if self._due else tick)
        self.commands.append((u, w))

    def at(self, t: float) -> tuple[float, float]:
        """Return what the motors are told over the step around t [s]."""
        if self.motors.base_loop is not None:
            while self._now + 1 < len(self._due) and self._due[self._now + 1] <= t:
                self._now += 1
            return self.commands[self._now] if self._now >= 0 else (0.0, 0.0)
        begin, end = (
            (t + side * SIMULATION_STEP / 2 - self.motors.dead_time) / COMMAND_PERIOD for side in (-1, 1)
        )
        first, last = math.floor(begin + 1e-9), math.floor(end - 1e-9)
        (au, aw), (bu, bw) = (self.commands[i] if i >= 0 else (0.0, 0.0) for i in (first, last))
        # of the step, still under the old command
        part = (last - begin) * COMMAND_PERIOD / SIMULATION_STEP if last > first else 0.0
        return bu + part * (au - bu), bw + part * (aw - bw)


@dataclass(eq=False)
class Pilot:
    """Turn legs into set points; looks at the true pose."""

    errand: Errand
    robot: RobotSpec
    leg: Leg | None = None
    until: float = 0.0
    goal: float = 0.0
    origin: tuple[float, float] = (0.0, 0.0)

    def command(self, t: float, x: float, y: float, phi: float) -> tuple[float, float]:
        """Return the wanted (v, omega); the caller limits its slope."""
        for _ in range(4):
            if self.leg is None:
                self._begin(t, x, y, phi)
            wanted = self._steer(t, x, y, phi)
            if wanted is not None:
                return wanted
            self.leg = None
        return 0.0, 0.0

    def _begin(self, t: float, x: float, y: float, phi: float) -> None:
        self.leg = self.errand.next((x, y, phi))
        self.origin, self.goal = (x, y), phi + self.leg.amount
        self.until = t + (self.leg.amount if self.leg.kind == "pause" else 30.0)

    def _steer(self, t: float, x: float, y: float, phi: float) -> tuple[float, float] | None:
        leg = self.leg
        assert leg is not None
        if t > self.until:
            return None
        if leg.kind == "pause":
            return 0.0, 0.0
        if leg.kind == "spin":
            left = self.goal - phi
            if left * math.copysign(1.0, leg.amount) < 0.08:
                return None
            return 0.0, math.copysign(min(leg.speed, 1.8 * abs(left)), left)
        if leg.kind == "back":
            left = leg.amount - math.hypot(x - self.origin[0], y - self.origin[1])
            return None if left < 0.03 else (-min(leg.speed, 0.9 * left + 0.02), 0.0)
        dx, dy = leg.target[0] - x, leg.target[1] - y
        way = math.hypot(dx, dy)
        if way < 0.07:
            return None
        turn = math.remainder(math.atan2(dy, dx) - phi, 2 * math.pi)
        omega = max(-self.robot.omega, min(self.robot.omega, 1.7 * turn))
        if abs(turn) > (1.1 if leg.is_arc else 0.25):
            return 0.0, omega
        return min(leg.speed, 0.8 * way + 0.03) * max(0.2, math.cos(turn)) ** 2, omega


def within(value: float, most: float) -> float:
    """Return the value, or the nearest of -most and most."""
    return max(-most, min(most, value))


def drive(errand: Errand, robot: RobotSpec, motors: TrueMotors, duration: float) -> TrueDrive:
    """Integrate the robot for `duration` [s]; control every COMMAND_PERIOD, truth every SIMULATION_STEP."""
    pilot = Pilot(errand=errand, robot=robot)
    x, y, phi = (float(value) for value in errand.start())
    substeps = round(COMMAND_PERIOD / SIMULATION_STEP)
    n_commands = round(duration / COMMAND_PERIOD)
    keep = math.exp(-SIMULATION_STEP / motors.tau)
    v = omega = u = w = 0.0
    delivery = Delivery(motors=motors)
    rows = [(x, y, phi, 0.0, 0.0)]
    px, py, pr = motors.slip_patch
    for k in range(n_commands):
        want_v, want_w = pilot.command(k * COMMAND_PERIOD, x, y, phi)
        if k > n_commands - 20:
            want_v = want_w = 0.0
        u += within(within(want_v, robot.v) - u, robot.a * COMMAND_PERIOD)
        w += within(within(want_w, robot.omega) - w, robot.alpha * COMMAND_PERIOD)
        delivery.send(u, w)
        for j in range(substeps):
            t = k * COMMAND_PERIOD + (j + 0.5) * SIMULATION_STEP
            cu, cw = delivery.at(t)
            cu = within(cu, motors.v_max)
            if motors.backlash and abs(cw) < motors.backlash:
                cw = 0.0
            if t > motors.late_gain[0]:
                cu, cw = cu * motors.late_gain[1], cw * motors.late_gain[1]
            v1, w1 = cu + (v - cu) * keep, cw + (omega - cw) * keep
            grip = 1.0 - motors.slip if motors.slip and math.hypot(x - px, y - py) < pr else 1.0
            mean_v, mean_w = (v + v1) / 2 * grip, (omega + w1) / 2 * grip
            middle = phi + mean_w * SIMULATION_STEP / 2
            x += mean_v * SIMULATION_STEP * math.cos(middle)
            y += mean_v * SIMULATION_STEP * math.sin(middle)
            phi += mean_w * SIMULATION_STEP
            v, omega = v1, w1
            rows.append((x, y, phi, v, omega))
    table = np.array(rows)
    return TrueDrive(
        stamps=np.arange(len(rows)) * SIMULATION_STEP,
        poses=table[:, :3],
        wheels=table[:, 3:],
        cmd_stamps=np.arange(n_commands) * COMMAND_PERIOD,
        commands=np.array(delivery.commands),
    )


def wrap(angle: Floats) -> Floats:
    """Return angles in (-pi, pi]."""
    return np.pi - (np.pi - angle) % (2 * np.pi)
