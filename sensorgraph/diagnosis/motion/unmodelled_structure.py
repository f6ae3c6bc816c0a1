"""Structure in the difference of odometry and reference that no effect of the library makes.

Families of columns say how such structure may look: over time, speed, direction, acceleration, place. Their
coefficients have a prior, so that the evidence of a family is that of a Gaussian process of so many degrees of
freedom, and no more is asked of a rich family than of a poor one. The noise is limited (`noise`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from sensorgraph.diagnosis.motion.noise import HUBER, Limits, Noise, fit_noise
from sensorgraph.diagnosis.motion.odometry_rows import Rows
from sensorgraph.diagnosis.motion.whitened_regression import Increments, huber
from sensorgraph.types import Bools, Floats
from sensorgraph.world.robot import Robot

ROOM = 1.5
"""[m] that a run must cover for its reference to be called distorted over the place: no camera bends within less."""
MOMENTS = 15
"""Of a run at which something may change once."""
STATEMENTS = {
    "time": "by a scale that changes in time",
    "jump": "by a scale that changes once",
    "speed": "by a scale that depends on speed or turn rate",
    "direction": "differently forward and backward, or to the left and to the right",
    "acceleration": "when the robot accelerates",
    "place": "by a scale that depends on the place",
    "clock": "by a clock offset that changes in time",
    "reference yaw": "by a yaw of the reference that depends on the place",
    "reference place": "by a position of the reference that is distorted over the place",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Family:
    """Differences that no library effect makes."""

    columns: Floats
    """(2 n, k)"""
    labels: list[str]
    sigma: float
    """Of each parameter, a priori."""
    choices: float = 0.0
    """[nats] for having been chosen among several."""
    statement: str = ""
    """How the readings differ, as the end of a sentence."""


def families(rows: Rows, wheels: Increments) -> dict[str, Family]:
    """Return columns (2 n, k) of differences that no library effect makes, and what to call each."""
    rates = wheels.rates
    v, omega = np.abs(rates[:, 0]), np.abs(rates[:, 1])
    kernel = np.ones(5) / 5
    smooth = np.stack([np.convolve(np.pad(x, 2, mode="edge"), kernel, mode="valid") for x in rates.T], axis=1)
    gain = np.abs(np.gradient(smooth, wheels.middle, axis=0))
    pieces = np.clip(
        (6 * (wheels.middle - wheels.start[0]) / (wheels.end[-1] - wheels.start[0])).astype(np.intp), 0, 5
    )
    span = [f"{a:.0f} to {b:.0f} s" for a, b in _spans(wheels, 6)]
    out: dict[str, Family] = {}

    def both(name: str, masks: list[tuple[str, str, Floats]]) -> None:
        columns, labels = [], []
        nil = np.zeros(rows.n)
        for label, kind, mask in masks:
            along = rows.D_along @ (wheels.way * mask) if kind in ("v", "both") else nil
            yaw = rows.D_yaw @ (wheels.turn * mask) if kind in ("omega", "both") else nil
            columns.append(np.where(np.tile(rows.is_valid, 2), np.concatenate([along, yaw]), 0.0))
            labels.append(
                f"{label}, {'way' if kind == 'v' else 'turn' if kind == 'omega' else 'way and turn'}"
            )
        if columns:
            out[name] = Family(columns=np.stack(columns, axis=1), labels=labels, sigma=0.1)

    as_float = np.float64
    both(
        "time", [(span[k], kind, (pieces == k).astype(as_float)) for k in range(6) for kind in ("v", "omega")]
    )
    whole = np.ptp(wheels.middle)
    for k in range(1, MOMENTS + 1):
        late = (wheels.middle > wheels.start[0] + k / (MOMENTS + 1) * whole).astype(as_float)
        begin = f"from {wheels.start[0] + k / (MOMENTS + 1) * whole:.0f} s on"
        both(f"jump {k}", [(begin, "v", late), (begin, "omega", late)])
    cuts = np.array([0.12, 0.22, 0.32]) * max(1.0, float(np.quantile(v, 0.98)) / 0.4)
    turns = np.array([0.25, 0.5, 0.75]) * max(1.0, float(np.quantile(omega, 0.98)))
    both(
        "speed",
        [(f"|v| above {c:.2f} m/s", "v", (v > c).astype(as_float)) for c in cuts]
        + [(f"|omega| above {c:.2f} rad/s", "omega", (omega > c).astype(as_float)) for c in turns],
    )
    both(
        "direction",
        [
            ("backward", "v", (rates[:, 0] < 0).astype(as_float)),
            ("to the right", "omega", (rates[:, 1] < 0).astype(as_float)),
        ],
    )
    both(
        "acceleration",
        [
            (
                f"above {np.quantile(gain[:, 0], 0.85):.2f} m/s²",
                "v",
                (gain[:, 0] > np.quantile(gain[:, 0], 0.85)).astype(as_float),
            ),
            (
                f"above {np.quantile(gain[:, 1], 0.85):.2f} rad/s²",
                "omega",
                (gain[:, 1] > np.quantile(gain[:, 1], 0.85)).astype(as_float),
            ),
        ],
    )
    cells = np.floor(rows.spots[:, :2] / 1.0).astype(np.intp)
    keys, which = np.unique(cells, axis=0, return_inverse=True)
    way = np.bincount(which.ravel(), weights=np.abs(wheels.way))
    large = np.argsort(-way)[:24]
    large = large[way[large] > 0.3]
    both(
        "place",
        [
            (
                f"round ({keys[k][0] + 0.5:.1f}, {keys[k][1] + 0.5:.1f})",
                "both",
                (which.ravel() == k).astype(as_float),
            )
            for k in large
        ],
    )
    part = np.clip((5 * (rows.stamps - rows.stamps[0]) / np.ptp(rows.stamps)).astype(np.intp), 0, 4)
    masks = [(part == k)[:, None] * rows.slopes for k in range(5)]
    clock = np.stack([np.where(np.tile(rows.is_valid, 2), m.T.ravel(), 0.0) for m in masks], axis=1)
    out["clock"] = Family(
        columns=clock, labels=[f"{a:.0f} to {b:.0f} s, clock" for a, b in _spans(wheels, 5)], sigma=0.1
    )
    if np.ptp(rows.levels[:, :2], axis=0).max() >= ROOM:
        out |= _reference_families(rows, rows.D_along @ wheels.way)
    said = {name: STATEMENTS[kind_of(name)] for name in out}
    for name in said:
        if kind_of(name) == "jump":
            said[name] += out[name].labels[0].partition(",")[0].replace("from", ", from")
            out[name] = replace(out[name], choices=float(np.log(MOMENTS)))
    return {name: replace(family, statement=said[name]) for name, family in out.items()}


def kind_of(name: str) -> str:
    """Return the kind of a family: its name without the number that tells it from its like."""
    return name.rstrip(" 0123456789")


def _spans(wheels: Increments, n: int) -> list[tuple[float, float]]:
    edges = np.linspace(wheels.start[0], wheels.end[-1], n + 1)
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))


def _reference_families(rows: Rows, way: Floats) -> dict[str, Family]:
    """Return columns of a reference that is distorted over the place.

    Parameters
    ----------
    way : (n,) [m] of the wheels; steps of the reference itself would bring its noise into the columns
    """
    xy = (rows.levels[1:, :2] + rows.levels[:-1, :2]) / 2
    low, size = xy.min(axis=0), float(np.ptp(xy, axis=0).max())
    u, v = ((xy - low) / size).T
    c, s = np.cos(rows.poses[:, 2]), np.sin(rows.poses[:, 2])
    du, dv = way * c / size, way * s / size
    waves = [
        -np.pi * a * np.sin(np.pi * a * u) * np.cos(np.pi * b * v) * du
        - np.pi * b * np.cos(np.pi * a * u) * np.sin(np.pi * b * v) * dv
        for a in range(5)
        for b in range(5)
        if 0 < a + b < 7
    ]
    nil = np.zeros(rows.n)
    ok = np.tile(rows.is_valid, 2)
    yaw = np.stack([np.where(ok, np.concatenate([nil, w]), 0.0) for w in waves], axis=1)
    u, v = u - 0.5, v - 0.5
    powers = [
        a * u ** max(a - 1, 0) * v**b * du + b * u**a * v ** max(b - 1, 0) * dv
        for a in range(4)
        for b in range(4)
        if 0 < a + b < 4
    ]
    place = np.stack(
        [np.where(ok, np.concatenate([axis * p, nil]), 0.0) for p in powers for axis in (c, s)], axis=1
    )
    return {
        "reference yaw": Family(
            columns=yaw, labels=["yaw of the reference by place"] * yaw.shape[1], sigma=0.02
        ),
        "reference place": Family(
            columns=place, labels=["position of the reference by place"] * place.shape[1], sigma=0.2
        ),
    }


class Judge:
    """Compares families of structure with noise, and with each other."""

    def __init__(self, ok: Bools, y: Floats, noise_of: Callable[[int, Floats, Bools], Noise]) -> None:
        """Compare over rows y (2 n,), those of `ok` (n,); `noise_of` fits the noise of one kind of row."""
        self.ok, self.y, self.noise_of, self.n = ok, y, noise_of, len(ok)
        self.both = np.concatenate([ok, ok])
        self.noises: list[Noise] = []
        self.left = y
        self.weights = np.ones(len(y))

    def best(self, own: Floats, candidates: Mapping[str, Family]) -> tuple[str, float]:
        """Return the family that explains most beside the model's own columns (2 n, k), and its evidence [nats]."""
        here = self._level(own)
        screened = {name: self._screened(own, family) for name, family in candidates.items()}
        name = max(screened, key=lambda key: screened[key])
        return name, max(self._level(own, candidates[name]) - here, screened[name])

    def dispersion(self, span: float, period: float) -> float:
        """Return how much more than noise of the fitted kind the last fit left, over blocks of `span` [s]; at least 1.

        A ratio of variances: that of the blocks' sums over what uncorrelated whitened rows, `period` [s] apart, give.
        """
        block = np.arange(self.n) // max(round(span / period), 1)
        halves = (self.left[: self.n], self.left[self.n :])
        sums, squares = 0.0, 0.0
        for noise, half in zip(self.noises, halves, strict=True):
            white = np.where(self.ok, noise.white(half), 0.0)
            limited = np.clip(white, -HUBER, HUBER)
            sums += float(np.square(np.bincount(block, limited)).sum())
            squares += float(np.square(limited).sum())
        return max(1.0, sums / max(squares, 1e-12))

    def gain(self, own: Floats, family: Family) -> float:
        """Return the evidence of one family beside columns (2 n, k) [nats]."""
        return self._level(own, family) - self._level(own)

    def gain_of(self, more: Floats, less: Floats) -> float:
        """Return how much more likely columns are than fewer columns [nats]."""
        return self._level(more) - self._level(less)

    def _level(self, own: Floats, family: Family | None = None) -> float:
        """Fit columns and noise in turn; return the evidence, without constants [nats]."""
        left = self.y
        for _ in range(2):
            self._fit(left)
            left, price = self._left(own, family)
        self._fit(left)
        self.left = left
        parts = zip(self.noises, (left[: self.n], left[self.n :]), strict=True)
        return sum(noise.loglik(part, self.ok) for noise, part in parts) - price

    def _fit(self, left: Floats) -> None:
        halves = (left[: self.n], left[self.n :])
        self.noises = [self.noise_of(i, half, self.ok) for i, half in enumerate(halves)]
        self.weights = np.ones(len(left))
        self.weights = np.sqrt(huber(self._white(left)))

    def _white(self, columns: Floats) -> Floats:
        out = np.concatenate(
            [noise.white(columns[i * self.n : (i + 1) * self.n]) for i, noise in enumerate(self.noises)]
        )
        keep = np.where(self.both, self.weights, 0.0)
        out *= keep if out.ndim == 1 else keep[:, None]
        return out

    def _left(self, own: Floats, family: Family | None) -> tuple[Floats, float]:
        """Return what columns leave (2 n,) and the price of the family's freedom: prior and Occam factor [nats]."""
        scale = np.maximum(np.linalg.norm(own, axis=0), 1e-12)
        columns, k = own / scale, own.shape[1]
        if family is not None:
            columns = np.concatenate([columns, family.columns * family.sigma], axis=1)
        Z = self._white(columns)
        G, b = Z.T @ Z, Z.T @ self._white(self.y)
        prior = np.concatenate([np.full(k, 1e-8 * np.trace(G[:k, :k]) / k), np.ones(len(G) - k)])
        theta = np.linalg.solve(G + np.diag(prior), b)
        price = 0.5 * float(theta[k:] @ theta[k:])
        if family is not None:
            price += 0.5 * float(np.linalg.slogdet(np.eye(len(G) - k) + _cleared(G, k, prior))[1])
            price += family.choices
        return self.y - columns @ theta, price

    def _screened(self, own: Floats, family: Family) -> float:
        """Return the evidence of a family if the noise stays as it is [nats]."""
        scale = np.maximum(np.linalg.norm(own, axis=0), 1e-12)
        k = own.shape[1]
        Z = self._white(np.concatenate([own / scale, family.columns * family.sigma], axis=1))
        G, b = Z.T @ Z, Z.T @ self._white(self.y)
        prior = np.concatenate([np.full(k, 1e-8 * np.trace(G[:k, :k]) / k), np.zeros(len(G) - k)])
        S = _cleared(G, k, prior)
        c = b[k:] - G[k:, :k] @ np.linalg.solve(G[:k, :k] + np.diag(prior[:k]), b[:k])
        H = np.eye(len(S)) + S
        return float(0.5 * c @ np.linalg.solve(H, c) - 0.5 * np.linalg.slogdet(H)[1]) - family.choices


def _cleared(G: Floats, k: int, prior: Floats) -> Floats:
    """Return the information on the columns from k on when the first k are free."""
    H = G[:k, :k] + np.diag(prior[:k])
    return np.asarray(G[k:, k:] - G[k:, :k] @ np.linalg.solve(H, G[:k, k:]))


class LimitedNoise:
    """Fits noise within limits, each time from where the last fit ended."""

    def __init__(self, limits: tuple[Limits, Limits]) -> None:
        self.limits = limits
        self.starts: list[Floats | None] = [None, None]

    def __call__(self, i: int, residual: Floats, ok: Bools) -> Noise:
        """Return the noise of ways (0) or turns (1)."""
        noise, self.starts[i] = fit_noise(residual, ok, self.limits[i], self.starts[i])
        return noise


def limits_of(rows: Rows, wheels: Increments, robot: Robot) -> tuple[Limits, Limits]:
    """Return the limits of the noise of ways and of turns."""
    step = float(np.median(wheels.end - wheels.start))
    period = float(np.median(np.diff(rows.stamps)))
    told = (
        (robot.wheels.sigma_v, max(robot.pose.sigma_xy, robot.tolerances.pose_xy)),
        (robot.wheels.sigma_omega, max(robot.pose.sigma_yaw, robot.tolerances.pose_yaw)),
    )
    v, omega = (Limits(walk=s * np.sqrt(step), wander=w, period=period) for s, w in told)
    return v, omega
