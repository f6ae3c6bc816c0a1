"""Is the pose that the robot believes right: the probabilities of the tracked modes, compared with the belief.

    P(ok)   = sum of P(mode) P(its pose is within the tolerance of the belief)
    P(off)  = sum of P(mode) P(its pose is outside the tolerance)
    P(lost) = P(elsewhere), which may resemble a mode

Without a belief, the most probable mode is judged alone. Where the graph does not know the surroundings, nothing is news. A
belief that jumps against the odometry may be right there: on the fr079 log, odometry itself jumps by 0.3 to 0.6 m, or 15° to
26°, seven times in nine minutes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.special import expit, ndtr

from logs.transforms import compose, difference
from sensorgraph.types import Floats
from sensorgraph.watching.modes import Mode
from sensorgraph.watching.observation import Observation
from sensorgraph.watching.scan_input import apart
from sensorgraph.watching.settings import TRACKING, TrackingPriors
from sensorgraph.watching.tracker import PoseTracker

PoseWord = Literal["ok", "off", "ambiguous", "lost"]
RIVAL = 0.05
"""Probability from which another mode makes a pose ambiguous, if the first is not ten times as probable."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseStatement:
    """What is known about the pose of the robot."""

    status: PoseWord
    p: float
    """Probability of the status."""
    pose: Floats | None
    """(3,) [m, m, rad] where the robot is by our own tracking; None: unknown."""
    deviations: Floats
    """(3,) [m, m, rad] Standard deviations of the pose; inf where it is unknown."""
    offset: tuple[float, float]
    """[m, rad] from the believed pose to ours; 0 without a belief."""
    rivals: Floats
    """(n, 3) Other possible poses."""
    is_known_place: bool
    """Whether the graph knows the surroundings; if not, the pose goes on by odometry."""
    is_believed: bool
    """Whether the robot stated a pose."""
    p_wrong: float
    """Probability that the believed pose is off, or the robot lost."""
    since: float = 0.0
    """[s] Stamp of the first statement with this status."""

    def place(self) -> str:
        """Return where the robot is by our own tracking; empty if that is unknown."""
        if self.pose is None:
            return ""
        return f"({self.pose[0]:.2f}, {self.pose[1]:.2f}) m, {math.degrees(self.pose[2]):.0f}°"

    def sentence(self) -> str:
        """Return the statement as one sentence."""
        at = self.place()
        if not self.is_known_place and self.status != "lost":
            metres = float(np.hypot(*self.deviations[:2]))
            own = f"outside what the graph knows: by odometry at {at}, ± {metres:.2f} m"
            judged = {"ok": "is not judged", "ambiguous": "is ambiguous"}.get(self.status, "is off")
            return (
                f"{own}; the believed pose, {self.offset[0]:.2f} m from there, {judged}"
                if self.is_believed
                else own
            )
        if self.status == "lost":
            return (
                "lost: the scans fit neither the tracked pose nor another place"
                if at
                else "lost: no pose is known"
            )
        if self.status == "ambiguous":
            others = " or ".join(f"({x:.1f}, {y:.1f}) m" for x, y, _ in self.rivals)
            return f"ambiguous: at {at}, or at {others}"
        if self.status == "off":
            metres, turn = self.offset
            elsewhere = "".join(f", or at ({x:.1f}, {y:.1f}) m" for x, y, _ in self.rivals)
            return f"off by {metres:.2f} m and {math.degrees(turn):.0f}°: the robot is at {at}{elsewhere}"
        return f"ok at {at}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {
            "status": self.status,
            "offset_m": round(self.offset[0], 4),
            "offset_rad": round(self.offset[1], 5),
            "p": round(self.p, 6),
            "p_wrong": round(self.p_wrong, 6),
            "since": round(self.since, 3),
            "pose": None if self.pose is None else [round(float(v), 4) for v in self.pose],
            "sigma": [round(float(v), 4) if math.isfinite(v) else None for v in self.deviations],
            "rivals": [[round(float(v), 3) for v in one] for one in self.rivals],
            "known_place": self.is_known_place,
        }


class PoseJudge:
    """Judges the believed pose by a tracker, once for each statement.

    Whether the belief is right is a state that persists (a hidden Markov model). Errors of stamps and of the belief last
    for some scans, as a normal distribution with the tolerance as standard deviation. So one statement counts at most
    `most_of_one` nats, and more only for an offset that such an error does not reach.
    """

    def __init__(self, tracker: PoseTracker, priors: TrackingPriors = TRACKING) -> None:
        self.tracker, self.priors = tracker, priors
        self.odds = -priors.right
        """[nats] Log-odds that the believed pose is off."""
        self.before: PoseWord = "ok"

    def state(self, observation: Observation, age: float = 0.0) -> PoseStatement:
        """Return the statement at a scan, whose believed pose has an age [s] and is moved on to its stamp."""
        if observation.believed is not None and age:
            moved = compose(observation.believed, age * self.tracker.velocity)
            observation = replace(observation, believed=moved)
        found = state_pose(self.tracker, observation, self)
        self.before = found.status
        return found

    def p_off(self, p_near: float, known: float = 1.0, offset: tuple[float, float] = (0.0, 0.0)) -> float:
        """Return the probability that the belief is off, after a statement that it is near with a probability.

        Parameters
        ----------
        known : How far the graph knows the surroundings, 0 to 1; 0 where the scan is not matched, or was not for long. There
            the tracked pose drifts: if it leaves the belief, this is no evidence, but if both agree, it is.
        offset : [m, rad] From the belief to the most probable mode.
        """
        s = self.priors
        nats = math.log(max(1.0 - p_near, 1e-12) / max(p_near, 1e-12))
        if nats > 0:
            lasting = 0.5 * ((offset[0] / s.tolerance[0]) ** 2 + (offset[1] / s.tolerance[1]) ** 2)
            nats = known * min(nats, s.most_of_one + lasting)
        self.odds = min(max(self.odds + max(nats, -s.most_of_one), -s.right), s.right)
        return float(expit(self.odds))


def state_pose(tracker: PoseTracker, observation: Observation, judge: PoseJudge) -> PoseStatement:
    """Return the statement about the pose at a scan."""
    priors, before = judge.priors, judge.before
    ahead, believed = tracker.ahead(observation), observation.believed
    modes = [replace(mode, pose=compose(mode.pose, ahead)) for mode in tracker.modes]
    main = max(modes, key=lambda mode: mode.score, default=None)
    probabilities = tracker.probabilities
    p_lost = tracker.p_elsewhere
    if main is None:
        return PoseStatement(
            status="lost", p=1.0, pose=None, deviations=np.full(3, np.inf), offset=(0.0, 0.0),
            rivals=np.zeros((0, 3)), is_known_place=True, is_believed=believed is not None, p_wrong=1.0,
        )  # fmt: skip
    best = float(probabilities.max())
    others = [
        mode for mode, p in zip(modes, probabilities, strict=True)
        if mode is not main and p > RIVAL * best
    ]  # fmt: skip
    p_ok, offset = best, (0.0, 0.0)
    is_known = main.answered >= priors.answered and tracker.alone < priors.alone
    if believed is not None:
        moved = np.abs(tracker.velocity) * priors.stamp
        near = np.array([_p_near(mode, believed, moved, priors) for mode in modes])
        # the prior of a belief that contradicts the tracking is no evidence, only what the readings add to it
        is_near = float((probabilities * np.exp([mode.handicap for mode in modes])) @ near)
        p_near = is_near / max(is_near + float(probabilities @ (1.0 - near)), 1e-9)
        is_news = main.is_matched and tracker.alone < priors.alone
        known = min(main.answered / priors.answered, 1.0) if is_news else 0.0
        offset = apart(main.pose, believed)
        p_ok = (1.0 - p_lost) * (1.0 - judge.p_off(p_near, known, offset))
    p_off = max(1.0 - p_lost - p_ok, 0.0)
    status: PoseWord = "ok"
    p = p_ok
    p_wrong = p_lost + (p_off if believed is not None else 0.0)  # at whichever of several poses the robot is
    if p_wrong > 0.5:
        status, p = ("lost", p_lost) if p_lost > p_wrong - p_lost else ("off", p_off)
    elif others and best < 0.9 * (1.0 - p_lost):
        status, p = "ambiguous", 1.0 - best
    if not (is_known and main.is_matched):  # nothing that the graph knows is in sight: no news
        if before == "lost" and np.sqrt(main.covariance[:2, :2].trace()) > priors.tolerance[0]:
            status, p = "lost", max(p_lost, 1.0 - p_ok)
        elif before == "ok" and p_lost <= 0.5:
            status, p = "ok", p_ok
    return PoseStatement(
        status=status, p=min(p, 1.0), pose=main.pose, deviations=np.sqrt(np.diag(main.covariance)), offset=offset,
        rivals=np.array([mode.pose for mode in others]).reshape(-1, 3), is_known_place=is_known,
        is_believed=believed is not None, p_wrong=min(p_lost + p_off, 1.0),
    )  # fmt: skip


def _p_near(mode: Mode, believed: Floats, moved: Floats, priors: TrackingPriors) -> float:
    """Return the probability that a pose of the mode is within the tolerance of the believed pose.

    The motion `moved` (3,) within the error of a stamp adds to the covariance.
    """
    off = difference(believed, mode.pose)
    way = float(np.hypot(off[0], off[1]))
    along = off[:2] / way if way > 0 else np.array([1.0, 0.0])
    deviation = math.sqrt(float(along @ mode.covariance[:2, :2] @ along + moved[:2] @ moved[:2]))
    turn = math.sqrt(float(mode.covariance[2, 2] + moved[2] ** 2))
    within = ndtr((priors.tolerance[0] - way) / deviation) * ndtr((priors.tolerance[1] - abs(off[2])) / turn)
    return float(within)
