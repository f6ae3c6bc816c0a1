"""How much evidence between two hypotheses a drive is expected to bring, before anybody has driven it.

Per ray half the squared difference of what both expect, over the variance, with poses, nuisances and the smooth
parameters of the wrong one refitted; plus the Kullback-Leibler divergence of the chance of a return. Given what was
refitted the sum over scans is linear in them, so that the best division of time among motions is a concave problem.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from scipy.special import ndtr

from planners.arena import Arena
from sensorgraph.diagnosis.scan.fit import cast, solver_for
from sensorgraph.diagnosis.scan.gauss_newton import Solver, boxed
from sensorgraph.diagnosis.scan.likelihood import ExpectedReadings
from sensorgraph.diagnosis.scan.nuisance import BOX
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.effects import Amendment
from sensorgraph.types import Bools, Floats
from sensorgraph.world.robot import Robot

Model = tuple[Amendment, ...]

MOST_RAYS = 46  # of a scan, that are looked at; the others count as much
CAP = 5.0  # [nats] that a single ray may bring
FAR = 4.0  # standard deviations, up to which a ray tells little by little whatever it met
LOSS = 2e-3  # chance of a lost or stray ray under any hypothesis
EDGE = 2e-3  # chance of being on the other side of an edge, above which a ray is not asked
GROWTH = 10.0  # [nats] after which more evidence on one question counts half


@dataclass(frozen=True, kw_only=True, eq=False)
class Question:
    """Two models that the next run should tell apart; the first is taken for true."""

    a: Model
    b: Model
    words: str
    """What is asked: `latency or mount_xy`."""
    hint: str = ""
    """What tells them apart, in words."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """Where the robot is at some moments, and how it moves."""

    poses: Floats
    """(n, 3)"""
    twists: Floats
    """(n, 2) [m/s, rad/s] v and omega."""
    when: Floats
    """(n,) [s] since the start of the run."""
    seconds: float
    """[s] that these moments stand for."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Share:
    """What one motion brings, per second: normal equations of what is refitted, and what cannot be refitted."""

    matrix: Floats
    right: Floats
    square: float
    sure: float
    """[nats/s]"""

    def __mul__(self, seconds: float) -> Share:
        return Share(
            matrix=self.matrix * seconds,
            right=self.right * seconds,
            square=self.square * seconds,
            sure=self.sure * seconds,
        )

    def __add__(self, other: Share) -> Share:
        return Share(
            matrix=self.matrix + other.matrix,
            right=self.right + other.right,
            square=self.square + other.square,
            sure=self.sure + other.sure,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Imagined(ScanData):
    """Scans that nobody has taken: each at its own pose, with its own twist."""

    def motion(self, times: Floats) -> Floats:
        """Return poses (..., 3) at times (n_scans, ...) [s] near the stamps of the scans."""
        extra = (1,) * (times.ndim - 1)
        n = self.n_scans
        later = times - self.stamps.reshape(n, *extra)
        return np.asarray(
            self.poses.reshape(n, *extra, 3) + later[..., None] * self.twists.reshape(n, *extra, 3)
        )


class Forecast:
    """The expected evidence of many motions between the two models of a question."""

    def __init__(
        self, question: Question, motions: Sequence[Motion], arena: Arena, robot: Robot, span: float
    ) -> None:
        self.motions, self.rate = motions, robot.sensor.rate
        data, every = _imagined(motions, arena, robot, span)
        first = cast(data, question.a)
        truth = first.expected
        data = replace(data, ranges=_readings(truth, data))
        self.solver, at = solver_for(data, question.b)
        self.walls = at.scene.walls
        self.tau = self.solver.tau
        self.locked = self.solver.locked
        bent = [~b.straight for b in (first.beams, at.beams) if b.straight is not None]
        same = np.asarray((first.beams.wall == at.beams.wall) & ~sum(bent, np.zeros(1, dtype=np.bool_)))
        noisier = np.clip(
            np.square(first.beams.sigma) / np.maximum(np.square(at.beams.sigma), 1e-12), 0.01, 100.0
        )
        weight, self.sure = _weights(self.solver, truth, data, same, noisier)
        self.weight, self.sure = every * weight, every * self.sure

    def shares(self) -> list[Share]:
        """Return what each motion brings per second."""
        out, at = [], 0
        for motion in self.motions:
            rows = slice(at, at + len(motion.poses))
            at = rows.stop
            solver = _part(self.solver, self.walls, rows)
            system = solver.assemble(self.weight[rows], 1.0)
            w = np.where(solver.jacobian.valid, self.weight[rows], 0.0)
            poses = np.einsum("ni,nij,nj->", system.start, system.poses, system.start)
            share = Share(
                matrix=system.matrix,
                right=system.right,
                square=float((w * solver.y**2).sum() - poses),
                sure=float(self.sure[rows].sum()),
            )
            out.append(share * (self.rate / len(motion.poses)))
        return out

    def refitted(self, share: Share) -> Floats:
        """Return the nuisances and parameters (k,) with which the wrong model does best."""
        g, p = boxed(share.matrix, share.right, self.tau, BOX * self.tau, self.locked)
        return np.concatenate([g, p])

    def nats(self, share: Share) -> float:
        """Return the evidence of a whole run."""
        x = self.refitted(share)
        prior = 0.5 * float(np.sum((x[: len(self.tau)] / self.tau) ** 2))
        return max(left(share, x) + prior, 0.0)


def left(share: Share, x: Floats) -> float:
    """Return the nats that remain where the wrong model has taken x."""
    return share.sure + 0.5 * float(share.square - 2 * share.right @ x + x @ share.matrix @ x)


def divide(
    forecasts: Sequence[Forecast], shares: Sequence[list[Share]], seconds: float, some: Bools
) -> Floats:
    """Divide the time among `some` motions (n,) [s] so that they bring most together (Frank and Wolfe 1956)."""
    n = len(some)
    if not some.any():
        some = np.ones(n, dtype=np.bool_)
    stacks = [_Stack(s) for s in shares]
    time: Floats = np.where(some, seconds / some.sum(), 0.0)
    for step in range(24):
        slope = np.zeros(n)
        for forecast, stack in zip(forecasts, stacks, strict=True):
            total = stack.total(time)
            x = forecast.refitted(total)
            slope += stack.left(x) / (GROWTH + max(left(total, x), 0.0))
        size = 2.0 / (step + 3.0)
        time *= 1 - size
        time[int(np.where(some, slope, -np.inf).argmax())] += size * seconds
    return time


class _Stack:
    """Shares side by side."""

    def __init__(self, shares: Sequence[Share]) -> None:
        self.matrix = np.stack([s.matrix for s in shares])
        self.right = np.stack([s.right for s in shares])
        self.square = np.array([s.square for s in shares])
        self.sure = np.array([s.sure for s in shares])

    def total(self, time: Floats) -> Share:
        return Share(
            matrix=np.tensordot(time, self.matrix, 1),
            right=time @ self.right,
            square=float(time @ self.square),
            sure=float(time @ self.sure),
        )

    def left(self, x: Floats) -> Floats:
        return np.asarray(self.sure + 0.5 * (self.square - 2 * self.right @ x + (self.matrix @ x) @ x))


def _imagined(motions: Sequence[Motion], arena: Arena, robot: Robot, span: float) -> tuple[Imagined, float]:
    """Return scans at all moments, with fewer rays, and how many rays each stands for."""
    poses = np.concatenate([m.poses for m in motions])
    v, omega = np.concatenate([m.twists for m in motions]).T
    when = np.concatenate([m.when for m in motions])
    sensor = robot.sensor
    every = max(1, -(-sensor.n_rays // MOST_RAYS))
    rays = np.arange(every // 2, sensor.n_rays, every)
    phi = poses[:, 2]
    data = Imagined(
        arena=arena,
        sensor=replace(sensor, bearings=sensor.bearings[rays]),
        tolerances=robot.tolerances,
        stamps=when,
        ranges=np.zeros((len(poses), len(rays))),
        poses=poses,
        twists=np.stack([v * np.cos(phi), v * np.sin(phi), omega], axis=1),
        track=(when, poses),
        begin=0.0,
        span=span,
        laser_frame=False,
    )
    return data, sensor.n_rays / len(rays)


def _readings(expected: ExpectedReadings, data: ScanData) -> Floats:
    """Return what the first model reads without noise; inf where the ray rather does not return."""
    with np.errstate(invalid="ignore"):
        seen = (expected.reading < data.sensor.range_max) & (expected.p_return > 0.5)
    return np.where(seen, expected.reading, np.inf)


def _weights(
    solver: Solver, truth: ExpectedReadings, data: ScanData, same: Bools, noisier: Floats
) -> tuple[Floats, Floats]:
    """Return weights [1/m²] of the rays that tell little by little, and the nats of those that tell at once.

    Parameters
    ----------
    same : (n_scans, n_rays) both models see the same wall, along a straight ray
    noisier : variance of the readings under the first model over that under the second
    """
    expected = solver.expected
    sigma = expected.sigma
    both = np.isfinite(truth.reading) & np.isfinite(expected.reading)
    off = np.where(both, np.where(both, truth.reading, 0.0) - np.where(both, expected.reading, 0.0), 0.0)
    back_a, back_b = _back(truth, data), _back(expected, data)
    asked = expected.p_alternative <= EDGE
    asked &= truth.p_alternative <= EDGE
    near: Bools = solver.jacobian.valid & (same | (np.abs(off) <= FAR * sigma)) & data.returned
    weight = np.where(near & asked, back_a / sigma**2, 0.0)
    spread = 0.5 * (noisier - 1 - np.log(noisier))
    at_once = np.minimum(np.where(near, 0.0, 0.5 * (off / sigma) ** 2) + spread, CAP)
    returns = back_a * np.log(back_a / back_b) + (1 - back_a) * np.log((1 - back_a) / (1 - back_b))
    sure = np.where(asked, returns + back_a * back_b * at_once, 0.0)
    return weight, sure


def _back(expected: ExpectedReadings, data: ScanData) -> Floats:
    """Return the chance of a return, never quite 0 or 1."""
    aimed = np.isfinite(expected.reading)
    margin = data.sensor.range_max - np.where(aimed, expected.reading, 1e9)
    chance = expected.p_return * ndtr(margin / expected.sigma)
    return np.clip(np.where(aimed, chance, 0.0), LOSS, 1 - LOSS)


def _part(solver: Solver, walls: Floats, rows: slice) -> Solver:
    """Return the solver of some scans."""
    n = solver.shape[0]

    def cut(thing: Any) -> Any:
        parts = {f.name: getattr(thing, f.name) for f in fields(thing)}
        kept: dict[str, Any] = {}
        for name, value in parts.items():
            if isinstance(value, np.ndarray) and value.ndim >= 2:
                kept[name] = value[:, rows] if name == "ends" else value[rows]
        return replace(thing, **kept)

    some = np.arange(n)[rows]
    return Solver(
        solver.data.part(some),
        cut(solver.expected),
        cut(solver.jacobian),
        walls,
        solver.effects[rows],
        solver.corners,
        solver.locked,
    )
