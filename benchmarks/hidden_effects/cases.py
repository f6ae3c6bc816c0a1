"""Cases of every suite, made from seeds: the run as the robot logs it, and the truth beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from benchmarks.hidden_effects import foreign
from benchmarks.hidden_effects.case_setup import CaseSetup, context_of, draw_background
from benchmarks.hidden_effects.drive import TrueDrive
from benchmarks.hidden_effects.marks import channel_of, truth_of
from benchmarks.hidden_effects.physics import CHANNEL, LIBRARY
from benchmarks.hidden_effects.recording import record
from benchmarks.hidden_effects.robot import draw_base_loop, make_robot
from benchmarks.hidden_effects.simulated_scan import HiddenEffect
from benchmarks.hidden_effects.strengths import Context, draw
from benchmarks.hidden_effects.world import make_room
from logs import Run

SUITES = ("none", "singles", "pairs", "triples", "foreign")
BACKGROUNDS = ("clean", "dirty", "wrong_tolerances")
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


@dataclass(frozen=True, kw_only=True)
class CaseSpec:
    """Which case: everything else follows from it."""

    suite: str
    stream: str
    index: int
    background: str
    second: bool = False
    effect: str | None = None
    """A single or foreign effect by name, instead of the suite's turn."""
    strength: float | None = None
    """0...1 instead of the suite's turn."""

    @property
    def seed(self) -> int:
        """A seed from the stream of the suite; development and report never meet."""
        key = [ROOT_SEED, STREAMS[self.stream], SUITES.index(self.suite), self.index]
        return int(np.random.SeedSequence(key).generate_state(1, np.uint64)[0] >> 1)


def make_specs(
    suite: str, stream: str, n: int, *, background: str | None = None, second: bool = False
) -> list[CaseSpec]:
    """Return the first n cases of a suite; without a background, every other one is dirty."""
    every = [background] if background else ["clean", "dirty"]
    return [
        CaseSpec(suite=suite, stream=stream, index=k, background=every[k % len(every)], second=second)
        for k in range(n)
    ]


def make_case(spec: CaseSpec) -> tuple[Run, Run | None, str, str, dict[str, Any]]:
    """Return (run, second run or None, arena GeoJSON, robot YAML, truth)."""
    seeds = np.random.SeedSequence(spec.seed).spawn(6)
    room_rng, robot_rng, path_rng, back_rng, effect_rng, noise_rng = map(np.random.default_rng, seeds)
    room, robot = make_room(room_rng), make_robot(robot_rng)
    background = draw_background(spec.background, back_rng)
    if spec.background != "clean":
        robot = replace(robot, base_loop=draw_base_loop(np.random.default_rng([spec.seed, 5])))
    path_seed = int(path_rng.integers(2**62))
    setup = CaseSetup(
        room=room,
        robot=robot,
        background=background,
        seed=spec.seed,
        path_seed=path_seed,
        back_seed=int(back_rng.integers(2**62)),
    )
    nominal = setup.drive([])
    context = context_of(setup, nominal)
    effects = _effects(spec, context, setup, nominal, effect_rng)
    driven = setup.drive(effects)
    run = record(setup, driven, effects, int(noise_rng.integers(2**62)))
    truths = [truth_of(setup, effect, effects, context, driven) for effect in effects]
    second = None
    if spec.second:
        other = replace(setup, path_seed=int(path_rng.integers(2**62)))
        second = record(other, other.drive(effects), effects, int(noise_rng.integers(2**62)))
    hidden = [effect.name for effect in effects if effect.name not in CHANNEL]
    truth = {
        "suite": spec.suite,
        "stream": spec.stream,
        "index": spec.index,
        "seed": spec.seed,
        "background": spec.background,
        "background_values": dict(vars(background)),
        "base_loop": None if robot.base_loop is None else dict(vars(robot.base_loop)),
        "effects": [t for t in truths if t["name"] in CHANNEL],
        "foreign": hidden[0] if hidden else None,
        "foreign_effect": next((t for t in truths if t["name"] not in CHANNEL), None),
        "channel": next((channel_of(e.name) for e in effects), None),
        "n_rays": int(run.ranges.size),
        "robot": {"n_rays": robot.n_rays, "rate": robot.rate, "sigma": robot.sigma, "fov": robot.fov},
    }
    return run, second, room.geojson(), robot.yaml(), truth


def _effects(
    spec: CaseSpec, context: Context, setup: CaseSetup, nominal: TrueDrive, rng: np.random.Generator
) -> list[HiddenEffect]:
    if spec.suite == "none":
        return []
    if spec.suite == "foreign":
        order = np.random.default_rng([ROOT_SEED, STREAMS[spec.stream], 77]).permutation(
            foreign.KINDS[spec.stream]
        )
        name = spec.effect or str(order[spec.index % len(order)])
        tools = {
            "room": context.room,
            "pick_wall": partial(context.pick_wall, least=0.08),
            "pick_obstacle": context.pick_obstacle,
        }
        return [foreign.DRAW[name](rng, tools)]
    if spec.suite == "singles":
        order = np.random.default_rng([ROOT_SEED, STREAMS[spec.stream], 78]).permutation(LIBRARY)
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
