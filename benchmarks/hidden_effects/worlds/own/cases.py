"""Cases of every suite, made from seeds: the run as the robot logs it, and the truth beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.hidden_effects.case import Case, Spec
from benchmarks.hidden_effects.case import truth_of as truth_file
from benchmarks.hidden_effects.library import LIBRARY
from benchmarks.hidden_effects.worlds.own import foreign
from benchmarks.hidden_effects.worlds.own.case_setup import CaseSetup, context_of, draw_background
from benchmarks.hidden_effects.worlds.own.drive import TrueDrive
from benchmarks.hidden_effects.worlds.own.marks import truth_of
from benchmarks.hidden_effects.worlds.own.recording import record
from benchmarks.hidden_effects.worlds.own.robot import draw_base_loop, make_robot
from benchmarks.hidden_effects.worlds.own.simulated_scan import HiddenEffect
from benchmarks.hidden_effects.worlds.own.strengths import Context, draw
from benchmarks.hidden_effects.worlds.own.world import make_room

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
        "mixed_pixels",
        "glass",
        "mirror",
        "black_surface",
        "incidence_dropout",
        "tilt",
        "people",
        "moved_obstacle",
        "missing_obstacle",
        "unmapped_obstacle",
        "mount_yaw",
        "scan_skew",
        "max_range",
    }
}


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
    second = None
    if spec.has_second:
        other = replace(setup, path_seed=int(path_rng.integers(2**62)))
        second = record(other, other.drive(effects), effects, int(noise_rng.integers(2**62)))
    return Case(
        log=run,
        second=second,
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
        order = np.random.default_rng([ROOT_SEED, STREAMS[spec.kinds], 77]).permutation(
            foreign.KINDS[spec.kinds]
        )
        name = spec.effect or str(order[spec.index % len(order)])
        tools = {
            "room": context.room,
            "pick_wall": partial(context.pick_wall, least=0.08),
            "pick_obstacle": context.pick_obstacle,
        }
        return [foreign.draw(name, rng, tools)]
    if spec.suite == "singles":
        order = np.random.default_rng([ROOT_SEED, STREAMS[spec.kinds], 78]).permutation(LIBRARY)
        name = spec.effect or str(order[spec.index % len(order)])
        row, turn = divmod(spec.index, len(order))
        # every block of 35 has all strengths; after 12 blocks every effect has had each, clean and dirty
        stratum = STRATUM_ORDER[(row + row // len(STRATUM_ORDER) + turn // 2) % len(STRATUM_ORDER)]
        strength = (
            spec.strength
            if spec.strength is not None
            else float((stratum + rng.random()) / len(STRATUM_ORDER))
        )
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
