"""Runs with wheel and drive effects in closed form, made without the simulator."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from logs.run import RangeSensor, Run
from planners.arena import wrap
from planners.types import Floats
from sensorgraph.world.robot import default_robot

STEP = 0.005
PERIOD = 0.05
BASE = 0.4
ROBOT = default_robot()


def profile(rng: np.random.Generator, duration: float) -> Floats:
    """Draw (v, omega) set points, one per period: stretches of straight driving, curves, spins and rests."""
    rows: list[tuple[float, float]] = [(0.0, 0.0)] * 20
    while len(rows) * PERIOD < duration:
        n = int(rng.integers(20, 60))
        kind = rng.random()
        v = 0.0 if kind < 0.3 else float(rng.choice([0.15, 0.25, 0.35, 0.39, -0.15]))
        omega = 0.0 if 0.3 <= kind < 0.5 else float(rng.uniform(0.2, 0.9) * rng.choice([-1, 1]))
        rows += [(0.0, 0.0)] * n if kind < 0.05 else [(v, omega)] * n
    goal = np.array(rows)[: round(duration / PERIOD)]
    out = np.zeros_like(goal)
    for k in range(1, len(goal)):  # set points of limited slope
        out[k] = out[k - 1] + np.clip(goal[k] - out[k - 1], [-0.025, -0.1], [0.025, 0.1])
    return out


@cache
def make_run(seed: int, *, duration: float = 80.0, memory: float = 0.0, **effect: Any) -> Run:
    """Drive and log; effects: radius, diff, base, slip=(s, x, y, r), track [m] between the wheels that slip by themselves, clock, lag, dead, v_max; memory of the camera.

    Some that the library lacks: `scrub`, the body loses so many metres per radian that it turns; `sag`, the wheels lose
    that share of their speed per rad/s of turning; `since`, a lag only from this time on [s]. A fourth, `asym`: the floor
    takes that share of left turns alone; `play` [m], by which each wheel turns back before it moves the body; `pile`, the
    share of the way by which a carpet carries the body along x; `spin`, the share that is lost while the robot gains more than 0.15 m/s²;
    `outages` of the link [s, s], in which a watchdog stops the base.
    """
    rng, outages = np.random.default_rng(seed), effect.get("outages", ())
    commands = profile(rng, duration)
    n, per = round(duration / STEP), round(PERIOD / STEP)
    late = round(effect.get("dead", 0.0) / STEP)
    keeps = [math.exp(-STEP / (0.10 + lag)) for lag in (0.0, effect.get("lag", 0.0))]
    since = effect.get("since", 0.0)
    v_max = effect.get("v_max", np.inf)
    s, px, py, pr = effect.get("slip", (0.0, 0.0, 0.0, 0.0))
    track, play, slack = effect.get("track", 0.0), effect.get("play", 0.0), [0.0, 0.0]

    def grip(side: float) -> float:
        at_x, at_y = x - side * track / 2 * math.sin(phi), y + side * track / 2 * math.cos(phi)
        return 1 - s if math.hypot(at_x - px, at_y - py) < pr else 1.0

    scrub, sag, asym = effect.get("scrub", 0.0), effect.get("sag", 0.0), effect.get("asym", 0.0)
    spin, pile = effect.get("spin", 0.0), effect.get("pile", 0.0)
    x, y, phi, v, omega = 0.0, 0.0, 0.3, 0.0, 0.0
    poses, wheels, given = [(x, y, phi)], [(0.0, 0.0)], commands.tolist()
    for k in range(n):  # of plain floats: 16,000 steps of arrays take five times as long
        u, w = given[(k - late) // per] if k >= late else (0.0, 0.0)
        if outages and any(begin <= k * STEP < end for begin, end in outages):
            u, w = 0.0, 0.0
        u, keep = min(max(u, -v_max), v_max), keeps[k * STEP >= since]
        v1, w1 = u + (v - u) * keep, w + (omega - w) * keep
        left, right = (grip(1.0), grip(-1.0)) if s else (1.0, 1.0)
        both, apart = (left + right) / 2, (right - left) / 2
        turn = (omega + w1) / 2 * STEP * both + (v + v1) * STEP * apart / (track or 1.0)
        slow, slow1 = 1 - sag * abs(omega), 1 - sag * abs(w1)
        way = (v * slow + v1 * slow1) / 2 * STEP * both + (omega + w1) / 4 * STEP * track * apart
        way -= scrub * abs(turn)
        turn *= 1 - asym * (turn > 0)
        if play:
            steps = [(v + v1) / 2 * STEP + side * BASE / 4 * (omega + w1) * STEP for side in (-1.0, 1.0)]
            for wheel, step in enumerate(steps):
                taken = min(max(slack[wheel] + step, 0.0), play)  # the gear's tooth between both flanks
                steps[wheel], slack[wheel] = step - (taken - slack[wheel]), taken
            way, turn = sum(steps) / 2, (steps[1] - steps[0]) / BASE
        if (v + v1) * (v1 - v) > 0 and abs(v1 - v) > 0.15 * STEP:
            way *= 1 - spin
        way += pile * abs(way) * math.cos(phi)
        middle = phi + turn / 2
        x, y, phi = x + way * math.cos(middle), y + way * math.sin(middle), phi + turn
        v, omega = v1, w1
        poses.append((x, y, phi))
        wheels.append((v * slow1, omega))
    fine = np.arange(n + 1) * STEP
    truth, rates = np.array(poses), np.array(wheels)
    total = np.concatenate([np.zeros((1, 2)), np.cumsum((rates[1:] + rates[:-1]) / 2 * STEP, axis=0)])
    stamps = np.arange(0.0, duration, PERIOD)
    at = np.stack([np.interp(stamps - effect.get("clock", 0.0), fine, c) for c in total.T], axis=1)
    twists = np.diff(at, axis=0, prepend=at[:1]) / PERIOD * (1 + effect.get("radius", 0.0))
    twists[:, 1] = (twists[:, 1] + effect.get("diff", 0.0) * twists[:, 0] / 0.4) / (
        1 + effect.get("base", 0.0)
    )
    twists += rng.normal(size=twists.shape) * [0.004, 0.006]
    phi = np.cumsum(twists[:, 1] * PERIOD)
    middle_phi = phi - twists[:, 1] * PERIOD / 2
    step = (twists[:, 0] * PERIOD)[:, None] * np.stack([np.cos(middle_phi), np.sin(middle_phi)], axis=1)
    pose_stamps = np.arange(0.0, duration, 1 / 30)
    white = rng.normal(size=(len(pose_stamps), 3))
    for k in range(1, len(white)):
        white[k] = memory * white[k - 1] + np.sqrt(1 - memory**2) * white[k]
    seen = np.stack([np.interp(pose_stamps, fine, c) for c in truth.T], axis=1) + white * [
        0.002,
        0.002,
        0.0015,
    ]
    seen[:, 2] = wrap(seen[:, 2])
    return Run(
        sensor=RangeSensor(bearings=np.zeros(1)),
        stamps=np.zeros(1),
        ranges=np.full((1, 1), np.inf),
        pose_stamps=pose_stamps,
        poses=seen,
        odom_stamps=stamps,
        odometry=np.column_stack([np.cumsum(step, axis=0), wrap(phi)]),
        odom_twists=twists,
        cmd_stamps=stamps,
        commands=commands[: len(stamps)],
    )


def reported(run: Run, v: Floats, omega: Floats) -> Run:
    """Return the run with other rates (n,) in its odometry."""
    period = np.gradient(run.odom_stamps)
    phi = np.cumsum(omega * period)
    middle = phi - omega * period / 2
    steps = (v * period)[:, None] * np.stack([np.cos(middle), np.sin(middle)], axis=1)
    odometry = np.column_stack([np.cumsum(steps, axis=0), wrap(phi)])
    return replace(run, odometry=odometry, odom_twists=np.column_stack([v, omega]))


def without_odometry(run: Run) -> Run:
    """Return the run as a robot without wheel encoders logs it."""
    return replace(run, odom_stamps=np.zeros(0), odometry=np.zeros((0, 3)), odom_twists=np.zeros((0, 2)))


def without_commands(run: Run) -> Run:
    """Return the run as it is when nobody recorded the commands."""
    return replace(run, cmd_stamps=np.zeros(0), commands=np.zeros((0, 2)))
