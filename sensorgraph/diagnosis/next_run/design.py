"""The next run: a drive made to tell apart what this run could not, chosen by the evidence it is expected to bring.

Motions that may tell something (spins, sweeps and shuttles at places all over the room, at the limits of speed) are
asked what they would bring per second; the time is divided among them so that they bring most together; the best are
drawn as one closed-form curve, with the planner's moves, turns and connections, in several versions. The version that
is expected to bring most is the next run, and random driving is what it is compared with.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from planners.arena import Arena
from planners.check import check
from planners.curve import Curve
from planners.errors import PlanError
from planners.maps import geojson
from planners.trajectory import Trajectory
from sensorgraph.diagnosis.next_run.assemble import drawn as draw_all
from sensorgraph.diagnosis.next_run.assemble import random_run
from sensorgraph.diagnosis.next_run.candidate_motions import SWEEP, Ground, Step, motions
from sensorgraph.diagnosis.next_run.forecast import Forecast, Motion, Question, divide
from sensorgraph.diagnosis.next_run.questions import OPEN
from sensorgraph.files import whole
from sensorgraph.types import Floats
from sensorgraph.world.robot import Robot

MOMENTS = 6  # looked at in a motion
RANDOM = 9  # runs that nobody planned, for comparison
PAUSE = 1.0  # [s] of looks at a whole run, at least
MIXES = (("spin", "sweep", "shuttle"), ("spin",), ("sweep",), ("shuttle",))  # kinds of them
LONGER = 1.05  # times the length asked for, that a run may take


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

    def save(self, folder: Path, arena: Arena, robot: Robot) -> None:
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
    robot: Robot,
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
    drawn = draw_all(ground, steps, times, seconds, start, seed)
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
        found = check(trajectory, arena, robot)
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
    robot: Robot,
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


def _moments(step: Step, robot: Robot, seconds: float) -> Motion:
    """Return some moments of a motion, there and back."""
    limits = robot.limits
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


def _looks(curve: Curve, robot: Robot) -> Motion:
    """Return moments of a whole run, evenly in time."""
    n = max(int(curve.duration / PAUSE), 40)
    stamps = (np.arange(n) + 0.5) / n * curve.duration
    poses, twists, _ = curve.sample(stamps)
    return Motion(poses=poses, twists=twists, when=stamps, seconds=curve.duration)


def _why(question: Question, steps: Sequence[Step], arena: Arena, robot: Robot) -> str:
    """Say what the run does and why."""
    limits = robot.limits
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
