"""Plan the next run: a drive that distinguishes what this run could not, chosen by its expected evidence.

1. `candidate_motions` lists motions that may separate two models: spins, sweeps and shuttles in the whole
   room.
2. `forecast` predicts the evidence of each, if it took the whole time. The motions with the most evidence, of all kinds and
   of each kind, get time in proportion to their scores.
3. `drives` joins them into closed-form curves of moves and turns, in several versions.
4. The version with the most expected evidence is the next run. Random drives are the comparison.

    score = sum over questions of log(1 + nats)
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from logs.files import atomic_file
from planners.arena import Arena
from planners.check import check
from planners.curve import Curve
from planners.errors import PlanError
from planners.trajectory import Trajectory
from sensorgraph.diagnosis.next_run.drives import (
    SWEEP_ANGLE,
    CandidateMotion,
    DrivableSpace,
    MotionKind,
    build_drives,
    candidate_motions,
    random_drive,
)
from sensorgraph.diagnosis.next_run.forecast import (
    DECIDED_NATS,
    EvidenceForecast,
    MotionSamples,
    OpenQuestion,
    planned_scans,
)
from sensorgraph.loading import attachments_of
from sensorgraph.types import Floats
from sensorgraph.world.raycast import cast_laser
from sensorgraph.world.robot import Robot

MAX_DESCRIBED = 3
"""Maximum number of motions that the explanation of a run describes, and of questions about effects that a run could not show."""
MAX_OVERTIME = 1.05
"""Maximum duration of a drive, as a multiple of the requested one."""
N_RANDOM = 9
"""Number of random drives for comparison."""
N_DRIVE_SAMPLES = 100
"""Number of sample moments of a whole drive."""
N_SAMPLES = 6
"""Number of sample moments of a motion; twice as many for a spin."""


@dataclass(frozen=True, kw_only=True, eq=False)
class NextRun:
    """A planned drive, and the reason for it."""

    trajectory: Trajectory
    questions: tuple[str, ...]
    """Questions that it should answer."""
    evidence: float
    """[nats] expected evidence."""
    median_random_evidence: float
    """[nats] expected evidence of the median of random drives of the same duration."""
    why: str
    motions: tuple[CandidateMotion, ...]
    min_clearance: float
    """[m]"""
    candidate_evidence: tuple[float, ...]
    """[nats] of all versions that were built."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for report.json."""
        median = self.median_random_evidence
        times_median = self.evidence / median if median >= 1 else None
        return {
            "questions": list(self.questions),
            "why": self.why,
            "expected_nats": self.evidence,
            "median_random_run_nats": self.median_random_evidence,
            "times_a_median_run": times_median,
            "duration_s": self.trajectory.duration,
            "path_m": self.trajectory.length,
            "min_clearance_m": self.min_clearance,
            "start": [float(v) for v in self.trajectory.poses[0]],
            "steps": [
                {"kind": m.kind.value, "place": list(m.place), "heading": m.heading, "way_m": m.length}
                for m in self.motions
            ],
            "candidates_nats": list(self.candidate_evidence),
        }

    def save(self, folder: Path, arena: Arena, robot: Robot) -> None:
        """Write a folder for `sensorgraph record`: trajectory.csv, plan.json, arena and robot."""
        folder.mkdir(parents=True, exist_ok=True)
        self.trajectory.write_csv(folder / "trajectory.csv")
        report = json.dumps({"planner": "next_run", **self.to_dict()}, indent=1) + "\n"
        for name, content in {**attachments_of(arena, robot), "plan.json": report.encode()}.items():
            with atomic_file(folder / name) as part:
                part.write_bytes(content)


def next_run(
    questions: Sequence[OpenQuestion],
    arena: Arena,
    robot: Robot,
    *,
    seed: int = 0,
    minutes: float = 2.0,
) -> NextRun:
    """Plan the run that is expected to answer the questions best.

    Parameters
    ----------
    questions : Pairs of models to distinguish (see `open_questions`). The first counts most if they compete.

    Raises
    ------
    PlanError : There is no question, the robot cannot turn in place, or it fits nowhere.
    """
    if not questions:
        raise PlanError("there is no question for a next run; give at least one pair of models")
    if not (np.isfinite(minutes) and minutes > 0):
        raise PlanError(f"minutes is {minutes}, expected a positive number")
    space = DrivableSpace.of(arena, robot)
    rng = np.random.default_rng(seed)
    duration = 60.0 * minutes
    motions = candidate_motions(space, rng)
    samples = [motion_samples(motion, robot, duration) for motion in motions]
    score = np.log1p(expected_evidence(questions, samples, arena, robot, duration)).sum(axis=0)
    of_kind = [np.array([m.kind is kind for m in motions]) for kind in MotionKind]
    allocations = [score, *(np.where(own, score, 0.0) for own in of_kind if own.any())]
    drives = build_drives(space, motions, allocations, duration, seed)
    random = [random_drive(space, rng, duration) for _ in range(N_RANDOM)]
    curves = [*(curve for curve, _ in drives), *random]
    nats, score = _rate(questions, curves, arena, robot, duration)
    for k in np.argsort(-score[: len(drives)]).tolist():
        curve, used = drives[k]
        trajectory = curve.trajectory()
        found = check(trajectory, arena, robot)
        if found.count == 0:
            break
    else:
        raise PlanError(
            "every plan exceeds a limit of the robot; please report this with the arena and robot.yaml"
        )
    median = float(np.median(nats[0, len(drives) :]))
    return NextRun(
        trajectory=trajectory,
        questions=tuple(q.text for q in questions),
        evidence=float(nats[0, k]),
        median_random_evidence=median,
        why=_explanation(questions[0], used, arena, robot) + _remark_if_easy(median),
        motions=tuple(used),
        min_clearance=found.min_clearance,
        candidate_evidence=tuple(float(v) for v in nats[0, : len(drives)]),
    )


def _rate(
    questions: Sequence[OpenQuestion], curves: Sequence[Curve], arena: Arena, robot: Robot, duration: float
) -> tuple[Floats, Floats]:
    """Return the expected evidence (n_questions, n_curves) [nats] of drives, and their scores (n_curves,).

        score = sum over questions of log(1 + nats)

    The evidence of a drive that exceeds the duration is reduced in proportion.
    """
    nats = expected_evidence(questions, [_drive_samples(c) for c in curves], arena, robot, duration)
    length = np.array([c.duration for c in curves])
    nats = nats * np.minimum(duration / length, 1.0)  # a longer drive gets no credit for the extra time
    score = np.log1p(nats).sum(axis=0)  # each question counts
    score -= 1e3 * (length > MAX_OVERTIME * duration)  # only as a last resort
    return nats, score


def expected_evidence(
    questions: Sequence[OpenQuestion],
    drives: Sequence[MotionSamples],
    arena: Arena,
    robot: Robot,
    duration: float,
) -> Floats:
    """Return the expected evidence (n_questions, n_drives) [nats] of motions or whole drives."""
    out, scans = np.zeros((len(questions), len(drives))), planned_scans(drives, arena, robot, duration)
    for i, question in enumerate(questions):
        out[i] = EvidenceForecast(question, scans).nats()
    return out


def motion_samples(motion: CandidateMotion, robot: Robot, duration: float) -> MotionSamples:
    """Return sample moments of a motion, back and forth, spread over the run."""
    limits = robot.limits
    x, y = motion.place
    if motion.kind is MotionKind.SHUTTLE:
        share = (np.arange(N_SAMPLES) + 0.5) / N_SAMPLES
        c, s = np.cos(motion.heading), np.sin(motion.heading)
        along = motion.length * np.repeat(share[::2] + 0.5 / N_SAMPLES, 2)
        poses = np.stack([x + along * c, y + along * s, np.full(len(along), motion.heading)], axis=1)
        v = np.where(np.arange(len(along)) % 2, -1.0, 1.0) * limits.v
        twists = np.stack([v, np.zeros(len(along))], axis=1)
    else:
        is_spin = motion.kind is MotionKind.SPIN
        n, angle = (2 * N_SAMPLES, np.pi) if is_spin else (N_SAMPLES, SWEEP_ANGLE)
        phi = motion.heading + angle * (2 * (np.arange(n) + 0.5) / n - 1)
        poses = np.stack([np.full(n, x), np.full(n, y), phi], axis=1)
        omega = np.where(np.arange(n) % 2, -1.0, 1.0) * limits.omega
        twists = np.stack([np.zeros(n), omega], axis=1)
    golden = 0.618  # multiples of it modulo 1 fill 0 ... 1 evenly: samples are early and late in the run
    times: Floats = np.asarray(duration * ((np.arange(len(poses)) * golden) % 1.0))
    return MotionSamples(poses=poses, twists=twists, times=times, duration=duration)


def _drive_samples(curve: Curve) -> MotionSamples:
    """Return sample moments of a whole drive, evenly spaced in time."""
    stamps = (np.arange(N_DRIVE_SAMPLES) + 0.5) / N_DRIVE_SAMPLES * curve.duration
    poses, twists, _ = curve.sample(stamps)
    return MotionSamples(poses=poses, twists=twists, times=stamps, duration=curve.duration)


def _explanation(
    question: OpenQuestion, motions: Sequence[CandidateMotion], arena: Arena, robot: Robot
) -> str:
    """Return what the run does and why, in words."""
    phrases = [_phrase(motion, arena, robot) for motion in motions[:MAX_DESCRIBED]]
    more = f" and {len(motions) - MAX_DESCRIBED} more" if len(motions) > MAX_DESCRIBED else ""
    hint = f" {question.hint[0].upper()}{question.hint[1:]}." if question.hint else ""
    return f"The robot {'; '.join(phrases)}{more}. Question: {question.text}?{hint}"


def _phrase(motion: CandidateMotion, arena: Arena, robot: Robot) -> str:
    """Return what one motion does, in words."""
    at = f"({motion.place[0]:.1f}, {motion.place[1]:.1f}) m"
    if motion.kind is MotionKind.SPIN:
        return f"spins in both directions at {at}"
    facing = _faced_wall(arena, motion)
    if motion.kind is MotionKind.SWEEP:
        degrees = np.degrees(SWEEP_ANGLE)
        return f"turns fast {degrees:.0f} degrees to either side at {at}, facing {facing}"
    x, y = motion.end
    return f"drives back and forth at {robot.limits.v:g} m/s between {at} and ({x:.1f}, {y:.1f}) m, facing {facing}"


def _remark_if_easy(median: float) -> str:
    """Return a remark if any run would decide the question."""
    if median < DECIDED_NATS:
        return ""
    return f" Most random drives would also decide this: their median expected log Bayes factor is {median:,.0f}."


def _faced_wall(arena: Arena, motion: CandidateMotion) -> str:
    """Return the name of the wall that the robot faces."""
    pose = np.array([[*motion.place, motion.heading]])
    _, wall = cast_laser(arena.walls, pose, np.zeros(1), 1e4)
    index = int(wall[0, 0])
    return arena.names[index] if index >= 0 else "nothing"
