"""Usual sizes: how large an effect seems at a site though nothing is wrong, and whether all parts of a run agree on it.

A number for the whole sensor (a bias, a drift, a share of strays) that is fitted to a run at a real site is never zero:
the map is a little off here and there, people pass. Windows of good runs show how it spreads from one window to the
next. A name takes a size beyond that spread. And where the parts of a run disagree on the number far more than the parts
of good runs do, it is no number of the sensor but something at a few places: then it must stand out of its own scatter.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtri, stdtrit

from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.gauss_newton import Solver, boxed
from sensorgraph.diagnosis.scan.nuisance import BOX, effects_with_nuisances
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.types import Bools, Floats, Ints

PARTS = 8  # of a run, in time
SURE = 0.999  # of the t and F quantiles
FEW = 4  # windows, for a spread
TOLD = 3.0  # windows' worth of belief that a careful set-up varies by a third of the materiality
OPEN = 1e3  # [m, rad, s] prior width of a number that is free


@dataclass(frozen=True, kw_only=True)
class WindowEstimate:
    """What one window of a good run shows by itself."""

    n_scans: int
    n_readings: int
    gains: Mapping[str, float]
    """Effect -> [nats] the most that it gains, its price paid."""
    sizes: Mapping[str, Mapping[str, float]]
    """Effect -> parameter -> fitted value."""
    wobbles: Mapping[str, float]
    """Effect -> standard error by leaving out parts of the window [materialities]."""
    misfit: float
    """[nats] left unexplained."""

    def wobble(self, name: str, n_scans: int) -> float:
        """Return the standard error of an effect, scaled to a window of so many scans [materialities]."""
        return self.wobbles.get(name, 0.0) * float(np.sqrt(self.n_scans / n_scans))


@dataclass(frozen=True, kw_only=True)
class BaselineInterval:
    """How large an effect seems, window by window, though nothing is wrong."""

    middle: Mapping[str, float]
    """Parameter -> mean, a share by its `scale`."""
    reach: Mapping[str, float]
    """Parameter -> how far from the mean a further window may be (prediction interval)."""
    wobble: float | None = None
    """Standard error by leaving out parts, for a run of this length [materialities]; None: not looked at."""
    n_windows: int = 1

    def said(self, name: str) -> dict[str, list[float]]:
        """Return the interval of each parameter."""
        ends = [
            unscaled(name, {k: self.middle[k] + sign * self.reach[k] for k in self.reach}) for sign in (-1, 1)
        ]
        return {k: [end[k] for end in ends] for k in self.reach}

    def contains(self, amendment: Amendment) -> bool:
        """Tell whether a size is one that the site shows by itself; several parameters add as a vector."""
        values = scaled(amendment.name, amendment.parameters)
        off = [(values[k] - self.middle[k]) / self.reach[k] for k in self.reach]
        return bool(np.hypot.reduce(off) < 1.0)

    def is_unsteady(self, wobble: float) -> bool:
        """Tell whether the parts of a window disagree more than those of good windows."""
        return self.wobble is not None and is_unsteady(wobble, self.wobble, self.n_windows)


def is_usual(fitted: Fitted, amendment: Amendment) -> bool:
    """Tell whether an effect of a fit is what the site shows by itself, or only stands at a few places."""
    data = fitted.solver.data
    usual = data.usual.get(amendment.name)
    if usual is None:
        return False
    if usual.contains(amendment):
        return True
    if usual.wobble is None or amendment.name not in fitted.names():
        return False
    wobble = kept_wobble(fitted, amendment)
    if not usual.is_unsteady(wobble):
        return False
    off = {k: amendment[k] - usual.middle[k] for k in usual.reach}
    return in_materialities(amendment.name, off) < wobble * float(stdtrit(PARTS - 2, SURE))


def in_materialities(name: str, values: Mapping[str, float]) -> float:
    """Return the length of a vector of parameters, each in its materiality."""
    sizes = EFFECTS[name].sizes
    return float(np.hypot.reduce([values[k] / sizes[k] for k in values]))


def kept_wobble(fitted: Fitted, amendment: Amendment) -> float:
    """Return the standard error of an effect of a fit, by leaving out parts [materialities]; computed once."""
    memo = fitted.solver.data.memo
    key = f"wobble|{amendment.name}|{fitted.model!r}".encode()
    if key not in memo:
        memo[key] = wobble(fitted, amendment)
    kept = memo[key]
    assert isinstance(kept, float)
    return kept


def wobble(fitted: Fitted, amendment: Amendment) -> float:
    """Return the standard error of an effect of a fit, by leaving out parts [materialities]."""
    solver, names, place = fitted.solver, list[str](), 0
    for index, other in enumerate(fitted.model):
        smooth = list(other.steps)
        if other.name == amendment.name:
            names = smooth
            place = solver.n_g + sum(len(a.steps) for a in fitted.model[:index])
    chosen = np.arange(place, place + len(names))
    tau = solver.scaled(fitted.state)
    error = left_out(systems(fitted), tau, BOX * tau, solver.locked, chosen)
    return in_materialities(amendment.name, dict(zip(names, error, strict=True)))


def alone(fitted: Fitted) -> tuple[dict[str, dict[str, float]], dict[str, float]]:
    """Return, per smooth effect of the whole sensor, its size and wobble were it added to a fit, alone."""
    solver, parts = fitted.solver, systems(fitted)
    sizes, wobbles = {}, {}
    for effect in effects_with_nuisances():
        name, names = effect.name, effect.steps
        chosen = np.array(effect.nuisances)
        if solver.locked[chosen].any():
            continue
        tau = solver.scaled(fitted.state)
        tau[chosen] = OPEN
        size = solved(parts, tau, BOX * tau, solver.locked)[chosen]
        error = left_out(parts, tau, BOX * tau, solver.locked, chosen)
        sizes[name] = dict(zip(names, map(float, size), strict=True))
        wobbles[name] = in_materialities(name, dict(zip(names, error, strict=True)))
    return sizes, wobbles


def systems(fitted: Fitted) -> list[tuple[Floats, Floats]]:
    """Return the normal equations (matrix, right) of each part of the run, in time."""
    solver: Solver = fitted.solver
    weight = fitted.solution.responsibilities.weight
    out = []
    for rows in np.array_split(np.arange(len(weight)), PARTS):
        some = np.zeros_like(weight)
        some[rows] = weight[rows]
        system = solver.assemble(some, fitted.state.pose_scale)
        out.append((system.matrix, system.right))
    return out


def solved(parts: Iterable[tuple[Floats, Floats]], tau: Floats, box: Floats, locked: Bools) -> Floats:
    """Solve the sum of normal equations under priors and boxes, (k,)."""
    matrices, rights = zip(*parts, strict=True)
    return np.concatenate(boxed(np.sum(matrices, axis=0), np.sum(rights, axis=0), tau, box, locked))


def left_out(
    parts: Sequence[tuple[Floats, Floats]], tau: Floats, box: Floats, locked: Bools, chosen: Ints
) -> Floats:
    """Return the jackknife's standard errors of some unknowns (Efron and Stein 1981), parts being left out."""
    n = len(parts)
    rest = [[p for k, p in enumerate(parts) if k != left] for left in range(n)]
    values = np.array([solved(some, tau, box, locked)[chosen] for some in rest])
    return np.asarray(np.sqrt((n - 1) * values.var(axis=0)))


def usual_sizes(seen: Sequence[WindowEstimate], n_scans: int) -> dict[str, BaselineInterval]:
    """Return what is usual in a window of so many scans, by effect."""
    out = {}
    for name in sorted({name for s in seen for name in s.sizes}):
        having = [s for s in seen if name in s.sizes]
        pooled = None
        if EFFECTS[name].nuisances:
            having = steady(having, name, n_scans)
            pooled = _pooled([s.wobble(name, n_scans) for s in having])
        if len(having) < FEW:
            continue
        middle, reach = {}, {}
        for k in having[0].sizes[name]:
            values = np.array([scaled(name, s.sizes[name])[k] for s in having])
            middle[k] = float(values.mean())
            reach[k] = _reach(values, EFFECTS[name].sizes[k] / 3 if EFFECTS[name].nuisances else None)
        out[name] = BaselineInterval(middle=middle, reach=reach, wobble=pooled, n_windows=len(having))
    return out


def scaled(name: str, values: Mapping[str, float]) -> dict[str, float]:
    """Return parameters on a scale where they spread evenly: of a share its root (Anscombe 1948)."""
    shares = {q.name for q in EFFECTS[name].parameters if (q.low, q.high) == (0.0, 1.0)}
    return {k: float(np.sqrt(v)) if k in shares else v for k, v in values.items()}


def unscaled(name: str, values: Mapping[str, float]) -> dict[str, float]:
    """Return parameters that were `scaled`."""
    shares = {q.name for q in EFFECTS[name].parameters if (q.low, q.high) == (0.0, 1.0)}
    return {k: float(max(v, 0.0) ** 2) if k in shares else v for k, v in values.items()}


def steady(seen: Sequence[WindowEstimate], name: str, n_scans: int) -> list[WindowEstimate]:
    """Leave out windows whose parts disagree on an effect more than those of the others (F test)."""
    wobbles = [s.wobble(name, n_scans) for s in seen]
    kept = []
    for k, (s, own) in enumerate(zip(seen, wobbles, strict=True)):
        others = wobbles[:k] + wobbles[k + 1 :]
        if not others or not is_unsteady(own, _pooled(others), len(others)):
            kept.append(s)
    return kept


def is_unsteady(wobble: float, pooled: float, n_windows: int) -> bool:
    """Tell whether the parts of a window disagree more than those of good windows (F test)."""
    limit = fdtri(PARTS - 1, (PARTS - 1) * n_windows, SURE)
    return wobble**2 > float(limit) * pooled**2


def _pooled(wobbles: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(wobbles))))


def _reach(values: Floats, told: float | None) -> float:
    """Return how far from the mean a further value may be; `told` is what set-ups vary by anyhow."""
    n, dof, squares = len(values), len(values) - 1.0, float(((values - values.mean()) ** 2).sum())
    if told is not None:
        dof, squares = dof + TOLD, squares + TOLD * told**2
    spread = np.sqrt(squares / dof)
    return max(float(stdtrit(dof, SURE) * spread * np.sqrt(1 + 1 / n)), 1e-9)
