"""Which change of a robot's wheels explains the changes of several quantities.

A left wheel that loses the share s of its radius changes the distance scale by -s/2, the difference of the wheels by +s
and the turn scale by -s/2: three changes with one cause. Each cause is a vector c of what a change of 1 does to the three
measured quantities d, with standard errors e. With a normal prior of width w for the size, its evidence is that of
d ~ N(0, diag(e²) + w² c cᵀ), and its size the posterior mean. A cause is named if its posterior probability among
all causes is at least SURE. Its effect is then taken out of all quantities, which are searched again: a quantity that
shows no further change was a consequence.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from sensorgraph.surveying.trends import SPREAD, SURE, TrendStep, change_at, profile, steps_of
from sensorgraph.types import Floats

MEASURED = ("way_scale", "wheel_difference", "turn_scale")
CAUSES: Mapping[str, tuple[float, float, float]] = {
    "left_wheel": (0.5, -1.0, 0.5),
    "right_wheel": (0.5, 1.0, 0.5),
    "way_scale": (1.0, 0.0, 1.0),
    "turn_scale": (0.0, 0.0, 1.0),
}
"""Cause -> changes of the measured quantities by a change of 1: one wheel, both wheels alike, the wheelbase."""
SHOWN_IN: Mapping[str, tuple[float, float, float]] = {
    "left_wheel": (1.0, -0.5, 0.0), "right_wheel": (1.0, 0.5, 0.0), "wheel_difference": (0.0, 1.0, 0.0), "turn_scale": (0.0, 0.0, 1.0),
}  # fmt: skip
"""Quantity in which changes are searched -> its changes by those of the measured quantities."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Series:
    """One quantity of one robot over its logs."""

    t: Floats
    """(n,) [s]"""
    values: Floats
    sigmas: Floats


@dataclass(frozen=True, kw_only=True)
class CausedStep:
    """A change, and the quantities that show it as well."""

    step: TrendStep
    t: float
    """[s] Time of the last log before it."""
    seen_in: tuple[str, ...] = ()


def changes_of_wheels(series: Mapping[str, Series]) -> list[CausedStep]:
    """Return the changes of a robot's wheels by their causes.

    Parameters
    ----------
    series : Values of `MEASURED` and of the quantities of `SHOWN_IN`, as far as they are known.
    """
    left, out = dict(series), []
    steps = _steps(left)
    while any(steps.values()):
        name = max(steps, key=lambda one: max((_weight(step) for step in steps[one]), default=(0.0, 0.0)))
        step = max(steps[name], key=_weight)
        t = float(left[name].t[step.before])
        cause = _cause(left, step, t, [float(left[name].t[one.before]) for one in steps[name]])
        if cause is not None:
            fewer = {other: _without(one, other, cause, t) for other, one in left.items()}
            after = _steps(fewer)
            if len(after[name]) < len(steps[name]):
                seen = [
                    one
                    for one in steps
                    if one != cause.quantity and len(after.get(one, ())) < len(steps[one])
                ]
                out.append(CausedStep(step=cause, t=t, seen_in=tuple(seen)))
                left, steps = fewer, after
                continue
        out += [CausedStep(step=one, t=float(left[name].t[one.before])) for one in steps.pop(name)]
        del left[name]
    return out


def _steps(series: Mapping[str, Series]) -> dict[str, list[TrendStep]]:
    return {
        name: steps_of(name, one.t, one.values, one.sigmas)
        for name, one in series.items()
        if name in SHOWN_IN
    }


def _weight(step: TrendStep) -> tuple[float, float]:
    """Return what the surest change is chosen by."""
    return step.probability, abs(step.size) / max(step.sigma, 1e-12)


def _cause(series: Mapping[str, Series], step: TrendStep, t: float, places: list[float]) -> TrendStep | None:
    """Return the change of the one cause that explains a step, or None if none is sure enough.

    Parameters
    ----------
    t : [s] Time of the last log before the step.
    places : [s] Such times of all steps of the same quantity: the change is measured from the one before to the next.
    """
    window = (
        max((one for one in places if one < t), default=-np.inf),
        min((one for one in places if one > t), default=np.inf),
    )
    known = [k for k, name in enumerate(MEASURED) if name in series]
    found = []
    for k in known:
        one = series[MEASURED[k]]
        inside = (one.t > window[0]) & (one.t <= window[1])
        found.append(
            change_at(MEASURED[k], one.t[inside], one.values[inside], one.sigmas[inside], t, step.is_drift)
        )
    d, e = np.array(found).reshape(-1, 2).T
    sure = np.isfinite(e)
    vectors = {name: np.array(c)[known][sure] for name, c in CAUSES.items()}
    evidence = np.array([_log_evidence(d[sure], e[sure], c, SPREAD[name]) for name, c in vectors.items()])
    best = list(vectors)[int(np.argmax(evidence))]
    if np.exp(evidence.max() - logsumexp(evidence)) < SURE:
        return None
    c, w = vectors[best], 1 / e[sure] ** 2
    precision = float(c @ (w * c)) + 1 / SPREAD[best] ** 2
    return replace(step, quantity=best, size=float(c @ (w * d[sure])) / precision, sigma=precision**-0.5)


def _log_evidence(d: Floats, e: Floats, c: Floats, width: float) -> float:
    """Return the log density of d ~ N(0, diag(e²) + width² c cᵀ), without the constant."""
    covariance = np.diag(e**2) + width**2 * np.outer(c, c)
    return float(-0.5 * (d @ np.linalg.solve(covariance, d) + np.linalg.slogdet(covariance)[1]))


def _without(one: Series, name: str, cause: TrendStep, t: float) -> Series:
    """Return a quantity with the effect of a cause taken out."""
    c = np.array(CAUSES[cause.quantity])
    effect = c[MEASURED.index(name)] if name in MEASURED else float(np.dot(SHOWN_IN[name], c))
    shape = profile(one.t, t, is_drift=cause.is_drift)
    return replace(one, values=one.values - effect * cause.size * shape)
