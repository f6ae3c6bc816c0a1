"""The simulated robot: it follows a trajectory or replays commands, subject to its limits, lag and wheels.

The tracking law (Kanayama, Kimura, Miyazaki and Noguchi 1990, eq. 6) acts on the noisy reference pose:

    v = v_r cos(turn) + GAIN_X ahead,  omega = omega_r + GAIN_Y v_r aside + GAIN_PHI sin(turn).

Here ahead, aside and turn are the pose error in base_link. The feed-forward (v_r, omega_r) leads by the lag
and the dead time of the motors. The motors are first-order with dead time and limited acceleration. The body
stops at walls and slips on slippery floor, while the wheels keep turning. A `Drivetrain` holds the true
motors, wheels and floor; the controller knows only robot.yaml.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from planners.arena import wrap
from planners.trajectory import Trajectory
from sensorgraph.types import Floats
from sensorgraph.world.drivetrain import Drivetrain
from sensorgraph.world.robot import Robot

TRUTH_STEP = 0.01  # [s] of the simulated truth
STANDSTILL = 0.5  # [s] of recording after the last command
GAIN_X, GAIN_Y, GAIN_PHI = 1.2, 4.0, 2.0  # [1/s], [1/m²] and [1/m] of the tracking law
Clearance = Callable[[float, float], float]
Command = Callable[[float, float, float, float], tuple[float, float]]


@dataclass(frozen=True, kw_only=True, eq=False)
class ExecutedDrive:
    """The true motion on a fine time grid, and the commands."""

    stamps: Floats
    """(n,) [s] Stamps every TRUTH_STEP."""
    poses: Floats
    """(n, 3) [m, m, rad] True base_link in map, phi not wrapped."""
    twists: Floats
    """(n, 2) [m/s, rad/s] Twists of the wheels; those of the body are equal, unless a wall or slippery floor
    acts on it."""
    cmd_stamps: Floats
    """(n_commands,) [s]"""
    commands: Floats
    """(n_commands, 2) [m/s, rad/s]"""
    contacts: int
    """Number of times the body touched a wall."""

    def at(self, stamps: Floats) -> Floats:
        """Interpolate the true poses (..., 3) at stamps (...) [s]; phi is not wrapped."""
        return np.stack([np.interp(stamps, self.stamps, column) for column in self.poses.T], axis=-1)


def follow(
    trajectory: Trajectory,
    robot: Robot,
    *,
    clearance: Clearance,
    rng: np.random.Generator,
    drivetrain: Drivetrain | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> ExecutedDrive:
    """Drive along a trajectory, steered by the noisy reference pose.

    Parameters
    ----------
    drivetrain : True motors, wheels and floor; None: as in robot.yaml.
    """
    duration = trajectory.duration + STANDSTILL
    want_pose, feed = tracking_targets(trajectory, robot, duration)
    noise = rng.normal(size=want_pose.shape) * [
        robot.pose.sigma_xy,
        robot.pose.sigma_xy,
        robot.pose.sigma_yaw,
    ]
    want, forward, pose_noise = want_pose.tolist(), feed.tolist(), noise.tolist()

    def command(k: float, x: float, y: float, phi: float) -> tuple[float, float]:
        dx, dy, dphi = pose_noise[int(k)]
        return tracking_law(want[int(k)], forward[int(k)], (x + dx, y + dy, phi + dphi))

    start = trajectory.poses[0]
    drivetrain = drivetrain or Drivetrain.of(robot)
    return _drive(start, duration, command, robot, drivetrain, clearance=clearance, progress=progress)


def tracking_targets(trajectory: Trajectory, robot: Robot, duration: float) -> tuple[Floats, Floats]:
    """Return the target pose (n, 3) and the feed-forward twist (n, 2) at each command."""
    period = 1.0 / robot.wheels.rate
    lead = (
        robot.actuators.tau + robot.actuators.delay + period / 2
    )  # a held command acts half a period late on average
    stamps = trajectory.stamps[0] + period * np.arange(_n_commands(duration, robot))
    want, _ = trajectory.at(stamps)
    _, feed = trajectory.at(stamps + lead)
    feed[stamps + lead > trajectory.stamps[-1]] = 0.0
    return want, feed


def tracking_law(want: Sequence[float], feed: Sequence[float], pose: Sequence[float]) -> tuple[float, float]:
    """Return the command (v, omega) at a pose (3,), given the target pose and the feed-forward twist."""
    (xr, yr, phi_r), (v_r, omega_r), (x, y, phi) = want, feed, pose
    c, s = math.cos(phi), math.sin(phi)
    ahead = c * (xr - x) + s * (yr - y)
    aside = -s * (xr - x) + c * (yr - y)
    turn = math.remainder(phi_r - phi, 2 * math.pi)
    v = v_r * math.cos(turn) + GAIN_X * ahead
    return v, omega_r + GAIN_Y * v_r * aside + GAIN_PHI * math.sin(turn)


def replay(
    cmd_stamps: Floats,
    commands: Floats,
    start: Floats,
    robot: Robot,
    *,
    clearance: Clearance,
    drivetrain: Drivetrain | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> ExecutedDrive:
    """Drive open loop by recorded commands (n, 2) from `start` (3,); each command holds until the next."""
    stamps = cmd_stamps - cmd_stamps[0]
    period = 1.0 / robot.wheels.rate
    last = (
        np.searchsorted(
            stamps, period * np.arange(_n_commands(stamps[-1] + STANDSTILL, robot)) + 1e-9, side="right"
        )
        - 1
    )
    held = commands[np.maximum(last, 0)]
    held[period * np.arange(len(held)) > stamps[-1] + STANDSTILL / 2] = 0.0
    table = held.tolist()

    def command(k: float, x: float, y: float, phi: float) -> tuple[float, float]:
        v, omega = table[int(k)]
        return v, omega

    drivetrain = drivetrain or Drivetrain.of(robot)
    duration = float(stamps[-1]) + STANDSTILL
    return _drive(start, duration, command, robot, drivetrain, clearance=clearance, progress=progress)


def react(
    controller: Callable[[Floats], tuple[float, float]],
    scan: Callable[[int, Floats], Floats],
    start: Floats,
    duration: float,
    robot: Robot,
    *,
    clearance: Clearance,
    progress: Callable[[int, int], None] | None = None,
) -> ExecutedDrive:
    """Drive closed loop for `duration` [s] from `start` (3,); each new scan gives the next command.

    Parameters
    ----------
    controller : Readings (n_rays,) [m] -> (v, omega) [m/s, rad/s].
    scan : (number of the scan, pose (3,)) -> readings (n_rays,) [m].
    """
    period = 1.0 / robot.wheels.rate
    last, held = -1, (0.0, 0.0)

    def command(k: float, x: float, y: float, phi: float) -> tuple[float, float]:
        nonlocal last, held
        number = math.floor(k * period * robot.sensor.rate + 1e-9)
        if number != last and k * period <= duration:
            last, held = number, controller(scan(number, np.array([x, y, phi])))
        return held if k * period <= duration else (0.0, 0.0)

    return _drive(
        start,
        duration + STANDSTILL,
        command,
        robot,
        Drivetrain.of(robot),
        clearance=clearance,
        progress=progress,
    )


def odometry(
    driven: ExecutedDrive, robot: Robot, rng: np.random.Generator, *, drivetrain: Drivetrain | None = None
) -> tuple[Floats, Floats, Floats]:
    """Return stamps (n,), poses (n, 3) in odom and twists (n, 2), as the wheels measure and integrate them."""
    drivetrain = drivetrain or Drivetrain.of(robot)
    measured = driven.twists @ drivetrain.measured.T  # (n, 2) twists as the wheels measure them
    stamps = np.arange(0.0, driven.stamps[-1] + 1e-9, 1.0 / robot.wheels.rate)
    travelled = np.concatenate(
        [np.zeros((1, 2)), np.cumsum((measured[1:] + measured[:-1]) / 2 * TRUTH_STEP, axis=0)]
    )
    taken = stamps - drivetrain.odometry_lag
    at = np.stack([np.interp(taken, driven.stamps, column) for column in travelled.T], axis=1)
    twists = np.concatenate([measured[:1], np.diff(at, axis=0) * robot.wheels.rate])
    twists[1:] += rng.normal(size=(len(stamps) - 1, 2)) * [robot.wheels.sigma_v, robot.wheels.sigma_omega]
    turn = twists[1:, 1] / robot.wheels.rate
    phi = np.concatenate([[0.0], np.cumsum(turn)])
    way = twists[1:, 0] / robot.wheels.rate * np.sinc(turn / (2 * np.pi))  # the chord of the arc
    steps = way[:, None] * np.stack([np.cos(phi[:-1] + turn / 2), np.sin(phi[:-1] + turn / 2)], axis=1)
    xy = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return stamps, np.concatenate([xy, wrap(phi)[:, None]], axis=1), twists


def _n_commands(duration: float, robot: Robot) -> int:
    return math.ceil(duration * robot.wheels.rate - 1e-9) + 1


def _drive(
    start: Floats,
    duration: float,
    command: Command,
    robot: Robot,
    drivetrain: Drivetrain,
    *,
    clearance: Clearance,
    progress: Callable[[int, int], None] | None,
) -> ExecutedDrive:
    """Integrate the motion; `command(k, x, y, phi)` is called once per control period."""
    limits, radius = robot.limits, robot.footprint_radius
    backward = 0.0 if robot.drive == "dubins" else -limits.v
    n_commands, period = _n_commands(duration, robot), 1.0 / robot.wheels.rate
    n_steps = round(duration / TRUTH_STEP)
    keep = math.exp(-TRUTH_STEP / drivetrain.tau) if drivetrain.tau > 0 else 0.0
    late = drivetrain.delay / TRUTH_STEP
    whole = math.floor(late + 1e-9)
    share = max(late - whole, 0.0)  # of a step in which the older command still holds
    v_max = drivetrain.v_max
    dv, domega = limits.a * TRUTH_STEP, limits.alpha * TRUTH_STEP
    x, y, phi = (float(value) for value in start)
    v = omega = u_v = u_omega = 0.0
    given: list[tuple[float, float]] = []
    poses, twists = [(x, y, phi)], [(0.0, 0.0)]
    waiting = [(0.0, 0.0)] * (whole + 1)
    contacts, touching = 0, False
    for k in range(n_steps):
        if len(given) < n_commands and k * TRUTH_STEP >= len(given) * period - 1e-9:
            w_v, w_omega = command(len(given), x, y, phi)
            u_v = min(max(w_v, backward), limits.v)
            u_omega = min(max(w_omega, -limits.omega), limits.omega)
            given.append((u_v, u_omega))
            if progress is not None and len(given) % 500 == 0:
                progress(len(given), n_commands)
        waiting.append((u_v, u_omega))
        m_v, m_omega = waiting[k + 1]
        if share:
            m_v += share * (waiting[k][0] - m_v)
            m_omega += share * (waiting[k][1] - m_omega)
        m_v = min(max(m_v, -v_max), v_max)
        v_next = v + min(max((m_v - v) * (1 - keep), -dv), dv)
        omega_next = omega + min(max((m_omega - omega) * (1 - keep), -domega), domega)
        v_mid, omega_mid = drivetrain.moved((v + v_next) / 2, (omega + omega_next) / 2, x, y, phi)
        turn = omega_mid * TRUTH_STEP
        x_next = x + v_mid * TRUTH_STEP * math.cos(phi + turn / 2)
        y_next = y + v_mid * TRUTH_STEP * math.sin(phi + turn / 2)
        phi += turn
        free = clearance(x_next, y_next)
        if free >= radius or free >= clearance(x, y):
            x, y, touching = x_next, y_next, False
        elif not touching:
            contacts, touching = contacts + 1, True
        v, omega = v_next, omega_next
        poses.append((x, y, phi))
        twists.append((v, omega))
    if progress is not None:
        progress(n_commands, n_commands)
    return ExecutedDrive(
        stamps=np.arange(n_steps + 1) * np.float64(TRUTH_STEP),
        poses=np.array(poses),
        twists=np.array(twists),
        cmd_stamps=np.arange(len(given)) * np.float64(period),
        commands=np.array(given, dtype=np.float64).reshape(-1, 2),
        contacts=contacts,
    )
