"""Short cases by which numbers are judged, and what is said of each: a text that changes if an answer does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.resources import files
from itertools import accumulate
from pathlib import Path

import numpy as np

import logs
from benchmarks.hidden_effects.case import Spec
from benchmarks.hidden_effects.case import geojson as arena_text
from benchmarks.hidden_effects.entrants.product import run_of
from benchmarks.hidden_effects.worlds.own.cases import make
from benchmarks.locate import aligned, office_run
from benchmarks.offices import office
from benchmarks.places import arena_named, vehicle
from benchmarks.planted_things import Scans, with_things
from benchmarks.sensitivity import Answer
from benchmarks.uncalibrated_laser import Laser, free_poses
from benchmarks.watch import Watched
from logs import Run
from logs.run import RangeSensor
from logs.transforms import compose, invert
from planners import plan
from planners.maps import geojson
from planners.types import Bools
from sensorgraph.building.build import build
from sensorgraph.diagnosis.diagnose import diagnose, diagnose_motion
from sensorgraph.diagnosis.result import ChannelResult
from sensorgraph.loading import load_arena
from sensorgraph.localization.locate import walls_of_place
from sensorgraph.localization.mapping import map_run
from sensorgraph.models.base import OFF_DISTANCE
from sensorgraph.surveying import trends
from sensorgraph.surveying.building import changed_places
from sensorgraph.watching.watcher import watch_scans
from sensorgraph.world.raycast import cast
from sensorgraph.world.robot import parse_robot

N_SCANS = 800
"""Number of scans of a drive that are located."""


@dataclass(frozen=True, kw_only=True)
class Hidden:
    """A case of the diagnosis by what is hidden in it."""

    suite: str
    effect: str = ""
    strength: float = 0.35
    """Of a single effect: weak ones are the first to go."""
    background: str = "dirty"
    index: int = 5
    duration: float = 30.0
    """[s] of the run that is used."""

    @property
    def label(self) -> str:
        """What a table calls it."""
        return self.effect or f"nothing, {self.background}"

    def answer(self, channel: str) -> Answer:
        """Return what diagnoses it."""
        spec = Spec(
            suite=self.suite,
            index=self.index,
            background=self.background,
            effect=self.effect,
            strength=self.strength if self.suite == "singles" else None,
        )
        case = make(spec)
        run = run_of(case)
        kept = run.stamps < run.stamps[0] + self.duration
        run = replace(run, stamps=run.stamps[kept], ranges=run.ranges[kept])
        robot, arena = parse_robot(case.robot), geojson.loads(str(case.map["arena.geojson"]))
        if channel == "motion":
            return lambda: said(diagnose_motion(run, robot, ()))
        unused = ("odom_stamps", "odometry", "odom_twists", "cmd_stamps", "commands")
        run = replace(run, **{name: getattr(run, name)[:0] for name in unused})  # the motion channels' input
        return lambda: said([diagnose(run, arena, robot, plan_next=False).channels["scan"]])


def said(results: Sequence[ChannelResult]) -> str:
    """Return names with their places, and whether something is unknown."""
    names = sorted(a.name + (f" {a.place}" if a.place else "") for r in results for a in r.effects)
    doubt = ["unknown"] if any(r.unknown for r in results) else []
    return ", ".join([*names, *doubt]) or "silent"


def located(office_seed: int) -> Answer:
    """Return what locates the first part of a drive in a simulated office: scans that are not, and the error."""
    run, truth = office_run(office_seed)
    run, truth = run.take_scans(slice(N_SCANS)), truth[:N_SCANS]

    def answer() -> dict[str, float]:
        found = map_run(run)
        off, _ = aligned(found.poses, truth)
        ate = np.sqrt((off[:, :2] ** 2).sum(axis=1).mean())
        return {"not located": N_SCANS - found.status.count("ok"), "ATE [mm]": float(1000 * ate)}

    return answer


def predicted(run: Run, **options: object) -> Answer:
    """Return what builds a graph without every fifth scan and scores it on these: error, log score, share answered."""
    held: Bools = np.arange(run.n_scans) % 5 == 4
    train, test = run.take_scans(~held), run.take_scans(held)
    poses = logs.pair(test).poses

    def answer() -> dict[str, float]:
        graph = build([train], **options)  # type: ignore[arg-type]
        found = graph.predict(poses)
        hit = np.isfinite(test.ranges) & np.isfinite(found.mode)
        off = np.abs(found.mode - test.ranges)[hit]
        score = graph.log_likelihood(test.ranges, poses, correlated=False, per_ray=True)
        return {
            "median [mm]": float(1000 * np.median(off)), "score [nats]": float(score.mean()),
            "wrong [%]": float(100 * (off > OFF_DISTANCE).mean()),
            "not answered [%]": float(100 * (1 - found.answered.mean())),
        }  # fmt: skip

    return answer


def scans(n: int, n_rays: int, *, place: str = "", laser: bool = False, cone: float = 0.0) -> Run:
    """Return scans of a laser, perhaps one that is not calibrated, or of a ring of sonars, in a small random office."""
    rng = np.random.default_rng(0)
    arena = load_arena(place) if place else geojson.loads(office(1, width=7.0, depth=5.0, rooms=2))
    poses, stamps = free_poses(arena, n, rng), np.arange(n) / 10.0
    if laser:
        hidden = Laser.drawn(rng)
        ranges = hidden.readings(arena, poses)
        sensor = replace(hidden.sensor(), mount=np.array([0.10, 0.0, 0.0]))
        poses = poses + rng.normal(size=poses.shape) * [0.005, 0.005, 0.003]
    else:
        half = np.pi if cone else np.pi / 2
        bearings = np.linspace(-half, half, n_rays, endpoint=not cone)
        sensor = RangeSensor(
            bearings=bearings, range_min=0.02, range_max=8.0, sigma=0.01,
            cones=np.full(n_rays, cone),
        )  # fmt: skip
        fan = np.linspace(-cone / 2, cone / 2, 9 if cone else 1)
        thin = [
            cast(arena, poses, replace(sensor, bearings=bearings + a, cones=np.zeros(n_rays))) for a in fan
        ]
        ranges = np.min([one.ranges for one in thin], axis=0)
    ranges = ranges + sensor.sigma * rng.normal(size=ranges.shape)
    return Run(sensor=sensor, stamps=stamps, ranges=ranges, pose_stamps=stamps, poses=poses)


def of_log(first: int, n: int, every: int) -> Run:
    """Return a piece of the shipped log, with every so-manieth ray, at the poses of its wheels."""
    run = logs.read(Path(str(files("sensorgraph.data") / "fr079.clf.bz2"))).take_scans(
        slice(first, first + n)
    )
    return replace(
        run, sensor=replace(run.sensor, bearings=run.sensor.bearings[::every]), ranges=run.ranges[:, ::every],
        pose_stamps=run.odom_stamps, poses=run.odometry,
    )  # fmt: skip


def driven(n: int, n_rays: int) -> Run:
    """Return a drive along walls with a few rays."""
    run, truth = office_run(1)
    rays = np.linspace(0, run.sensor.n_rays - 1, n_rays).astype(int)
    sensor = replace(run.sensor, bearings=run.sensor.bearings[rays])
    run = replace(run, sensor=sensor, ranges=run.ranges[:, rays], pose_stamps=run.stamps, poses=truth)
    return run.take_scans(slice(n))


def planned(walls: dict[str, list[tuple[float, float]]], drive: str = "diff", **options: object) -> Answer:
    """Return what plans a drive in a small arena: its coverage and its time over the reference time."""
    arena = geojson.loads(arena_text("small", walls))

    def answer() -> dict[str, float]:
        found = plan(arena, vehicle(drive), headings=8, **options).report  # type: ignore[arg-type]
        return {
            "not covered [%]": 100 * (1 - found["coverage"]), "T / T_ref": found["ratio"],
            "violations": found["limit_violations"],
        }  # fmt: skip

    return answer


RADIUS = 0.15
"""[m] of a planted thing."""


def watched(office_seed: int) -> Answer:
    """Return what watches a drive to and fro, with a new thing, missing returns, a worn wheel, and a kidnap at its end."""
    run, truth = office_run(office_seed)
    half, n, rng = run.n_scans // 2, 400, np.random.default_rng(0)
    first = run.take_scans(slice(half))
    graph = build([replace(first, pose_stamps=first.stamps, poses=truth[:half])], calibrate=False)
    way, carried = half + np.arange(n), 3 * n
    index = np.concatenate([way, way[::-1], way, way[50:150]])
    poses, stamps = truth[index], np.arange(len(index)) / 10.0
    steps = compose(invert(poses[:-1]), poses[1:]) * [1.03, 1.03, 1.0]
    steps[carried - 1] = 0.0
    scans = Watched(
        stamps=stamps, ranges=run.ranges[index], believed=poses, changed=carried,
        odometry=np.array(list(accumulate(steps, compose, initial=poses[0]))),
    )  # fmt: skip
    thing = compose(truth[half + n // 2], np.array([0.0, 0.6, 0.0]))
    ranges = with_things(
        Scans(stamps=stamps, poses=poses, ranges=scans.ranges), run.sensor, [(thing, RADIUS)], rng
    )
    scans = replace(scans, ranges=ranges)
    scans.ranges[rng.random(scans.ranges.shape) < 0.05] = np.inf
    scans.believed[carried:] = compose(poses[carried - 1], compose(invert(poses[carried]), poses[carried:]))
    planted = {"missing_returns", "wheel_radius"}

    def answer() -> dict[str, float]:
        said = list(watch_scans(graph, scans.observations(), run.sensor))
        wrong = np.array([one.t for one in said if one.pose.status != "ok"])
        late = wrong[wrong >= stamps[carried]] - stamps[carried]
        faults = {one.name for status in said for one in status.faults}
        return {
            "false alarms": float(len(wrong) - len(late)), "alarm after [s]": float(late.min(initial=99.0)),
            "new things": float(len([one for one in said[-1].changes if one.kind == "new"])),
            "faults missed": float(len(planted - faults)), "other faults": float(len(faults - planted)),
        }  # fmt: skip

    return answer


def fleet_trends() -> Answer:
    """Return what looks for steps in the series of 30 robots, half of which change, and for one that differs from its sisters."""
    rng = np.random.default_rng(0)
    series = []
    for robot in range(30):
        values = rng.normal(0.0, 0.003, 20) + 0.012 * (robot % 2) * (np.arange(20) >= rng.integers(5, 15))
        series.append(values)
    t, sigmas = np.arange(20.0), np.full(20, 0.002)
    levels = {f"robot{k}": (float(rng.normal(0.0, 0.003)) + 0.05 * (k == 3), 0.002) for k in range(12)}

    def answer() -> dict[str, float]:
        steps = [trends.steps_of("way_scale", t, values, sigmas) for values in series]
        found = [any(one.probability > trends.SURE for one in some) for some in steps]
        odd = {one.robot for one in trends.odd_robots("way_scale", levels) if one.probability > trends.SURE}
        return {
            "steps missed": 15.0 - sum(found[1::2]), "false steps": float(sum(found[::2])),
            "odd missed": float("robot3" not in odd), "false odd": float(len(odd - {"robot3"})),
        }  # fmt: skip

    return answer


def surveyed(office_seed: int) -> Answer:
    """Return what compares a drive with the walls of its place, in which a thing is new and all ranges are 5 cm long."""
    run, truth = office_run(office_seed)
    scans = Scans(stamps=run.stamps, poses=truth, ranges=run.ranges)
    thing = compose(truth[run.n_scans // 2], np.array([0.0, 0.8, 0.0]))
    ranges = with_things(scans, run.sensor, [(thing, RADIUS)], np.random.default_rng(0)) + 0.05
    run = replace(run, ranges=ranges, pose_stamps=run.stamps, poses=truth)
    walls = walls_of_place(arena_named(str(office_seed))).walls

    def answer() -> dict[str, float]:
        found = changed_places(run, walls)
        near = np.hypot(*(found.new - thing[:2]).T) < 0.5
        offset = np.nan if found.offset is None else found.offset[0]
        return {
            "thing missed": float(not near.any()), "other cells": float((~near).sum() + len(found.gone)),
            "offset [mm]": 1000 * offset,
        }  # fmt: skip

    return answer


def box(x0: float, y0: float, x1: float, y1: float) -> list[tuple[float, float]]:
    """Return the corners of a box."""
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


ROOM = {"small": box(0, 0, 2.5, 2.0), "desk": box(1.1, 0.7, 1.5, 1.1)}
ROOMS = {"small": box(0, 0, 4.0, 2.0), "wall": box(1.95, 0, 2.05, 1.1), "leg": box(3.0, 0.9, 3.05, 0.95)}


@dataclass(frozen=True, kw_only=True)
class Group:
    """Packages whose numbers are varied, and the cases that judge them."""

    packages: tuple[str, ...]
    cases: dict[str, Callable[[], Answer]]


SCAN = (
    Hidden(suite="none", index=2),
    Hidden(suite="singles", effect="range_bias"),
    Hidden(suite="singles", effect="unmapped_obstacle"),
    Hidden(suite="foreign", effect="bias_jump", duration=70.0),  # it jumps at 42 s
    Hidden(suite="foreign", effect="crosstalk_rotating"),
)
MOTION = (
    Hidden(suite="none", index=2),
    Hidden(suite="singles", effect="wheel_base", strength=0.5),
    Hidden(suite="singles", effect="wheel_slip", strength=0.6),
    Hidden(suite="singles", effect="dead_time"),
    Hidden(suite="foreign", effect="battery_sag"),
)
MODELS = "sensorgraph.models"
FACES = {"office": lambda: predicted(scans(150, 91), calibrate=False)}
GROUPS = {
    "motion": Group(
        packages=("sensorgraph.diagnosis.motion",),
        cases={one.label: partial(one.answer, "motion") for one in MOTION},
    ),
    "scan": Group(
        packages=("sensorgraph.diagnosis.scan",),
        cases={one.label: partial(one.answer, "scan") for one in SCAN},
    ),
    "localization": Group(
        packages=("sensorgraph.localization",), cases={"office 101": partial(located, 101)}
    ),
    "faces": Group(packages=(f"{MODELS}.faces",), cases=FACES),
    "calibration": Group(
        packages=(f"{MODELS}.calibration",),
        cases={"laser": lambda: predicted(scans(60, 91, laser=True), cells=False)},
    ),
    "cells": Group(
        packages=(f"{MODELS}.cells",), cases={"fr079": lambda: predicted(of_log(0, 80, 8), model="cells")}
    ),
    "cones": Group(
        packages=(f"{MODELS}.cones",), cases={"sonars": lambda: predicted(scans(200, 16, cone=0.4))}
    ),
    "polynomial": Group(
        packages=(f"{MODELS}.polynomial",),
        cases={"square": lambda: predicted(scans(400, 6, place="square"), model="polynomial")},
    ),
    "narmax": Group(
        packages=(f"{MODELS}.narmax",),
        cases={"drive": lambda: predicted(driven(400, 8), model="narmax")},
    ),
    "building": Group(
        packages=(
            "sensorgraph.building", f"{MODELS}.residual_memory", f"{MODELS}.place_noise", f"{MODELS}.likelihood",
            f"{MODELS}.distribution", f"{MODELS}.mixture", f"{MODELS}.unknown_space", f"{MODELS}.base",
            f"{MODELS}.stored_numbers", f"{MODELS}.stretches",
        ),
        cases=FACES,
    ),
    "planners": Group(
        packages=("planners",),
        cases={
            "two rooms": lambda: planned(ROOMS),
            "room, anytime": lambda: planned(ROOM, order="anytime"),
            "room, stop_and_spin": lambda: planned(ROOM, planner="stop_and_spin"),
        },
    ),
    "cars": Group(
        packages=("planners.cars", "planners.search", "planners.methods"),
        cases={"room, dubins": lambda: planned(ROOM, "dubins")},
    ),
    "surveying": Group(
        packages=("sensorgraph.surveying",),
        cases={"trends": fleet_trends, "office 101": lambda: surveyed(101)},
    ),
    "watching": Group(packages=("sensorgraph.watching",), cases={"office 101": lambda: watched(101)}),
}  # fmt: skip
