"""A case: a set-up, a drive, what is hidden, the log and the truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.blind_world import foreign, library, marks
from benchmarks.blind_world.changes import CHANGES
from benchmarks.blind_world.drive import Driven
from benchmarks.blind_world.errors import Redraw
from benchmarks.blind_world.files import Log
from benchmarks.blind_world.hidden import Hidden
from benchmarks.blind_world.marks import Mark, channel_of
from benchmarks.blind_world.odometry import Convention, Odometry, count
from benchmarks.blind_world.people import Leg, walkers
from benchmarks.blind_world.placing import PLACES, Scenery
from benchmarks.blind_world.reference import observe
from benchmarks.blind_world.scans import Scans, scan
from benchmarks.blind_world.setups import (
    Setup,
    changed_base,
    check_variety,
    draw_convention,
    draw_setup,
    least_clearance,
)

ROOT_SEED = 90417
SUITES = ("none", "singles", "pairs", "foreign")
KINDS = tuple(foreign.KINDS)
BACKGROUNDS = ("clean", "dirty")
MOST_ATTEMPTS = 60
FIRST_EPOCH = 1_760_000_000
"""[s] before which no run begins."""


@dataclass(frozen=True, kw_only=True)
class Spec:
    """Which case: everything else follows from it."""

    suite: str
    kinds: str = "development"
    """Development or report: a stream of seeds, and the kinds of foreign effects."""
    index: int
    background: str = ""
    """Clean or dirty; empty: in turn."""
    name: str = ""
    """This effect instead of the suite's turn."""

    @property
    def _turns(self) -> list[tuple[str, ...]]:
        if self.name:
            return [(self.name,)]
        turns: dict[str, list[tuple[str, ...]]] = {
            "none": [()],
            "singles": [(name,) for name in library.LIBRARY],
            "pairs": list(library.PAIRS),
            "foreign": [(name,) for name in foreign.KINDS[self.kinds]],
        }
        order = np.random.default_rng([ROOT_SEED, SUITES.index(self.suite)])
        return [turns[self.suite][k] for k in order.permutation(len(turns[self.suite]))]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of what is hidden."""
        return self._turns[self.index % len(self._turns)]

    @property
    def is_dirty(self) -> bool:
        """Every other case is dirty, and each effect in turn clean and dirty."""
        if self.background:
            return self.background == "dirty"
        n = len(self._turns)
        return (self.index + (self.index // n if n % 2 == 0 else 0)) % 2 == 1

    def rng(self, attempt: int) -> np.random.Generator:
        """Return the seed of everything, the same whatever other cases are made."""
        words = [
            ROOT_SEED,
            SUITES.index(self.suite),
            KINDS.index(self.kinds),
            self.index,
            self.is_dirty,
            attempt,
        ]
        return np.random.default_rng(words)


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """What is written."""

    log: Log
    arena: str
    """GeoJSON"""
    robot: str
    """YAML"""
    truth: dict[str, Any]


def make(spec: Spec) -> Case:
    """Make a case; draws that cannot be used, faint effects among them, are drawn again."""
    reasons = []
    for attempt in range(MOST_ATTEMPTS):
        try:
            return draw(spec, spec.rng(attempt), attempt)
        except Redraw as reason:
            reasons.append(str(reason))
    raise RuntimeError(f"{spec} could not be drawn in {MOST_ATTEMPTS} attempts: {reasons}")


def draw(spec: Spec, rng: np.random.Generator, attempt: int = 0) -> Case:
    """Draw a case once."""
    setup = draw_setup(spec.names, is_dirty=spec.is_dirty, rng=rng)
    plain = setup.drive(setup.base, setup.link)
    base, link = changed_base(setup, plain, rng)
    driven = plain if (base, link) == (setup.base, setup.link) else setup.drive(base, link)
    clearance = least_clearance(setup, driven)
    check_variety(setup, driven)
    plain_scans = _scan(setup, driven, {})
    scenery = Scenery(
        room=setup.room,
        built=setup.built_plain,
        robot=setup.robot,
        driven=driven,
        scans=plain_scans,
        duration=setup.duration,
        plain=not spec.is_dirty or spec.suite == "pairs",
    )
    legs = _place(spec, setup, scenery, rng)
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
    for name in spec.names:
        channel = channel_of(name)
        if channel == "pose":
            seen[name] = marks.pose_mark(setup.robot, reference)
        elif channel == "odometry":
            plain_odometry = _odometry(setup, plain, convention, {})
            seen[name] = marks.odometry_mark(driven, odometry, plain, plain_odometry)
        elif channel == "drive":
            seen[name] = marks.drive_mark(setup.robot, driven, plain, setup.stated_delay)
        else:
            alone = scans if len(spec.names) == 1 else _alone(setup, driven, name, legs, scans)
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
            robot=setup.robot,
            epoch_ns=(FIRST_EPOCH + int(rng.integers(10**7))) * 10**9 + int(rng.integers(10**9)),
            scan_stamps=scans.stamps,
            bearings=scans.bearings,
            ranges=scans.ranges,
            pose_stamps=reference.stamps,
            poses=reference.poses,
            odometry=odometry,
            command_stamps=driven.command_stamps,
            commands=driven.commands,
            arrival_seed=(setup.seed, 40),
        ),
        arena=setup.room.geojson(),
        robot=setup.robot.yaml(setup.stated_delay),
        truth=truth,
    )


def _place(spec: Spec, setup: Setup, scenery: Scenery, rng: np.random.Generator) -> tuple[Leg, ...]:
    """Place what depends on the run; return the legs of people."""
    for name, place in PLACES.items():
        if name in setup.hidden:
            place(scenery, setup.hidden[name], rng, setup.hidden)
    if "min_range" in setup.hidden:
        missing = -np.inf if spec.is_dirty else np.inf  # data sheets differ in how they tell it
        setup.hidden["min_range"].shapes["missing"] = np.array(missing)
    if "people" not in setup.hidden:
        return ()
    n_people = int(rng.integers(1, 4))
    walk_rng = np.random.default_rng([setup.seed, 8])
    return walkers(walk_rng, setup.planner.free, scenery.driven, setup.duration, n_people)


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
    told = [_told(setup.hidden[name], seen[name]) for name in spec.names]
    is_foreign = bool(told) and told[0]["name"] in foreign.NOTES
    is_finite = np.isfinite(plain_scans.ranges)
    residual = plain_scans.ranges[is_finite] - plain_scans.true_ranges[is_finite]
    way, left, right, in_place = marks.travelled(driven)
    return {
        "suite": spec.suite,
        "stream": spec.kinds,
        "index": spec.index,
        "seed": ROOT_SEED,
        "background": BACKGROUNDS[spec.is_dirty],
        "effects": [] if is_foreign else told,
        "foreign": told[0]["name"] if is_foreign else None,
        "foreign_effect": told[0] if is_foreign else None,
        "channel": told[0]["channel"] if told else None,
        "n_rays": int(scans.ranges.size),
        "note": foreign.NOTES[told[0]["name"]] if is_foreign else _note(setup.hidden),
        "made": {
            "room": setup.room.name,
            "robot": setup.robot.kind,
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
    }


def _told(hidden: Hidden, mark: Mark) -> dict[str, Any]:
    location = {"name": hidden.place, "xy": hidden.xy}
    return {
        "name": hidden.name,
        "channel": channel_of(hidden.name),
        "parameters": {key: float(value) for key, value in hidden.values.items()},
        "location": location if hidden.place or hidden.xy else None,
        "materiality_ratio": library.materiality_ratio(hidden.name, hidden.values),
        "mark": {
            "changed_share": mark.changed_share,
            "rmse_over_sigma": mark.rms_over_sigma,
            "growth": mark.growth,
        },
        "material": mark.is_seen,
        "deterministic": hidden.name in library.DETERMINISTIC,
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
