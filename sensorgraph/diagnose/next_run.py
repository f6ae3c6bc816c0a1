"""The next run: a drive made to tell apart what this run could not, chosen by the evidence it is expected to bring.

Motions that may tell something (spins, sweeps and shuttles at places all over the room, at the limits of speed) are
asked what they would bring per second; the time is divided among them so that they bring most together; the best are
drawn as one closed-form curve, with the planner's moves, turns and connections, in several versions. The version that
is expected to bring most is the next run, and random driving is what it is compared with.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse.csgraph import shortest_path

from planners.arena import Arena, Bools, Floats, wrap
from planners.check import check
from planners.clearance import Barriers
from planners.connect import connect
from planners.errors import PlanError
from planners.maps import geojson
from planners.planning import MARGIN
from planners.reach import Reach, reach
from planners.steering import Curve, Pen
from planners.trajectory import Trajectory
from sensorgraph.diagnose.expected import Forecast, Motion, Question, divide
from sensorgraph.diagnose.finding import Ledger
from sensorgraph.diagnose.observable import TIMES, TYPICAL, separation
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.files import whole
from sensorgraph.world.robot_file import RobotFile

PLACES = 14  # that motions start from
PASSES = 16  # ways between them that are driven to and fro
HEADINGS = 6  # that sweeps look at
SWEEP = np.radians(60.0)  # [rad] to either side
ROOM = 0.08  # [m] beyond the clearance that places keep, where there is that much
SHORTEST = 0.6  # [m] of a shuttle
MOMENTS = 6  # looked at in a motion
RANDOM = 9  # runs that nobody planned, for comparison
PAUSE = 1.0  # [s] of looks at a whole run, at least
ROUNDS = 2  # times that a plan goes round, so that what changes with time shows
KEPT = (1, 2, 4, 7)  # motions in a plan
MIXES = (("spin", "sweep", "shuttle"), ("spin",), ("sweep",), ("shuttle",))  # kinds of them
WORTH = 4.0  # [s] that must be left to go on to another place
LONGER = 1.05  # times the length asked for, that a run may take
OPEN = 50.0  # [nats] between a name and its rival, above which nothing is left to ask
LEAST = 0.05  # share of the time below which a motion is left out


@dataclass(frozen=True, kw_only=True)
class Step:
    """One motion that may tell something."""

    kind: str
    """`spin`, `sweep` or `shuttle`."""
    place: tuple[float, float]
    """[m] where it starts."""
    heading: float
    """[rad] of a sweep's middle, or of the drive."""
    way: float = 0.0
    """[m] of a shuttle."""

    @property
    def end(self) -> tuple[float, float]:
        """[m] where a shuttle turns back."""
        x, y = self.place
        return x + self.way * float(np.cos(self.heading)), y + self.way * float(np.sin(self.heading))


@dataclass(frozen=True, kw_only=True, eq=False)
class NextRun:
    """A drive worth making, and why."""

    trajectory: Trajectory
    questions: tuple[str, ...]
    """What it should answer."""
    evidence: float
    """[nats] that it is expected to bring."""
    median: float
    """[nats] that the median of random runs of the same length is expected to bring."""
    why: str
    steps: tuple[Step, ...]
    min_clearance: float
    """[m]"""
    candidates: tuple[float, ...]
    """[nats] of all that were drawn."""

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data, for report.json."""
        return {
            "questions": list(self.questions),
            "why": self.why,
            "expected_nats": self.evidence,
            "median_random_run_nats": self.median,
            "times_a_median_run": self.evidence / self.median if self.median >= 1 else None,
            "duration_s": self.trajectory.duration,
            "path_m": self.trajectory.length,
            "min_clearance_m": self.min_clearance,
            "start": [float(v) for v in self.trajectory.poses[0]],
            "steps": [
                {"kind": s.kind, "place": list(s.place), "heading": s.heading, "way_m": s.way}
                for s in self.steps
            ],
            "candidates_nats": list(self.candidates),
        }

    def save(self, folder: Path, arena: Arena, robot: RobotFile) -> None:
        """Write a folder that `sensorgraph record` drives: trajectory.csv, plan.json, arena and robot."""
        folder.mkdir(parents=True, exist_ok=True)
        self.trajectory.write_csv(folder / "trajectory.csv")
        texts = {
            "arena.geojson": geojson.dumps(arena),
            "robot.yaml": robot.text,
            "plan.json": json.dumps({"planner": "next_run", **self.to_dict()}, indent=1) + "\n",
        }
        for name, text in texts.items():
            with whole(folder / name) as part:
                part.write_text(text, encoding="utf-8")


def next_run(
    questions: Sequence[Question],
    arena: Arena,
    robot: RobotFile,
    *,
    seed: int = 0,
    minutes: float = 2.0,
    start: Floats | None = None,
) -> NextRun:
    """Plan the run that is expected to answer the questions best.

    Parameters
    ----------
    questions : pairs of models to tell apart (see `ask`); the first counts most where they compete
    start : (3,) [m, m, rad] where the robot stands; None: where the plan likes
    """
    if not questions:
        raise PlanError("there is no question for a next run; give at least one pair of models")
    if not (np.isfinite(minutes) and minutes > 0):
        raise PlanError(f"minutes is {minutes}, expected a positive number")
    ground = Ground.of(arena, robot, start=start)
    rng = np.random.default_rng(seed)
    seconds = 60.0 * minutes
    steps = motions(ground, rng)
    looks = [_moments(step, robot, seconds) for step in steps]
    forecasts = [Forecast(q, looks, arena, robot, seconds) for q in questions]
    shares = [f.shares() for f in forecasts]
    times = [
        divide(forecasts, shares, seconds, np.array([s.kind in kinds for s in steps])) for kinds in MIXES
    ]
    drawn = _drawn(ground, steps, times, seconds, start, seed)
    others = [random_run(ground, rng, seconds) for _ in range(RANDOM)]
    runs = [*(d[0] for d in drawn), *others]
    nats = expected(questions, [_looks(c, robot) for c in runs], arena, robot, seconds)
    length = np.array([c.duration for c in runs])
    nats = nats * np.minimum(seconds / length, 1.0)  # what is too long brings no more for that
    total = np.log1p(nats / 10.0).sum(axis=0)  # (n_runs,) no question is forgotten for another
    total -= 1e3 * (length > LONGER * seconds)
    for k in np.argsort(-total[: len(drawn)]).tolist():
        curve, used = drawn[k]
        trajectory = curve.trajectory()
        found = check(trajectory, arena, robot.robot)
        if found.count == 0:
            break
    else:
        raise PlanError("every plan breaks a limit of the robot; please report the arena and the robot")
    return NextRun(
        trajectory=trajectory,
        questions=tuple(q.words for q in questions),
        evidence=float(nats[0, k]),
        median=float(np.median(nats[0, len(drawn) :])),
        why=_why(questions[0], used, arena, robot) + _easily(float(np.median(nats[0, len(drawn) :]))),
        steps=tuple(used),
        min_clearance=found.min_clearance,
        candidates=tuple(float(v) for v in nats[0, : len(drawn)]),
    )


def expected(
    questions: Sequence[Question],
    runs: Sequence[Motion],
    arena: Arena,
    robot: RobotFile,
    seconds: float,
) -> Floats:
    """Return the nats (n_questions, n_runs) that whole runs are expected to bring."""
    out = np.zeros((len(questions), len(runs)))
    for i, question in enumerate(questions):
        forecast = Forecast(question, runs, arena, robot, seconds)
        out[i] = [
            forecast.nats(share * run.seconds) for share, run in zip(forecast.shares(), runs, strict=True)
        ]
    return out


# what to ask ---------------------------------------------------------------------------------------------------------


def ask(ledger: Ledger, model: Sequence[Amendment], rivals: Sequence[Amendment]) -> list[Question]:
    """Make the questions of a scan ledger.

    What is open comes first: rivals within OPEN nats of a name; then effects that the run could not have shown at
    all; then how large the least sure effect is, or those that could not be shown at some places. A rival that lies
    far behind is asked about no more.

    Parameters
    ----------
    model : the accepted effects
    rivals : of each effect the second best explanation, in the order of `ledger.rivals`
    """
    accepted = tuple(model)
    close = _close(ledger, accepted, rivals)
    if close:
        return close[:1]
    hidden = [(name, why, typical(name, why)) for name, why in ledger.not_observable.items()]
    everywhere = [
        _is_there(one, accepted, why) for _, why, one in hidden if one is not None and not one.place
    ]
    if everywhere:
        return everywhere[:3]
    if accepted:
        worst = max(accepted, key=_doubt)
        rest = tuple(a for a in accepted if a is not worst)
        words, hint = f"how large is the effect of {_called(worst)}", f"it varies with {worst.effect.varies}"
        return [Question(a=accepted, b=rest, words=words, hint=hint)]
    somewhere = [_is_there(one, accepted, why) for _, why, one in hidden if one is not None]
    if somewhere:
        return somewhere[:3]
    usual = (typical(name) for name in ("latency", "mount_yaw", "range_scale"))
    return [_is_there(one, (), "") for one in usual if one is not None]


def _close(ledger: Ledger, accepted: tuple[Amendment, ...], rivals: Sequence[Amendment]) -> list[Question]:
    """Ask about the rivals that the run leaves open, the closest first."""
    evidence = {a.name: a.evidence or 0.0 for a in ledger.effects}
    found = []
    for told, rival in zip(ledger.rivals, rivals, strict=True):
        own = next((a for a in accepted if a.name == told.instead_of), None)
        margin = evidence.get(told.instead_of, 0.0) - told.evidence_nats
        if own is not None and margin < OPEN:
            rest = tuple(a for a in accepted if a is not own)
            found.append((margin, between((*rest, own), (*rest, rival))))
    return [question for _, question in sorted(found, key=lambda pair: pair[0])]


def _is_there(unseen: Amendment, accepted: tuple[Amendment, ...], why: str) -> Question:
    """Ask whether an effect of a size that should show is there as well."""
    hint = f"this time {why}" if why else f"it varies with {unseen.effect.varies}"
    return Question(a=(*accepted, unseen), b=accepted, words=f"is there {_called(unseen)}", hint=hint)


def between(a: Sequence[Amendment], b: Sequence[Amendment]) -> Question:
    """Ask which of two models holds; they differ in their last effect."""
    one, other = a[-1], b[-1]
    words = f"{_called(one)} or {_called(other)}"
    return Question(a=tuple(a), b=tuple(b), words=words, hint=separation(one, other))


def typical(name: str, why: str = "") -> Amendment | None:
    """Return an effect at a size that should show; None where it has no such size or its place is not known.

    Parameters
    ----------
    why : what `not_observable` says; the place of an effect is the first that it names
    """
    effect = EFFECTS[name]
    values = {k: TIMES * m for k, m in effect.sizes.items()}
    if name == "range_drift":
        values["tau"] = 0.0
    if name == "map_scale":
        values |= {"dx": 0.0, "dy": 0.0}
    if name in ("min_range", "incidence_dropout"):
        values = dict(TYPICAL[name])
    elif name == "tilt":
        values = {"beta": TYPICAL[name]["beta"], "theta0": 0.0}
    place = why.split(":")[0].split(",")[0] if ":" in why else ""
    if effect.place in ("wall", "obstacle") and place:
        span = {"a": 0.0, "b": 1e3}
        values |= span if any(p.name == "a" for p in effect.parameters) else {}
        values |= {"glass": {"alpha_ret": 0.35, "depth": 1.0}, "black_surface": {"r0": 1.0}}.get(name, {})
        return effect(**values).at(place)
    if effect.place is not None or not values or name in ("people", "random_outliers"):
        return None
    return effect(**values)


def _doubt(a: Amendment) -> float:
    sizes = a.effect.sizes
    return max((a.stderr.get(k, 0.0) / m for k, m in sizes.items()), default=0.0)


def _called(a: Amendment) -> str:
    """Return an effect as people say it."""
    return f"{a.effect.title} at {a.place}" if a.place else a.effect.title


# where to move -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Ground:
    """Where the robot can go."""

    arena: Arena
    robot: RobotFile
    barriers: Barriers
    reach: Reach
    nodes: Floats
    """(n, 2) [m] places that can be reached, with room to spare where there is some."""

    @classmethod
    def of(cls, arena: Arena, robot: RobotFile, *, start: Floats | None = None) -> Ground:
        """Flood the reachable places."""
        if robot.robot.drive != "diff":
            raise PlanError(
                f"a next run is planned for robots that turn in place (drive: diff), not for {robot.robot.drive!r}"
            )
        barriers = Barriers(arena)
        free = reach(arena, barriers, clearance=robot.robot.footprint_radius + MARGIN, cell=0.25, start=start)
        roomy = free.mask & (free.distance >= free.clearance + ROOM)
        index = np.nonzero(roomy if roomy.any() else free.mask)
        return cls(arena=arena, robot=robot, barriers=barriers, reach=free, nodes=free.nodes(index))

    def spread(self, n: int, rng: np.random.Generator) -> Floats:
        """Return n places (n, 2) [m] far from each other."""
        nodes = self.nodes[rng.permutation(len(self.nodes))[:4000]]
        chosen = [nodes[0]]
        away = np.hypot(*(nodes - nodes[0]).T)
        while len(chosen) < min(n + 1, len(nodes)):
            chosen.append(nodes[int(away.argmax())])
            away = np.minimum(away, np.hypot(*(nodes - chosen[-1]).T))
        return np.array(chosen[1:] or chosen)

    def clear(self, a: Floats, b: Floats) -> Bools:
        """Tell which straight moves (n, 2) -> (n, 2) are free."""
        return self.barriers.are_clear(a, b, self.reach.clearance)


def motions(ground: Ground, rng: np.random.Generator) -> list[Step]:
    """List spins and sweeps at places all over the room, and shuttles between them."""
    places = ground.spread(PLACES, rng)
    out = [Step(kind="spin", place=_xy(p), heading=0.0) for p in places]
    turn = float(rng.uniform(-np.pi, np.pi))
    for p in places:
        for k in range(HEADINGS):
            out.append(Step(kind="sweep", place=_xy(p), heading=float(wrap(turn + 2 * np.pi * k / HEADINGS))))
    i, j = np.triu_indices(len(places), 1)
    way = np.hypot(*(places[j] - places[i]).T)
    fine = ground.clear(places[i], places[j]) & (way > SHORTEST)
    pairs = np.flatnonzero(fine)
    for k in rng.permutation(pairs)[:PASSES].tolist():
        for a, b in ((places[i[k]], places[j[k]]), (places[j[k]], places[i[k]])):
            heading = float(np.arctan2(*(b - a)[::-1]))
            out.append(Step(kind="shuttle", place=_xy(a), heading=heading, way=float(way[k])))
    return out


def _xy(p: Floats) -> tuple[float, float]:
    return float(p[0]), float(p[1])


def _moments(step: Step, robot: RobotFile, seconds: float) -> Motion:
    """Return some moments of a motion, there and back."""
    limits = robot.robot.limits
    share = (np.arange(MOMENTS) + 0.5) / MOMENTS
    x, y = step.place
    if step.kind == "shuttle":
        c, s = np.cos(step.heading), np.sin(step.heading)
        along = step.way * np.repeat(share[::2] + 0.5 / MOMENTS, 2)
        poses = np.stack([x + along * c, y + along * s, np.full(len(along), step.heading)], axis=1)
        v = np.where(np.arange(len(along)) % 2, -1.0, 1.0) * limits.v
        twists = np.stack([v, np.zeros(len(along))], axis=1)
    else:
        n = 2 * MOMENTS if step.kind == "spin" else MOMENTS
        wide = np.pi if step.kind == "spin" else SWEEP
        phi = step.heading + wide * (2 * (np.arange(n) + 0.5) / n - 1)
        poses = np.stack([np.full(n, x), np.full(n, y), phi], axis=1)
        omega = np.where(np.arange(n) % 2, -1.0, 1.0) * limits.omega
        twists = np.stack([np.zeros(n), omega], axis=1)
    when: Floats = np.asarray(
        seconds * ((np.arange(len(poses)) * 0.618) % 1.0)
    )  # a motion comes early and late
    return Motion(poses=poses, twists=twists, when=when, seconds=1.0)


def _looks(curve: Curve, robot: RobotFile) -> Motion:
    """Return moments of a whole run, evenly in time."""
    n = max(int(curve.duration / PAUSE), 40)
    stamps = (np.arange(n) + 0.5) / n * curve.duration
    poses, twists, _ = curve.sample(stamps)
    return Motion(poses=poses, twists=twists, when=stamps, seconds=curve.duration)


# drawing -------------------------------------------------------------------------------------------------------------


def _drawn(
    ground: Ground,
    steps: Sequence[Step],
    times: Sequence[Floats],
    seconds: float,
    start: Floats | None,
    seed: int,
) -> list[tuple[Curve, list[Step]]]:
    """Draw plans of the motions with most time, in several versions: how many, and how often they are gone through."""
    out: list[tuple[Curve, list[Step]]] = []
    seen = set()
    for time in times:
        order = np.argsort(-time)
        order = order[time[order] > LEAST * time.max()]
        for kept in KEPT:
            for rounds in (1, ROUNDS):
                some = order[:kept]
                key = (tuple(sorted(some.tolist())), rounds if len(some) > 1 else 1)
                if key in seen:
                    continue
                seen.add(key)
                artist = _Artist(ground, seconds, start, seed)
                used = artist.draw([steps[k] for k in some], time[some] / time[some].sum(), rounds)
                if used:
                    out.append((artist.pen.curve(), used))
    if not out:
        raise PlanError("no motion can be reached from the start; choose another start")
    return out


class _Artist:
    """Draw motions one after another, with the ways between them."""

    def __init__(self, ground: Ground, seconds: float, start: Floats | None, seed: int) -> None:
        self.ground, self.seconds, self.start, self.seed = ground, seconds, start, seed
        self.limits = ground.robot.robot.limits
        self.pen = Pen(np.zeros(3), self.limits)

    def draw(self, steps: Sequence[Step], share: Floats, rounds: int) -> list[Step]:
        """Draw the motions by their shares of the time; return those that were drawn."""
        tour = _tour([s.place for s in steps], self.start)
        first = steps[tour[0]]
        self.pen = Pen(
            np.array([*first.place, first.heading]) if self.start is None else self.start, self.limits
        )
        visits = [k for turn in range(rounds) for k in (tour if turn % 2 == 0 else tour[::-1])]
        used: list[Step] = []
        left = float(rounds)
        for k in visits:
            far = float(np.hypot(*(np.array(steps[k].place) - self.pen.pose[:2])))
            if used and self.pen.clock + far / self.limits.v > self.seconds - WORTH:
                break
            if self._go(np.array(steps[k].place)):
                self._move(
                    steps[k], self.pen.clock + (self.seconds - self.pen.clock) * float(share[k]) / left
                )
                used += [] if steps[k] in used else [steps[k]]
            left -= float(share[k])
        self.pen.wait(0.2)
        return used

    def _move(self, step: Step, until: float) -> None:
        """Spin, sweep or shuttle until a time, at least once."""
        pen = self.pen
        if step.kind == "spin":
            sign = 1.0
            while True:
                pen.turn(sign * min(2 * np.pi, self._within(self.limits.omega, self.limits.alpha)), "spin")
                sign = -sign
                if pen.clock + np.pi / self.limits.omega > until:
                    return
        if step.kind == "sweep":
            pen.turn(float(wrap(step.heading - SWEEP - pen.pose[2])))
            sign = 1.0
            while True:
                pen.turn(sign * 2 * SWEEP, "sweep")
                sign = -sign
                if pen.clock + SWEEP / self.limits.omega > until:
                    return
        pen.turn(float(wrap(step.heading - pen.pose[2])))
        while True:
            way = min(step.way, self._within(self.limits.v, self.limits.a))
            pen.move(way, "pass")
            if self.seconds - pen.clock > WORTH / 2:
                pen.move(-min(way, self._within(self.limits.v, self.limits.a)), "pass")
            if pen.clock + step.way / self.limits.v > until:
                return

    def _within(self, top: float, rate: float) -> float:
        """Return how far [m, rad] a motion may go in the time that is left; a little, where there is none."""
        return max(top * (self.seconds - self.pen.clock - top / rate), 0.2 * top)

    def _go(self, place: Floats) -> bool:
        """Drive to a place; False if there is no way."""
        pen = self.pen
        if np.hypot(*(place - pen.pose[:2])) < 1e-6:
            return True
        path = self._path(pen.pose[:2].copy(), place)
        if path is None:
            return False
        for corner in path[1:]:
            way = corner - pen.pose[:2]
            far = float(np.hypot(*way))
            if far > 1e-9:
                pen.turn(float(wrap(np.arctan2(way[1], way[0]) - pen.pose[2])))
                pen.move(far)
        return True

    def _path(self, here: Floats, there: Floats) -> Floats | None:
        """Return the shortest way over places that see each other; by OMPL where they do not."""
        ground = self.ground
        if ground.clear(here[None], there[None])[0]:
            return np.array([here, there])
        via = ground.spread(24, np.random.default_rng(self.seed))
        points = np.concatenate([here[None], there[None], via])
        i, j = np.triu_indices(len(points), 1)
        far = np.hypot(*(points[j] - points[i]).T) + 0.5  # a corner costs time
        graph = np.zeros((len(points), len(points)))
        free = ground.clear(points[i], points[j])
        graph[i[free], j[free]] = far[free]
        cost, before = shortest_path(graph, directed=False, indices=0, return_predecessors=True)
        if np.isfinite(cost[1]):
            route = [1]
            while route[-1] != 0:
                route.append(int(before[route[-1]]))
            return points[route[::-1]]
        paths, _ = connect(
            here[None], there[None], reach=ground.reach, barriers=ground.barriers, seed=self.seed
        )
        return paths[0]


def _tour(places: Sequence[tuple[float, float]], start: Floats | None) -> list[int]:
    """Order places by going to the nearest next."""
    here = np.array(places[0] if start is None else start[:2])
    todo, out = list(range(len(places))), []
    while todo:
        near = min(todo, key=lambda k, h=here: float(np.hypot(*(np.array(places[k]) - h))))  # type: ignore[misc]
        out.append(near)
        todo.remove(near)
        here = np.array(places[near])
    return out


def random_run(ground: Ground, rng: np.random.Generator, seconds: float) -> Curve:
    """Drive between random places at random speeds, with a spin or a pause now and then: what one does without a plan."""
    limits = ground.robot.robot.limits
    nodes = ground.nodes
    pen = Pen(np.array([*nodes[rng.integers(len(nodes))], rng.uniform(-np.pi, np.pi)]), limits)
    while pen.clock < seconds:
        pace = float(rng.uniform(0.4, 1.0))
        pen.limits = replace(limits, v=pace * limits.v)
        pen.spin = pace * limits.omega
        chance = rng.random()
        if chance < 0.26:
            pen.turn(float(rng.choice([-1.0, 1.0]) * rng.uniform(0.8, 4.5)), "spin")
        elif chance < 0.34:
            pen.wait(float(rng.uniform(0.5, 2.0)))
        else:
            some = nodes[rng.integers(len(nodes), size=16)]
            here = np.repeat(pen.pose[None, :2], 16, axis=0)
            open_ = np.flatnonzero(ground.clear(here, some))
            if len(open_):
                way = some[open_[0]] - pen.pose[:2]
                pen.turn(float(wrap(np.arctan2(way[1], way[0]) - pen.pose[2])))
                pen.move(float(np.hypot(*way)))
            else:
                pen.turn(float(rng.uniform(-np.pi, np.pi)))
    return pen.curve()


# words ---------------------------------------------------------------------------------------------------------------


def _why(question: Question, steps: Sequence[Step], arena: Arena, robot: RobotFile) -> str:
    """Say what the run does and why."""
    limits = robot.robot.limits
    said = []
    for step in steps[:3]:
        at = f"({step.place[0]:.1f}, {step.place[1]:.1f})"
        if step.kind == "spin":
            said.append(f"spins both ways at {at}")
        elif step.kind == "sweep":
            degrees = np.degrees(SWEEP)
            facing = _facing(arena, step)
            said.append(f"turns fast {degrees:.0f} degrees to either side at {at}, facing {facing}")
        else:
            x, y = step.end
            said.append(
                f"drives to and fro at {limits.v:g} m/s between {at} and ({x:.1f}, {y:.1f}), facing {_facing(arena, step)}"
            )
    more = f" and {len(steps) - 3} more" if len(steps) > 3 else ""
    return f"{'; '.join(said)}{more}: {question.words}? {question.hint}"


def _easily(median: float) -> str:
    """Say that any run would tell, where that is so."""
    if median < OPEN:
        return ""
    return f" (any lively run would tell: a median random one is expected to bring {median:,.0f} nats)"


def _facing(arena: Arena, step: Step) -> str:
    """Return the wall that the robot looks at."""
    from sensorgraph.world.raycast import cast_laser

    pose = np.array([[*step.place, step.heading]])
    _, wall = cast_laser(arena.walls, pose, np.zeros(1), 1e4)
    index = int(wall[0, 0])
    return arena.names[index] if index >= 0 else "nothing"
