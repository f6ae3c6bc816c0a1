"""Cases of every suite, made from seeds, and their truth: what is hidden, where it is, and the mark that it leaves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.signal import lfilter

from benchmarks.hidden_effects.case import Case, Spec
from benchmarks.hidden_effects.case import truth_of as truth_file
from benchmarks.hidden_effects.library import CHANNEL, DETERMINISTIC, LIBRARY
from benchmarks.hidden_effects.log import Floats
from benchmarks.hidden_effects.worlds.own import foreign
from benchmarks.hidden_effects.worlds.own.drive import SIMULATION_STEP, TrueDrive, TrueMotors
from benchmarks.hidden_effects.worlds.own.recording import (
    RUN_DURATION,
    CaseSetup,
    context_of,
    draw_background,
    motors_of,
    record,
    reported_poses,
    scan_stamps,
)
from benchmarks.hidden_effects.worlds.own.robot import COMMAND_PERIOD, draw_base_loop, make_robot
from benchmarks.hidden_effects.worlds.own.simulated_scan import HiddenEffect, observe, odometry
from benchmarks.hidden_effects.worlds.own.strengths import MATERIALITY, Context, draw, ratio_of
from benchmarks.hidden_effects.worlds.own.world import make_room

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
    parameters, ratio = dict(effect.parameters), ratio_of(effect, context)
    if effect.name == "people":
        parameters["p"] = mark["changed_share"]
        ratio = mark["changed_share"] / MATERIALITY["people"]
    least = 0.002 if effect.name in ("range_noise", "people", "random_outliers") else LEAST_CHANGED
    is_marked = mark["changed_share"] >= least or mark["rmse_over_sigma"] >= LEAST_RMSE
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
        away = np.hypot(*(driven.at(stamps)[:, :2] - np.array(effect.xy)).T)
        inside = away < float(effect.parameters["r"] or 0)
        twists = odometry(driven, [], stamps, setup.robot.wheel_base)
        return _mark(twists * inside[:, None] * float(effect.parameters["s"] or 0), sigma)
    rest = [e for e in effects if e is not effect]
    after, before = (odometry(driven, some, stamps, setup.robot.wheel_base) for some in (effects, rest))
    return _mark(after - before, sigma)


def _drive_mark(
    setup: CaseSetup, effect: HiddenEffect, effects: Sequence[HiddenEffect], driven: TrueDrive
) -> dict[str, float]:
    rest = [e for e in effects if e is not effect]
    after, before = (_respond(driven, motors_of(setup.robot, some)) for some in (effects, rest))
    return _mark(after - before, np.array([setup.robot.sigma_v, setup.robot.sigma_omega]))


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


SUITES = ("none", "singles", "pairs", "triples", "foreign")
STREAMS = {"dev": 0, "report": 1}
ROOT_SEED = 20261121
STRATUM_ORDER = (1, 4, 2, 5, 0, 3)
INCOMPATIBLE_GROUPS = [
    {"range_bias", "range_drift", "map_scale", "range_scale"},
    {"range_scale", "map_scale", "moved_wall"},
    {"latency", "scan_skew"},
    {"moved_obstacle", "missing_obstacle"},
    {"people", "random_outliers"},
    {"max_range", "tilt"},
    {"glass", "mirror", "black_surface", "incidence_dropout"},
    {"min_range", "self_occlusion"},
    {"dead_time", "actuator_lag"},
    {"wheel_radius", "wheel_slip"},
]
"""Effects that may not be hidden together: each explains most of the other."""
INCOMPATIBLE_WITH = {
    "sonar_cone": {
        "mixed_pixels", "glass", "mirror", "black_surface", "incidence_dropout", "tilt", "people", "moved_obstacle",
        "missing_obstacle", "unmapped_obstacle", "mount_yaw", "scan_skew", "max_range",
    }
}  # fmt: skip


def make(spec: Spec) -> Case:
    """Make a case; every other one is dirty."""
    key = [ROOT_SEED, STREAMS[spec.kinds], SUITES.index(spec.suite), spec.index]
    seed = int(np.random.SeedSequence(key).generate_state(1, np.uint64)[0] >> 1)
    kind = spec.background_in_turn(1)
    seeds = np.random.SeedSequence(seed).spawn(6)
    room_rng, robot_rng, path_rng, back_rng, effect_rng, noise_rng = map(np.random.default_rng, seeds)
    room, robot = make_room(room_rng), make_robot(robot_rng)
    background = draw_background(kind, back_rng)
    if kind != "clean":
        robot = replace(robot, base_loop=draw_base_loop(np.random.default_rng([seed, 5])))
    path_seed = int(path_rng.integers(2**62))
    setup = CaseSetup(
        room=room,
        robot=robot,
        background=background,
        seed=seed,
        path_seed=path_seed,
        back_seed=int(back_rng.integers(2**62)),
    )
    nominal = setup.drive([])
    context = context_of(setup, nominal)
    effects = _effects(spec, context, setup, nominal, effect_rng)
    driven = setup.drive(effects)
    run = record(setup, driven, effects, int(noise_rng.integers(2**62)))
    told = [truth_of(setup, effect, effects, context, driven) for effect in effects]
    return Case(
        log=run,
        map={"arena.geojson": room.geojson()},
        robot=robot.yaml(),
        truth=truth_file(
            spec,
            told,
            is_foreign=spec.suite == "foreign",
            seed=seed,
            background=kind,
            n_rays=int(run.ranges.size),
            background_values=dict(vars(background)),
            base_loop=None if robot.base_loop is None else dict(vars(robot.base_loop)),
            robot={"n_rays": robot.n_rays, "rate": robot.scan_rate, "sigma": robot.sigma, "fov": robot.fov},
        ),
    )


def _effects(
    spec: Spec, context: Context, setup: CaseSetup, nominal: TrueDrive, rng: np.random.Generator
) -> list[HiddenEffect]:
    if spec.suite == "none":
        return []
    if spec.suite == "foreign":
        turns = np.random.default_rng([ROOT_SEED, STREAMS[spec.kinds], 77])
        order = turns.permutation(foreign.KINDS[spec.kinds])
        name = spec.effect or str(order[spec.index % len(order)])
        return [foreign.draw(name, rng, context)]
    if spec.suite == "singles":
        order = np.random.default_rng([ROOT_SEED, STREAMS[spec.kinds], 78]).permutation(LIBRARY)
        name = spec.effect or str(order[spec.index % len(order)])
        row, turn = divmod(spec.index, len(order))
        # every block of 35 has all strengths; after 12 blocks every effect has had each, clean and dirty
        stratum = STRATUM_ORDER[(row + row // len(STRATUM_ORDER) + turn // 2) % len(STRATUM_ORDER)]
        strength = spec.strength
        if strength is None:
            strength = float((stratum + rng.random()) / len(STRATUM_ORDER))
        return [draw(name, strength, context, rng)]
    return _several(2 if spec.suite == "pairs" else 3, context, setup, nominal, rng)


def are_compatible(names: Sequence[str]) -> bool:
    """Tell whether effects may be hidden together."""
    for i, one in enumerate(names):
        for other in names[i + 1 :]:
            if one == other or any({one, other} <= group for group in INCOMPATIBLE_GROUPS):
                return False
            if other in INCOMPATIBLE_WITH.get(one, ()) or one in INCOMPATIBLE_WITH.get(other, ()):
                return False
    return True


def _several(
    n: int, context: Context, setup: CaseSetup, nominal: TrueDrive, rng: np.random.Generator
) -> list[HiddenEffect]:
    """Draw n compatible effects, each strong enough to leave a mark on its own."""
    chosen: list[HiddenEffect] = []
    for _ in range(60):
        name = str(rng.choice(LIBRARY))
        if not are_compatible([*(e.name for e in chosen), name]):
            continue
        effect = draw(name, float(rng.uniform(0.4, 1.0)), context, rng)
        if effect.place is not None and effect.place in {e.place for e in chosen}:
            continue
        truth = truth_of(setup, effect, [effect], context, nominal)
        ratio = truth["materiality_ratio"]
        if truth["material"] and (ratio is None or ratio >= 1.5):
            chosen.append(effect)
        if len(chosen) == n:
            break
    return chosen
