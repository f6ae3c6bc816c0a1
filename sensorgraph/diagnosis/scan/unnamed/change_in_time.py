"""Test whether a parameter of the sensor changed once during the run: a knock, a restart, a warming laser.

Model: x in the first parts of the run, x + jump in the later ones.

    gain = ½ jumpᵀ s,    jump = (M - M A⁻¹ M)⁻¹ s.

M and s are the normal matrix and the score, summed over the later parts. A is the normal matrix of the whole run with its
priors. Both equations are restricted to the rows and columns of the parameter. This is a Chow test at each possible time, of which the largest counts
(Andrews 1993, Tests for parameter instability with unknown change point). It is applied to every smooth effect of the whole
sensor, in the model or not; the most likely changes are then fitted.

The standard error of a jump is estimated from the scatter of the parts about the fit. Errors shared by neighbouring scans
then count once (Ibragimov and Mueller 2010, t-statistic based correlation and heterogeneity robust inference).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtri

from sensorgraph.diagnosis.report.quantities import brief
from sensorgraph.diagnosis.scan.column_fit import (
    Parts,
    equations_of_parts,
    fit_columns,
    inverse_of_whole,
    parts_of_run,
)
from sensorgraph.diagnosis.scan.consequence import CAUSES, ScanError
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.gauss_newton import Solver
from sensorgraph.diagnosis.scan.nuisance import effects_with_nuisances
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed.family import Checked, Doubt, Unnamed
from sensorgraph.effects import Amendment
from sensorgraph.effects.effect import size_ratio
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.robust import rms
from sensorgraph.types import Floats, Ints

NAME = "change_in_time"
LEAST_INFORMATION = 1e-9
"""Minimum share of a parameter's information that must remain when all other unknowns are free, above round-off."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorNumber:
    """A smooth effect of the whole sensor in a fit."""

    amendment: Amendment
    index: int | None
    """Index in the model; None for a nuisance."""
    unknowns: Ints
    """(k,) Indices among the unknowns of the fit."""
    columns: Ints
    """(k,) Indices among the columns of the solver."""


@dataclass(frozen=True, kw_only=True, eq=False)
class NumberChange:
    """A parameter with a second value in the later parts of the run."""

    number: SensorNumber
    part: int
    """First part with the second value."""
    first: Amendment
    second: Amendment
    gain: float
    """[nats] log-likelihood ratio of two values to one."""
    wald: float = 0.0
    """Squared ratio of the jump to its standard error (from the scatter of the parts), per unknown."""

    @property
    def jump(self) -> dict[str, float]:
        """Change of each parameter."""
        return {name: self.second[name] - self.first[name] for name in self.first.steps}


def find(checked: Checked) -> list[Doubt]:
    """Return a sensor parameter that changed once; sure by more than its materiality and at least half of its value.

    The fit without effects may show the change more clearly than effects that imitate it.
    """
    fitted, null = checked.fitted, checked.null
    screened = _screened_changes(fitted)
    candidates = [c for c in screened if _is_likely(c)]
    found, view = _likeliest(fitted, candidates), fitted
    if candidates and fitted.model and null is not None:
        plain = _likeliest(null, [c for c in _screened_changes(null) if _is_likely(c)])
        if plain is not None and null.j + plain.gain > fitted.j:
            found, view = plain, null
    is_sure = found is not None
    found = found or next(iter(screened), None)
    if found is None:
        return []
    failed = range(len(fitted.model)) if view is not fitted else [found.number.index]
    when = float(view.solver.data.stamps[parts_of_run(view)[found.part][0]] - view.solver.data.begin)
    return [
        Doubt(
            family=NAME,
            price=_price(found),
            is_sure=is_sure,
            statement=_sentence(found.first, found.second, when),
            misfit=found.gain,
            statistic=found.gain,
            threshold=SCAN.selection.threshold,
            failed=frozenset(index for index in failed if index is not None),
            size=_size(view.solver, found),
            causes=(CAUSES["time", "bias"],),
        )
    ]


def _screened_changes(fitted: Fitted) -> list[NumberChange]:
    """Return the changes to first order, most likely first; one for each parameter."""
    rows = parts_of_run(fitted)
    if len(rows[-1]) < SCAN.constancy.min_scans:
        return []
    parts = equations_of_parts(fitted.solver, fitted.solution, rows)
    screened = [_screened(parts, fitted, number) for number in _numbers(fitted)]
    return sorted((c for c in screened if c is not None), key=lambda c: -c.gain)


def _likeliest(fitted: Fitted, candidates: Sequence[NumberChange]) -> NumberChange | None:
    """Return the most likely of the first candidates that is significant and large; None without one."""
    found = [_refitted(fitted, c, parts_of_run(fitted)) for c in candidates[: SCAN.constancy.max_refitted]]
    n_asked = len(_numbers(fitted))
    sure = [c for c in found if _is_likely(c) and _is_sure(c, n_asked) and _is_large(c, fitted)]
    return max(sure, key=lambda c: c.gain, default=None)


def _numbers(fitted: Fitted) -> list[SensorNumber]:
    """Return the smooth effects of the whole sensor: those of the model, and nuisances."""
    solver, out = fitted.solver, list[SensorNumber]()
    place = 0
    for index, a in enumerate(fitted.model):
        own = np.arange(place, place + len(a.steps))
        place += len(own)
        if len(own) and a.effect.place in (None, "sector"):
            columns = len(Nuisance) + own
            out.append(SensorNumber(amendment=a, index=index, unknowns=solver.n_g + own, columns=columns))
    for effect in effects_with_nuisances():
        own = np.array(effect.nuisances)
        # a drift is a bias that changes; a jump of the bias shows it more clearly
        if Nuisance.DRIFT in effect.nuisances or solver.locked[own].any():
            continue
        values = dict(zip(effect.steps, map(float, fitted.state.g[own]), strict=True))
        out.append(SensorNumber(amendment=effect(**values), index=None, unknowns=own, columns=own))
    return out


def _screened(parts: Parts, fitted: Fitted, number: SensorNumber) -> NumberChange | None:
    """Return the most likely change of a parameter, to first order; None where the run cannot distinguish one."""
    solver, chosen = fitted.solver, number.unknowns
    x = np.concatenate([fitted.state.g, fitted.solution.p])
    inverse = inverse_of_whole(parts, solver, fitted.solution)
    matrices = np.array([matrix for matrix, _ in parts])
    scores = np.array([right - matrix @ x for matrix, right in parts])
    trimmed = int(np.ceil(SCAN.constancy.trimmed_share * len(parts)))
    tried = list[tuple[float, int, Floats, Floats]]()
    for part in range(trimmed, len(parts) - trimmed + 1):
        column = matrices[part:].sum(axis=0)[:, chosen]
        beside = inverse @ column  # response of the other unknowns to a unit jump
        score = scores[part:].sum(axis=0)[chosen]
        information = column[chosen] - column.T @ beside
        if np.linalg.eigvalsh(information)[0] <= LEAST_INFORMATION * float(np.trace(column[chosen])):
            continue
        jump = np.linalg.solve(information, score)
        tried.append((0.5 * float(score @ jump), part, -(beside @ jump)[chosen], jump))
    if not tried:
        return None
    gain, part, moved, jump = max(tried, key=lambda one: one[0])
    first = _moved(number.amendment, moved)
    return NumberChange(number=number, part=part, first=first, second=_moved(first, jump), gain=gain)


def _refitted(fitted: Fitted, change: NumberChange, rows: Sequence[Ints]) -> NumberChange:
    """Fit both values jointly with all other unknowns, with the error of the jump from the scatter of the parts."""
    number, k = change.number, len(change.number.unknowns)
    late = np.arange(fitted.solver.data.n_scans) >= rows[change.part][0]
    columns = fitted.solver.stack[:, number.columns] * late[:, None, None]
    jump = np.array(list(change.jump.values()))
    got = fit_columns(fitted, columns, jump, rounds=SCAN.fit.column_rounds, noise_free=False)
    scatter = got.each.T @ got.each
    scatter += 1e-9 * np.trace(scatter) * np.eye(k)
    before = np.concatenate([fitted.state.g, fitted.solution.p])[number.unknowns]
    after = np.concatenate([got.solution.state.g, got.solution.p])[number.unknowns]
    first = _moved(number.amendment, after - before)
    freedom = (len(rows) - 1 - k) / len(rows)
    return replace(
        change,
        first=first,
        second=_moved(first, got.values),
        gain=got.gain,
        wald=float(got.values @ np.linalg.solve(scatter, got.values)) / k * freedom,
    )


def _moved(a: Amendment, step: Floats) -> Amendment:
    """Return an effect with its smooth parameters moved, without standard errors."""
    values = {name: a[name] + float(s) for name, s in zip(a.steps, step, strict=True)}
    return replace(a.moved_to(values), stderr={})


def _is_likely(change: NumberChange) -> bool:
    """Return whether the likelihood supports a change, after the complexity penalty for its size and its time."""
    return change.gain - _price(change) > SCAN.selection.threshold


def _price(change: NumberChange) -> float:
    """Return the complexity penalty [nats] of a change."""
    return SCAN.selection.price * (len(change.number.unknowns) + 1)


def _is_sure(change: NumberChange, n_asked: int) -> bool:
    """Return whether the scatter of the parts supports a change, at the best of n_parts times and n_asked parameters."""
    settings, k = SCAN.constancy, len(change.number.unknowns)
    chance = (1 - settings.confidence) / (settings.n_parts * n_asked)
    return change.wald > float(fdtri(k, settings.n_parts - 1 - k, 1 - chance))


def _is_large(change: NumberChange, fitted: Fitted) -> bool:
    """Return whether a change is material, a large share of the value, and larger than between known-good runs.

    A laser whose mount changes looks like a drifting reference, so the jump must exceed the drift that is allowed.
    """
    a, scale = change.number.amendment, max(1.0, fitted.state.map_scale, fitted.state.pose_scale)
    baseline = fitted.solver.data.baseline_intervals.get(a.name)
    if baseline is not None and set(baseline.mean) == set(change.jump):
        as_window = a.effect(**{k: baseline.mean[k] + v for k, v in change.jump.items()})
        if baseline.contains(as_window, baseline.stderr):
            return False
    if size_ratio(a.effect, change.jump) < max(scale, SCAN.constancy.min_share * a.ratio):
        return False
    told = fitted.solver.data.tolerances
    wanders = {
        Nuisance.MOUNT_X: told.pose_xy,
        Nuisance.MOUNT_Y: told.pose_xy,
        Nuisance.MOUNT_YAW: told.pose_yaw,
    }
    of = {k: a.effect.parameter(k).nuisance for k in change.jump}
    off = [change.jump[k] / wanders[nuisance] for k, nuisance in of.items() if nuisance in wanders]
    return not off or float(np.linalg.norm(off)) > SCAN.constancy.max_wander * scale


def _sentence(first: Amendment, second: Amendment, when: float) -> str:
    """Return a statement of the change and its time."""
    small = SCAN.constancy.min_share * max(first.ratio, second.ratio)
    if first.ratio < small:
        return f"{brief(second)}, but only after {when:.0f} s of the run"
    if second.ratio < small:
        return f"{brief(first)}, but only before {when:.0f} s of the run"
    return f"{brief(first)}, which changes at {when:.0f} s of the run to {brief(second)}"


def _size(solver: Solver, change: NumberChange) -> ScanError:
    """Return the error of readings that are simulated with one value: half of the change in either direction."""
    jump = np.array(list(change.jump.values()))
    off = np.einsum("k,nkm->nm", jump, solver.stack[:, change.number.columns]) / 2
    valid = solver.jacobian.valid & solver.data.returned
    return ScanError(offset=rms(off[valid]), affected=float(valid.mean()))


CHANGE_IN_TIME = Unnamed(
    titles={NAME: "a parameter of the sensor that changes during the run"}, find=find, is_cause=True
)
