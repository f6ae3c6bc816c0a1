"""The truth about an effect: its size, where it is, and the mark that it leaves in the run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.signal import lfilter

from benchmarks.hidden_effects.library import CHANNEL, DETERMINISTIC
from benchmarks.hidden_effects.log import Floats
from benchmarks.hidden_effects.worlds.own import foreign
from benchmarks.hidden_effects.worlds.own.case_setup import RUN_DURATION, CaseSetup, motors_of, scan_stamps
from benchmarks.hidden_effects.worlds.own.drive import SIMULATION_STEP, TrueDrive, TrueMotors
from benchmarks.hidden_effects.worlds.own.physics import odometry
from benchmarks.hidden_effects.worlds.own.recording import reported_poses
from benchmarks.hidden_effects.worlds.own.robot import COMMAND_PERIOD
from benchmarks.hidden_effects.worlds.own.simulated_scan import HiddenEffect, observe
from benchmarks.hidden_effects.worlds.own.strengths import MATERIALITY, Context, ratio_of

LEAST_CHANGED, LEAST_RMSE = 0.01, 1.02
"""A mark: this share of rays changed, or this RMS over the noise."""


def channel_of(name: str) -> str:
    return CHANNEL.get(name) or foreign.FOREIGN_CHANNEL.get(name, "scan")


def truth_of(
    setup: CaseSetup,
    effect: HiddenEffect,
    effects: Sequence[HiddenEffect],
    context: Context,
    driven: TrueDrive,
) -> dict[str, Any]:
    channel = channel_of(effect.name)
    if channel == "scan":
        mark = _scan_mark(setup, effect, effects, driven)
    elif channel == "odometry":
        mark = _odometry_mark(setup, effect, effects, driven)
    else:
        mark = _drive_mark(setup, effect, effects, driven)
    parameters = dict(effect.parameters)
    ratio = ratio_of(effect, context)
    if effect.name == "people":
        parameters["p"] = mark["changed_share"]
        ratio = mark["changed_share"] / MATERIALITY["people"]
    if effect.name == "range_noise" or effect.name in ("people", "random_outliers"):
        is_marked = mark["changed_share"] >= 0.002 or mark["rmse_over_sigma"] >= LEAST_RMSE
    else:
        is_marked = mark["changed_share"] >= LEAST_CHANGED or mark["rmse_over_sigma"] >= LEAST_RMSE
    return {
        "name": effect.name,
        "channel": channel,
        "parameters": parameters,
        "location": {"name": effect.place, "xy": effect.xy} if effect.place or effect.xy else None,
        "materiality_ratio": ratio,
        "mark": mark,
        "material": bool(is_marked and (ratio is None or ratio >= 1.0)),
        "deterministic": effect.name in DETERMINISTIC,
    }


def _mark(change: Floats, sigma: Any, flipped: Floats | None = None, extra: float = 0.0) -> dict[str, float]:
    """Summarise a change against the noise: share above half a sigma, RMS (extra: of a wider spread).

    `rmse_over_sigma` counts a change as five sigmas at most, or a few rays at depth edges would be all of it.
    """
    relative = change / sigma
    share = np.abs(relative) > 0.5 if flipped is None else (np.abs(relative) > 0.5) | flipped
    return {
        "changed_share": float(np.mean(share)),
        "rmse_over_sigma": float(np.sqrt(1 + np.mean(np.clip(relative, -5, 5) ** 2) + extra)),
        "raw_rmse_over_sigma": float(np.sqrt(1 + np.mean(relative**2) + extra)),
    }


def _scan_mark(
    setup: CaseSetup, effect: HiddenEffect, effects: Sequence[HiddenEffect], driven: TrueDrive
) -> dict[str, float]:
    stamps = scan_stamps(setup.robot)[::2]  # every other scan: half the time
    rest = [e for e in effects if e is not effect]
    with_scene, without_scene = setup.scene(driven, stamps), setup.scene(driven, stamps)
    if effect.name in foreign.POSE_EFFECTS:
        told = replace(driven, poses=reported_poses(driven, driven.stamps, effects, setup.room))
        without_scene = setup.scene(told, stamps)
    after, before = observe(with_scene, effects), observe(without_scene, rest)
    both = np.isfinite(after) & np.isfinite(before)
    change = np.where(both, np.where(both, after, 0.0) - np.where(both, before, 0.0), 0.0)
    flipped = np.isfinite(after) != np.isfinite(before)
    if effect.name == "quantisation":
        # the lattice itself is seen as soon as it is coarser than the stated one
        flipped = flipped | (np.abs(change) > setup.robot.resolution)
    wider = float(np.mean(with_scene.spread**2 / without_scene.spread**2)) - 1.0
    return _mark(change, setup.robot.sigma, flipped, extra=wider)


def _odometry_mark(
    setup: CaseSetup, effect: HiddenEffect, effects: Sequence[HiddenEffect], driven: TrueDrive
) -> dict[str, float]:
    stamps = np.arange(COMMAND_PERIOD, RUN_DURATION - 1e-9, COMMAND_PERIOD)
    sigma = np.array([setup.robot.sigma_v, setup.robot.sigma_omega])
    if effect.name == "wheel_slip":
        inside = np.hypot(*(driven.at(stamps)[:, :2] - np.array(effect.xy)).T) < float(
            effect.parameters["r"] or 0
        )
        twists = odometry(driven, [], stamps, setup.robot.wheel_base)
        return _mark(twists * inside[:, None] * float(effect.parameters["s"] or 0), sigma)
    rest = [e for e in effects if e is not effect]
    change = odometry(driven, effects, stamps, setup.robot.wheel_base) - odometry(
        driven, rest, stamps, setup.robot.wheel_base
    )
    return _mark(change, sigma)


def _drive_mark(
    setup: CaseSetup, effect: HiddenEffect, effects: Sequence[HiddenEffect], driven: TrueDrive
) -> dict[str, float]:
    rest = [e for e in effects if e is not effect]
    change = _respond(driven, motors_of(setup.robot, effects)) - _respond(
        driven, motors_of(setup.robot, rest)
    )
    return _mark(change, np.array([setup.robot.sigma_v, setup.robot.sigma_omega]))


def _respond(driven: TrueDrive, motors: TrueMotors) -> Floats:
    """Return the wheel twists (n, 2) at the command rate for the commands given, open loop."""
    n = round(COMMAND_PERIOD / SIMULATION_STEP)
    t = (np.arange(len(driven.stamps) - 1) + 0.5) * SIMULATION_STEP
    held = np.floor((t - motors.dead_time) / COMMAND_PERIOD).astype(np.intp)
    u = np.where(held[:, None] >= 0, driven.commands[np.maximum(held, 0)], 0.0)
    u[:, 0] = np.clip(u[:, 0], -motors.v_max, motors.v_max)
    u[np.abs(u[:, 1]) < motors.backlash, 1] = 0.0
    u[t > motors.late_gain[0]] *= motors.late_gain[1]
    keep = math.exp(-SIMULATION_STEP / motors.tau)
    out = lfilter([1 - keep], [1, -keep], u, axis=0)
    return np.asarray(out[::n], dtype=np.float64)
