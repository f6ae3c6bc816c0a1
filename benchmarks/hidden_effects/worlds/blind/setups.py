"""A set-up before anything is logged: room, robot, flaws, base, and the drive with and without what is hidden."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from benchmarks.hidden_effects.case import Redraw
from benchmarks.hidden_effects.geometry import largest_part
from benchmarks.hidden_effects.log import Floats
from benchmarks.hidden_effects.worlds.blind.base import Base, V, X, Y
from benchmarks.hidden_effects.worlds.blind.changes import changed_room, jittered, put_fence, shove
from benchmarks.hidden_effects.worlds.blind.drive import STYLES, Driven, Link, Planner, drive
from benchmarks.hidden_effects.worlds.blind.effects import DRAWS, NEEDS_GAP, Hidden, material_size, rounded
from benchmarks.hidden_effects.worlds.blind.logged import Convention
from benchmarks.hidden_effects.worlds.blind.marks import travelled
from benchmarks.hidden_effects.worlds.blind.robots import Robot, draw_robot, robots_for
from benchmarks.hidden_effects.worlds.blind.rooms import PLANS, Room, draw_room
from benchmarks.hidden_effects.worlds.blind.scans import Flaws

N_RAYS = (70e3, 150e3)
"""Between which a run has so many rays, if that takes from SHORTEST to LONGEST."""
SHORTEST, LONGEST = 60.0, 150.0
"""[s]"""
PATH_CLEARANCE = 0.12
"""[m] beyond the footprint."""
LEAST_CLEARANCE = 0.01
"""[m] beyond the footprint, else the robot has touched something."""


@dataclass(kw_only=True, eq=False)
class Setup:
    """A set-up; `seed` is that of all noise."""

    seed: int
    is_dirty: bool
    robot: Robot
    room: Room
    """The map."""
    built_plain: Room
    """The room as it stands, but for what is hidden."""
    built: Room
    hidden: dict[str, Hidden]
    planner: Planner
    duration: float
    """[s]"""
    style: str
    flaws: Flaws | None
    base: Base
    link: Link
    stated_delay: float
    """[s] what a bench test shows."""
    dirty_rng: np.random.Generator

    def drive(self, base: Base, link: Link) -> Driven:
        """Drive the same plan on this base."""
        return drive(
            self.robot,
            self.planner,
            base,
            link,
            duration=self.duration,
            style=self.style,
            pilot_rng=np.random.default_rng([self.seed, 10]),
            link_rng=np.random.default_rng([self.seed, 11]),
        )


def draw_setup(names: tuple[str, ...], *, is_dirty: bool, rng: np.random.Generator) -> Setup:
    """Draw a set-up in which these effects are hidden, as far as they are known before the drive."""
    seed = int(rng.integers(1 << 30))
    kind = list(PLANS)[int(rng.integers(len(PLANS)))]
    kinds = robots_for(kind, needs_gap=bool(NEEDS_GAP & set(names)))
    robot = draw_robot(kinds[int(rng.integers(len(kinds)))], rng)
    room = draw_room(kind, robot.footprint, rng)
    hidden = {
        name: Hidden(name=name, values=DRAWS[name](rng, robot) if name in DRAWS else {}) for name in names
    }
    changed = changed_room(room, hidden, rng, robot)
    built_plain, built = (jittered(one, seed) if is_dirty else one for one in (room, changed))
    free = room.free().intersection(built_plain.free()).intersection(built.free())
    if "f_fence" in hidden:
        free = free.difference(put_fence(room, hidden["f_fence"], rng).buffer(0.02))
    if "f_shoved" in hidden:
        after = shove(built, hidden["f_shoved"], rng)
        hidden["f_shoved"].shapes["walls_after"] = after.walls
        free = free.intersection(after.free())
    planner = Planner(largest_part(free), robot.footprint + PATH_CLEARANCE)
    if len(planner.reachable) < 60:
        raise Redraw("the room is too small")
    duration = float(np.clip(rng.uniform(*N_RAYS) / (robot.n_rays * robot.scan_rate), SHORTEST, LONGEST))
    style = STYLES[int(rng.integers(len(STYLES)))]
    dirty_rng = np.random.default_rng([seed, 3])
    base = Base(
        tau=robot.tau,
        tau_fast=0.0,
        base_nominal=robot.wheel_base,
        base_true=robot.wheel_base,
        wheel_radius=robot.wheel_radius,
    )
    flaws, link = None, Link(delay=robot.delay)
    if is_dirty:
        flaws, base, link = _dirty(base, link, dirty_rng)
    return Setup(
        seed=seed,
        is_dirty=is_dirty,
        robot=robot,
        room=room,
        built_plain=built_plain,
        built=built,
        hidden=hidden,
        planner=planner,
        duration=duration,
        style=style,
        flaws=flaws,
        base=base,
        link=link,
        stated_delay=robot.delay + (round(link.period / 2, 4) if is_dirty else 0.0),
        dirty_rng=dirty_rng,
    )


def _dirty(base: Base, link: Link, rng: np.random.Generator) -> tuple[Flaws, Base, Link]:
    """Draw what every careful set-up has."""

    def within(sigma: float, most: float) -> float:
        return float(np.clip(rng.normal(0, sigma), -most, most))

    angle, size = rng.uniform(0, 6.28), rng.uniform(0.0006, 0.0016)
    flaws = Flaws(
        stamp_sigma=0.0015,
        mount=(size * np.cos(angle), size * np.sin(angle), within(0.0003, 0.0005)),
        range_bias=within(0.0006, 0.001),
        range_scale=within(0.00025, 0.0004),
        wide_share=rng.uniform(0.03, 0.08),
        lost_share=0.001,
    )
    both, difference = within(0.0006, 0.001), within(0.0003, 0.0005)
    base = base._replace(
        gain_right=1 + both + difference / 2,
        gain_left=1 + both - difference / 2,
        base_true=base.base_nominal * (1 + within(0.0008, 0.0016)),
        tau_fast=rng.uniform(0.002, 0.006),
    )
    link = Link(delay=link.delay, period=float(rng.choice([0.01, 0.02, 0.02, 0.04])), jitter=0.001)
    return flaws, base, link


def draw_convention(setup: Setup, rate_rng: np.random.Generator) -> Convention:
    """Draw how the driver of the wheels counts."""
    phase, skew = float(rate_rng.uniform(0, 1)), float(rate_rng.uniform(-1, 1) * 2e-3)
    if not setup.is_dirty:
        return Convention(phase=phase, skew=skew)
    return Convention(
        integration=str(setup.dirty_rng.choice(["exact", "mid", "rect"])),
        twist=str(setup.dirty_rng.choice(["back", "back", "smooth"])),
        age=float(setup.dirty_rng.uniform(0, 0.0015)),
        phase=phase,
        skew=skew,
    )


def visited(
    driven: Driven, radius: float, n: int, rng: np.random.Generator, *, moving: bool = False
) -> Floats:
    """Draw places (n, 2) [m] on the way, those first where the robot is within a radius [m] for longest."""
    log = driven.log[::50]
    if moving:
        log = log[np.abs(log[:, V]) > 0.05]
    places = log[rng.choice(len(log), n)][:, [X, Y]]
    shares = [(np.hypot(*(log[:, [X, Y]] - place).T) < radius).mean() for place in places]
    return np.asarray(places[np.argsort(shares)[::-1]])


def place_slip(hidden: Hidden, driven: Driven, rng: np.random.Generator) -> None:
    """Put a slippery patch where the robot drives often."""
    radius = rounded(rng.uniform(0.4, 0.75), 3)
    x, y = visited(driven, radius, 60, rng, moving=True)[int(rng.integers(0, 6))]
    hidden.xy = (rounded(x, 3), rounded(y, 3))
    hidden.values = {
        "s": rounded(material_size(rng, 0.05), 4),
        "x": hidden.xy[0],
        "y": hidden.xy[1],
        "r": radius,
    }


def changed_base(setup: Setup, plain: Driven, rng: np.random.Generator) -> tuple[Base, Link]:
    """Return base and link with what is hidden in them; a slippery patch is placed on the plain drive."""
    base, link, hidden = setup.base, setup.link, setup.hidden
    if "wheel_radius" in hidden:
        s = hidden["wheel_radius"]["s"]
        base = base._replace(gain_right=base.gain_right / (1 + s), gain_left=base.gain_left / (1 + s))
    if "wheel_radius_diff" in hidden:
        half = hidden["wheel_radius_diff"]["s"] / 2
        base = base._replace(gain_right=base.gain_right / (1 + half), gain_left=base.gain_left / (1 - half))
    if "wheel_base" in hidden:
        base = base._replace(base_true=base.base_true / (1 + hidden["wheel_base"]["s"]))
    if "wheel_slip" in hidden:
        place_slip(hidden["wheel_slip"], plain, rng)
        slip = hidden["wheel_slip"].values
        base = base._replace(slip=slip["s"], slip_x=slip["x"], slip_y=slip["y"], slip_r=slip["r"])
    if "actuator_lag" in hidden:
        base = base._replace(tau=base.tau + hidden["actuator_lag"]["tau"])
    if "dead_time" in hidden:
        link = Link(delay=link.delay + hidden["dead_time"]["L"], period=link.period, jitter=link.jitter)
    for name, fields in FIELDS.items():
        if name in hidden:
            base = base._replace(**{field: hidden[name][key] for field, key in fields.items()})
    if "f_sag" in hidden:
        base = base._replace(sag_rate=hidden["f_sag"]["end"] / setup.duration)
    if "f_dropout" in hidden:
        link = Link(
            delay=link.delay,
            period=link.period,
            jitter=link.jitter,
            outages=_outages(setup, hidden["f_dropout"]),
        )
    return base, link


FIELDS = {
    "speed_saturation": {"v_max": "v_max"},
    "f_wheelecc": {"eccentricity": "ecc"},
    "f_asym": {"left_turn_loss": "s"},
    "f_caster": {"caster_loss": "loss", "caster_time": "time"},
    "f_deadband": {"dead_omega": "w", "dead_v": "v"},
    "f_slew": {"ramp_v": "a", "ramp_omega": "alpha"},
    "f_wheelspin": {"spin_loss": "loss", "spin_above": "above"},
    "f_backlash": {"play": "play"},
    "f_sideslip": {"side_slide": "k"},
    "f_carpet": {"pile": "s", "pile_direction": "dir"},
}
"""Fields of Base that are parameters of an effect."""


def _outages(setup: Setup, hidden: Hidden) -> tuple[tuple[float, float], ...]:
    rng = np.random.default_rng([setup.seed, 12])
    n = round(hidden["per_minute"] * setup.duration / 60)
    begins, lengths = np.sort(rng.uniform(2, setup.duration - 3, n)), rng.uniform(0.3, hidden["longest"], n)
    return tuple((float(begin), float(begin + length)) for begin, length in zip(begins, lengths, strict=True))


def least_clearance(setup: Setup, driven: Driven) -> float:
    """Return the least distance [m] between footprint and walls; refuse collisions."""
    points = shapely.points(driven.log[::40][:, [X, Y]])
    # the planner's space keeps clear of a shoved thing at both its places
    free = setup.planner.free if "f_shoved" in setup.hidden else setup.built.free()
    off = shapely.distance(free.boundary, points)
    clearance = float(off.min()) - setup.robot.footprint
    if not shapely.contains(free, points).all() or clearance < LEAST_CLEARANCE:
        raise Redraw(f"collision {clearance:.3f}")
    return clearance


def check_variety(setup: Setup, driven: Driven) -> None:
    """Refuse a drive that is short, does not turn both ways, or hardly turns in place."""
    way, left, right, in_place = travelled(driven)
    if way < 0.12 * setup.duration * setup.robot.v or min(left, right) < 4 or in_place < 0.03:
        raise Redraw(f"dull drive {way:.1f} {left:.1f} {right:.1f} {in_place:.2f}")
