"""Short drives of a robot of MuJoCo through rooms, recorded once: poses, wheels, and lasers of three kinds."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
CACHE = Path("build/fuzz-drives")
"""Folder of the recorded drives; it may be deleted at any time."""
VERSION = 1
"""Increase it after a change of the recorded drives."""
SECONDS = 22.0
"""[s] duration of a drive."""
PERIOD = 0.1
"""[s] of one turn of the laser."""
N_TURN = 360
"""Rays of one turn."""
MOUNT = np.array([0.12, 0.03])
"""[m] the laser in base_link; its yaw depends on the log."""
REAR_MOUNT = np.array([-0.18, -0.05])
"""[m] the second laser in base_link."""
PAUSE = 0.3
"""[s] before the first scan."""
SWEEP_BLOCK = 6
"""Rays of a sweep that are cast from one place: it moves by less than 2 mm meanwhile."""
SPEED, TURN_RATE = 0.7, 1.2
"""[m/s, rad/s] limits of the pilot."""
ROOMS = ("room_1", "room_2", "room_3", "room_4")
NAMES = (*ROOMS, "corridor", "spin")


@dataclass(frozen=True, kw_only=True, eq=False)
class Drive:
    """One drive; all times are on one true clock."""

    times: Floats
    """(n,) [s] at 100 Hz."""
    poses: Floats
    """(n, 3) [m, m, rad] base_link in the room, heading unwrapped."""
    odom_times: Floats
    """(n_odom,) [s] at 50 Hz."""
    odometry: Floats
    """(n_odom, 3) [m, m, rad] integrated from the encoders."""
    twists: Floats
    """(n_odom, 2) [m/s, rad/s]"""
    cmd_times: Floats
    commands: Floats
    """(n_cmd, 2)"""
    turns: dict[int, Floats]
    """Direction of rotation (1: counter-clockwise, -1: clockwise) -> (n_turns * N_TURN,) [m] ranges of a laser that never
    stops. Ray j is measured at PAUSE + j PERIOD / N_TURN, at the angle direction * 2 pi j / N_TURN in base_link."""
    flashes: Floats
    """(n_turns, N_TURN) [m] ranges of a laser that measures all rays at PAUSE + k PERIOD."""
    rear_flashes: Floats
    """(n_turns, N_TURN) [m] those of the second laser."""

    def pose_at(self, when: Floats | float) -> Floats:
        """Return the true poses (..., 3), heading unwrapped."""
        return np.stack([np.interp(when, self.times, column) for column in self.poses.T], axis=-1)

    @property
    def n_turns(self) -> int:
        """Number of turns of the laser."""
        return len(self.flashes)


@cache
def load(name: str) -> Drive:
    """Return a drive of `NAMES`; record it on first use."""
    path = CACHE / f"{name}-{VERSION}.npz"
    if not path.exists():
        CACHE.mkdir(parents=True, exist_ok=True)
        made = record(name)
        columns = {f.name: getattr(made, f.name) for f in fields(Drive) if f.name != "turns"}
        part = path.with_suffix(f".{np.random.default_rng().integers(2**32)}.npz")
        np.savez_compressed(part, **columns, ahead=made.turns[1], back=made.turns[-1])
        part.replace(path)
    with np.load(path) as data:
        columns = {key: data[key].astype(np.float64) for key in data.files}
    return Drive(turns={1: columns.pop("ahead"), -1: columns.pop("back")}, **columns)


class _Straight:
    """Drive along a corridor; it takes the place of the pilot of a room."""

    period = 0.05

    def __init__(self, v: float, omega: float, start: Floats) -> None:
        self.goal, self.now, self.at = np.array([v, omega]), np.zeros(2), start

    def start(self) -> Floats:
        return self.at

    def command(self, pose: Floats) -> tuple[float, float]:
        wish = self.goal + [0.0, -0.8 * pose[2] * (self.goal[0] > 0)]
        self.now += np.clip(wish - self.now, *(np.array([[-0.5], [0.5]]) * [1.0, 4.0] * self.period))
        return float(self.now[0]), float(self.now[1])


def record(name: str) -> Drive:
    """Drive in MuJoCo and measure."""
    from benchmarks.hidden_effects.worlds.simulators.hidden import Secrets
    from benchmarks.hidden_effects.worlds.simulators.mujoco_drive import Base, drive
    from benchmarks.hidden_effects.worlds.simulators.mujoco_laser import World
    from benchmarks.hidden_effects.worlds.simulators.rooms import OUTER, Pilot, Room, draw_room

    rng = np.random.default_rng([20261126, NAMES.index(name)])
    room = draw_room(rng)
    pilot = Pilot(room, rng, v_max=SPEED, omega_max=TURN_RATE)
    if name == "corridor":
        room = Room(rings={OUTER: np.array([(0.0, -1.2), (40.0, -1.2), (40.0, 1.2), (0.0, 1.2)])})
        pilot = _Straight(0.4, 0.0, np.array([15.0, 0.1, 0.0]))  # type: ignore[assignment]
    elif name == "spin":
        pilot = _Straight(0.0, 0.9, pilot.start())  # type: ignore[assignment]
    base = Base()
    driven = drive(base, pilot, Secrets(), SECONDS, rng)
    times = np.arange(0.0, driven.times[-1], 0.01)
    poses = driven.pose_at(times)
    odom_times = np.arange(0.0, driven.times[-1], 0.02)
    odometry, twists = _integrate(driven.wheels_at(odom_times), base.radius, base.base, 0.02)
    n_turns = int((driven.times[-1] - PAUSE) / PERIOD) - 1
    world = World(room, Secrets())

    def cast(when: Floats, angles: Floats, at: Floats, together: int) -> Floats:
        x, y, phi = driven.pose_at(when).T
        c, s = np.cos(phi), np.sin(phi)
        origins = np.column_stack([x + c * at[0] - s * at[1], y + s * at[0] + c * at[1]])
        parts = [slice(k, k + together) for k in range(0, len(when), together)]
        aims = phi + angles
        return np.concatenate([world.cast(origins[part].mean(axis=0), aims[part])[0] for part in parts])

    step = 2 * np.pi / N_TURN
    j = np.arange((n_turns + 1) * N_TURN)
    turns = {sign: cast(PAUSE + j * PERIOD / N_TURN, sign * step * j, MOUNT, SWEEP_BLOCK) for sign in (1, -1)}
    flashes = [np.zeros((0, N_TURN))] * 2
    for i, at in enumerate((MOUNT, REAR_MOUNT)):
        when = PAUSE + PERIOD * np.repeat(np.arange(n_turns), N_TURN)
        flashes[i] = cast(when, np.tile(step * np.arange(N_TURN), n_turns), at, N_TURN).reshape(
            n_turns, N_TURN
        )
    return Drive(
        times=times, poses=poses, odom_times=odom_times, odometry=odometry, twists=twists,
        cmd_times=driven.cmd_stamps, commands=driven.commands, turns=turns, flashes=flashes[0], rear_flashes=flashes[1],
    )  # fmt: skip


def _integrate(wheels: Floats, radius: float, base: float, step: float) -> tuple[Floats, Floats]:
    """Return poses and twists from the angles (n, 2) of the left and right wheel, by midpoints."""
    moved = radius * np.diff(wheels, axis=0, prepend=wheels[:1])
    way, turn = moved.mean(axis=1), (moved[:, 1] - moved[:, 0]) / base
    phi = np.cumsum(turn)
    middle = phi - turn / 2
    return np.column_stack(
        [np.cumsum(way * np.cos(middle)), np.cumsum(way * np.sin(middle)), phi]
    ), np.column_stack([way, turn]) / step
