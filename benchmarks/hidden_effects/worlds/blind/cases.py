"""A case: a set-up, a drive, what is hidden, the log and the truth."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.hidden_effects.case import Case, Redraw, Spec, truth_of
from benchmarks.hidden_effects.library import DETERMINISTIC, LIBRARY, materiality_ratio
from benchmarks.hidden_effects.log import Log, Odometry
from benchmarks.hidden_effects.worlds.blind import effects, marks
from benchmarks.hidden_effects.worlds.blind.changes import CHANGES
from benchmarks.hidden_effects.worlds.blind.drive import Driven
from benchmarks.hidden_effects.worlds.blind.effects import Hidden
from benchmarks.hidden_effects.worlds.blind.logged import Convention, count, observe
from benchmarks.hidden_effects.worlds.blind.marks import Mark, channel_of
from benchmarks.hidden_effects.worlds.blind.placing import PLACED, place
from benchmarks.hidden_effects.worlds.blind.robots import TOLERANCES
from benchmarks.hidden_effects.worlds.blind.scans import Scans, scan
from benchmarks.hidden_effects.worlds.blind.scene import Leg, walkers
from benchmarks.hidden_effects.worlds.blind.setups import (
    Setup,
    changed_base,
    check_variety,
    draw_convention,
    draw_setup,
    least_clearance,
)

ROOT_SEED = 90417
SUITES = ("none", "singles", "pairs", "foreign")
STREAMS = {"dev": "development", "report": "report"}
MOST_ATTEMPTS = 60
FIRST_EPOCH = 1_760_000_000
"""[s] before which no run begins."""


def names_of(spec: Spec) -> tuple[tuple[str, ...], int]:
    """Return the names of what is hidden, and how many turns the suite has."""
    if spec.effect:
        return (spec.effect,), 1
    turns: dict[str, list[tuple[str, ...]]] = {
        "none": [()],
        "singles": [(name,) for name in LIBRARY],
        "pairs": list(effects.PAIRS),
        "foreign": [(name,) for name in effects.KINDS[STREAMS[spec.kinds]]],
    }
    n = len(turns[spec.suite])
    order = np.random.default_rng([ROOT_SEED, SUITES.index(spec.suite)]).permutation(n)
    return turns[spec.suite][order[spec.index % n]], n


def make(spec: Spec) -> Case:
    """Make a case; draws that cannot be used, faint effects among them, are drawn again."""
    reasons = []
    names, n = names_of(spec)
    is_dirty = spec.background_in_turn(n) == "dirty"
    key = [ROOT_SEED, SUITES.index(spec.suite), list(STREAMS).index(spec.kinds), spec.index, is_dirty]
    for attempt in range(MOST_ATTEMPTS):
        try:
            return draw(spec, names, np.random.default_rng([*key, attempt]), attempt, is_dirty=is_dirty)
        except Redraw as reason:
            reasons.append(str(reason))
    raise RuntimeError(f"{spec} could not be drawn in {MOST_ATTEMPTS} attempts: {reasons}")


def draw(
    spec: Spec, names: tuple[str, ...], rng: np.random.Generator, attempt: int = 0, *, is_dirty: bool
) -> Case:
    """Draw a case once."""
    setup = draw_setup(names, is_dirty=is_dirty, rng=rng)
    plain = setup.drive(setup.base, setup.link)
    base, link = changed_base(setup, plain, rng)
    driven = plain if (base, link) == (setup.base, setup.link) else setup.drive(base, link)
    clearance = least_clearance(setup, driven)
    check_variety(setup, driven)
    plain_scans = _scan(setup, driven, {})
    legs = _place(setup, driven, plain_scans, rng, plain=not is_dirty or spec.suite == "pairs")
    scans = _scan(setup, driven, setup.hidden, legs)
    if "people" in setup.hidden:
        setup.hidden["people"].values = {"p": float(round(scans.person_share, 5))}
    rate_rng = np.random.default_rng([setup.seed, 50])
    reference = observe(
        setup.robot,
        setup.room,
        driven,
        setup.hidden,
        duration=setup.duration,
        rate_rng=rate_rng,
        noise_rng=np.random.default_rng([setup.seed, 20]),
        dirty_rng=setup.dirty_rng if setup.is_dirty else None,
    )
    convention = draw_convention(setup, rate_rng)
    odometry = _odometry(setup, driven, convention, setup.hidden)
    seen = {}
    for name in names:
        channel = channel_of(name)
        if channel == "pose":
            seen[name] = marks.pose_mark(setup.robot, reference)
        elif channel == "odometry":
            plain_odometry = _odometry(setup, plain, convention, {})
            seen[name] = marks.odometry_mark(driven, odometry, plain, plain_odometry)
        elif channel == "drive":
            seen[name] = marks.drive_mark(setup.robot, driven, plain, setup.stated_delay)
        else:
            alone = scans if len(names) == 1 else _alone(setup, driven, name, legs, scans)
            seen[name] = marks.scan_mark(name, setup.robot, alone, plain_scans)
        if not seen[name].is_seen:
            raise Redraw(f"faint {name}: {seen[name]} {setup.hidden[name].values}")
    truth = _truth(spec, setup, seen, driven, scans, plain_scans)
    truth["made"] |= {
        "attempt": attempt,
        "least_clearance": round(clearance, 3),
        "odometry": vars(convention),
    }
    return Case(
        log=Log(
            epoch_ns=(FIRST_EPOCH + int(rng.integers(10**7))) * 10**9 + int(rng.integers(10**9)),
            **setup.robot.of_log(),
            twist_sigmas=(setup.robot.sigma_v, setup.robot.sigma_omega),
            scan_stamps=scans.stamps,
            ranges=scans.ranges,
            pose_stamps=reference.stamps,
            poses=reference.poses,
            odometry=odometry,
            cmd_stamps=driven.command_stamps,
            commands=driven.commands,
            arrival_seed=(setup.seed, 40),
        ),
        map={"arena.geojson": setup.room.geojson(digits=5)},
        world="blind_world",
        robot=setup.robot.yaml_text(
            sigma_v=setup.robot.sigma_v,
            sigma_omega=setup.robot.sigma_omega,
            odometry_rate=setup.robot.odometry_rate,
            delay=setup.stated_delay,
            tolerances=TOLERANCES,
        ),
        truth=truth,
    )


def _place(
    setup: Setup, driven: Driven, scans: Scans, rng: np.random.Generator, *, plain: bool
) -> tuple[Leg, ...]:
    """Place what depends on the run; return the legs of people."""
    for name in PLACED:
        if name in setup.hidden:
            place(setup, driven, scans, setup.hidden[name], rng, plain=plain)
    if "min_range" in setup.hidden:
        missing = -np.inf if setup.is_dirty else np.inf  # data sheets differ in how they tell it
        setup.hidden["min_range"].shapes["missing"] = np.array(missing)
    if "people" not in setup.hidden:
        return ()
    n_people = int(rng.integers(1, 4))
    walk_rng = np.random.default_rng([setup.seed, 8])
    return walkers(walk_rng, setup.planner.free, driven, setup.duration, n_people)


def _scan(setup: Setup, driven: Driven, hidden: dict[str, Hidden], legs: tuple[Leg, ...] = ()) -> Scans:
    is_changed = any(name in CHANGES or name == "f_shoved" for name in hidden)
    return scan(
        setup.robot,
        driven,
        (setup.built if is_changed else setup.built_plain).walls,
        hidden,
        setup.seed,
        setup.flaws,
        legs,
        setup.room.outer if "f_multipath" in hidden else None,
    )


def _alone(setup: Setup, driven: Driven, name: str, legs: tuple[Leg, ...], scans: Scans) -> Scans:
    """Return the scans of the same drive with one of several effects."""
    if name in CHANGES and sum(other in CHANGES for other in setup.hidden) > 1:
        return scans  # the room is changed as a whole
    return _scan(setup, driven, {name: setup.hidden[name]}, legs if name == "people" else ())


def _odometry(setup: Setup, driven: Driven, convention: Convention, hidden: dict[str, Hidden]) -> Odometry:
    rng = np.random.default_rng([setup.seed, 30])
    if "pose_clock_offset" in hidden:
        late = vars(convention) | {"age": convention.age + hidden["pose_clock_offset"]["tau"]}
        return count(setup.robot, driven, rng, Convention(**late))
    if "f_gyro" in hidden:
        bias, walk = hidden["f_gyro"]["bias"], hidden["f_gyro"]["walk"]
        return count(
            setup.robot,
            driven,
            rng,
            convention,
            gyro_bias=lambda t: bias + walk * np.sin(2 * np.pi * t / setup.duration * 0.7),
        )
    if "f_lostticks" in hidden:
        lost = hidden["f_lostticks"]
        return count(setup.robot, driven, rng, convention, lost_above=lost["above"], lost_share=lost["frac"])
    return count(setup.robot, driven, rng, convention)


def _truth(
    spec: Spec, setup: Setup, seen: dict[str, Mark], driven: Driven, scans: Scans, plain_scans: Scans
) -> dict[str, Any]:
    told = [_told(one, seen[name]) for name, one in setup.hidden.items()]
    is_foreign = bool(told) and told[0]["name"] in effects.NOTES
    is_finite = np.isfinite(plain_scans.ranges)
    residual = plain_scans.ranges[is_finite] - plain_scans.true_ranges[is_finite]
    way, left, right, in_place = marks.travelled(driven)
    return truth_of(
        spec,
        told,
        is_foreign=is_foreign,
        seed=ROOT_SEED,
        stream=STREAMS[spec.kinds],
        background="dirty" if setup.is_dirty else "clean",
        n_rays=int(scans.ranges.size),
        note=effects.NOTES[told[0]["name"]] if is_foreign else _note(setup.hidden),
        made={
            "room": setup.room.name,
            "robot": setup.robot.name,
            "style": setup.style,
            "duration": round(setup.duration, 1),
            "way": round(way, 1),
            "turned_left": round(left, 1),
            "turned_right": round(right, 1),
            "share_turned_in_place": round(in_place, 3),
            "control_period": setup.link.period,
            "plain_residual_over_sigma": round(float(residual.std() / setup.robot.sigma), 3),
            "no_return_share": round(float((~np.isfinite(scans.ranges)).mean()), 4),
        },
    )


def _told(hidden: Hidden, mark: Mark) -> dict[str, Any]:
    location = {"name": hidden.place, "xy": hidden.xy}
    return {
        "name": hidden.name,
        "channel": channel_of(hidden.name),
        "parameters": {key: float(value) for key, value in hidden.values.items()},
        "location": location if hidden.place or hidden.xy else None,
        "materiality_ratio": materiality_ratio(hidden.name, hidden.values),
        "mark": {
            "changed_share": mark.changed_share,
            "rmse_over_sigma": mark.rms_over_sigma,
            "growth": mark.growth,
        },
        "material": mark.is_seen,
        "deterministic": hidden.name in DETERMINISTIC,
    }


def _note(hidden: dict[str, Hidden]) -> str:
    """Return what to know when judging an answer about effects of the library."""
    notes = []
    if "min_range" in hidden:
        notes.append(f"missing near returns are written as {float(hidden['min_range'].shapes['missing'])}")
    if "glass" in hidden and hidden["glass"]["depth"] == 0:
        notes.append("rays through the pane see what the room has behind the wall, else nothing")
    if "pose_clock_offset" in hidden:
        notes.append(
            "pose and twist of /odom are late, /cmd_vel and /pose are not: commands look tau late too"
        )
    if "people" in hidden:
        notes.append("p is the share of rays that ended at a leg")
    return "; ".join(notes)
