"""A parameter of the sensor that changed once during the run: a knock, a restart, a warming laser.

The difference is a jump of the parameter: its columns, in the later parts of the run only. To first order, the gain is

    gain = ½ jumpᵀ s,    jump = (M - M A⁻¹ M)⁻¹ s.

M and s are the normal matrix and the score, summed over the later parts, and A is the normal matrix of the whole run with its
priors; both are restricted to the rows and columns of the parameter. Each parameter of the whole sensor, in the model or not, is
tested at the time of its largest gain (Andrews 1993, Tests for parameter instability with unknown change point).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtri

from sensorgraph.diagnosis.report.quantities import brief
from sensorgraph.diagnosis.scan.consequence import CAUSES
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.normal_equations import ROUND_OFF, System
from sensorgraph.diagnosis.scan.nuisance import effects_with_nuisances
from sensorgraph.diagnosis.scan.unnamed.columns import (
    CONFIDENCE,
    N_PARTS,
    ColumnEstimate,
    Columns,
    Words,
    find_columns,
    inverted,
    systems_of_parts,
    with_priors,
)
from sensorgraph.diagnosis.scan.unnamed.family import Checked, Doubt, Unnamed
from sensorgraph.effects import Amendment
from sensorgraph.effects.effect import size_ratio
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.types import Floats, Ints

NAME = "change_in_time"
TRIMMED = 3
"""Number of parts at the start and at the end of the run in which no change is searched for, 15 % (Andrews 1993, section 4)."""
MIN_SHARE = 0.5
"""Least change relative to the value over the whole run; also the ratio of two values below which the smaller counts as 0."""
MAX_WANDER = 2.7
"""Largest change of the mean of a drifting reference between two parts of a run, in standard deviations: first-order
autoregressions of any memory stay within it in 99 % of the runs, at the worst time."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorParameter:
    """A smooth effect of the whole sensor in a fit: one of the model, or a nuisance."""

    amendment: Amendment
    index: int | None
    """Index in the model; None for a nuisance."""
    unknowns: Ints
    """(k,) Indices among the unknowns of the fit."""
    columns: Ints
    """(k,) Indices among the columns of the solver."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JumpColumns(Columns):
    """A jump of one parameter."""

    of: SensorParameter
    when: float
    """[s] Time of the jump, from the begin of the run."""
    response: Floats
    """(k, k) Change of the parameter over the whole run by a jump of 1."""
    n_tested: int
    """Number of parameters that were tested."""

    @property
    def n_values(self) -> int:
        """Number of values: the jump and its time."""
        return int(self.columns.shape[1]) + 1

    @property
    def least_z(self) -> float:
        """Amplitude in standard errors that it needs, as the best of all times and parameters."""
        k = self.columns.shape[1]
        chance = (1 - CONFIDENCE) / (N_PARTS * self.n_tested)
        return float(np.sqrt(k * fdtri(k, N_PARTS - 1 - k, 1 - chance)))

    def words(self, estimate: ColumnEstimate, fitted: Fitted) -> Words | None:
        """Return the two values and the time of the jump; None for one that is immaterial, usual, or that the reference explains."""
        a, names = self.of.amendment, list(self.of.amendment.steps)
        jump = dict(zip(names, estimate.values.tolist(), strict=True))
        if not _is_large(a, jump, fitted):
            return None
        before = a.moved_to(
            {k: a[k] - m for k, m in zip(names, self.response @ estimate.values, strict=True)}
        )
        after = before.moved_to({k: before[k] + jump[k] for k in names})
        return Words(statement=_sentence(before, after, self.when), causes=(CAUSES["time"]["bias"],))


def find(checked: Checked) -> list[Doubt]:
    """Return a parameter that changed once; sure by more than its materiality and at least half of its value."""
    return find_columns(checked, jumps)


def jumps(fitted: Fitted) -> list[JumpColumns]:
    """Return the likeliest jump of each parameter of the sensor; none if the run is too short."""
    solver, data = fitted.solver, fitted.solver.data
    if data.n_scans < 2 * N_PARTS:
        return []
    weight = fitted.solution.responsibilities.weight
    rows, parts = systems_of_parts(solver, weight, fitted.state.pose_scale)
    whole = np.sum([part.matrix for part in parts], axis=0)
    inverse = inverted(*with_priors(whole, solver, fitted.solution))
    tested, out = _parameters(fitted), list[JumpColumns]()
    for one in tested:
        found = _likeliest(parts, inverse, one, np.concatenate([fitted.state.g, fitted.solution.p]))
        if found is None:
            continue
        part, response = found
        late = np.arange(data.n_scans) >= rows[part][0]
        out.append(
            JumpColumns(
                family=NAME,
                columns=solver.stack[:, one.columns] * late[:, None, None],
                fails=frozenset() if one.index is None else frozenset({one.index}),
                of=one,
                when=float(data.stamps[rows[part][0]] - data.begin),
                response=response,
                n_tested=len(tested),
            )
        )
    return out


def _likeliest(
    parts: Sequence[System], inverse: Floats, one: SensorParameter, x: Floats
) -> tuple[int, Floats] | None:
    """Return the first part with the second value and the response (k, k); None where the run shows no jump."""
    chosen, best, found = one.unknowns, -np.inf, None
    scores = [part.right - part.matrix @ x for part in parts]
    for part in range(TRIMMED, N_PARTS - TRIMMED + 1):
        column = np.sum([later.matrix for later in parts[part:]], axis=0)[:, chosen]
        response = inverse @ column  # of all unknowns to a jump of 1
        score = np.sum(scores[part:], axis=0)[chosen]
        information = column[chosen] - column.T @ response
        if np.linalg.eigvalsh(information)[0] <= ROUND_OFF * float(np.trace(column[chosen])):
            continue
        gain = 0.5 * float(score @ np.linalg.solve(information, score))
        if gain > best:
            best, found = gain, (part, response[chosen])
    return found


def _parameters(fitted: Fitted) -> list[SensorParameter]:
    """Return the smooth effects of the whole sensor: those of the model, and nuisances."""
    solver, out, place = fitted.solver, list[SensorParameter](), 0
    for index, a in enumerate(fitted.model):
        own = np.arange(place, place + len(a.steps))
        place += len(own)
        if len(own) and a.effect.place in (None, "sector"):
            columns = len(Nuisance) + own
            out.append(SensorParameter(amendment=a, index=index, unknowns=solver.n_g + own, columns=columns))
    for effect in effects_with_nuisances():
        own = np.array(effect.nuisances)
        # a drift is a bias that changes; a jump of the bias shows it more clearly
        if Nuisance.DRIFT in effect.nuisances or solver.locked[own].any():
            continue
        values = dict(zip(effect.steps, map(float, fitted.state.g[own]), strict=True))
        out.append(SensorParameter(amendment=effect(**values), index=None, unknowns=own, columns=own))
    return out


def _is_large(a: Amendment, jump: dict[str, float], fitted: Fitted) -> bool:
    """Return whether a jump is material, a large share of the value, and larger than between known-good runs.

    A laser whose mount changes looks like a drifting reference, so the jump must exceed the drift that is allowed.
    """
    data, scale = fitted.solver.data, max(1.0, fitted.state.map_scale, fitted.state.pose_scale)
    baseline = data.site.intervals.get(a.name)
    if baseline is not None and set(baseline.mean) == set(jump):
        as_window = a.effect(**{k: baseline.mean[k] + v for k, v in jump.items()})
        if baseline.contains(as_window, baseline.stderr):
            return False
    if size_ratio(a.effect, jump) < max(scale, MIN_SHARE * a.ratio):
        return False
    told = data.tolerances
    wanders = {
        Nuisance.MOUNT_X: told.pose_xy, Nuisance.MOUNT_Y: told.pose_xy, Nuisance.MOUNT_YAW: told.pose_yaw,
    }  # fmt: skip
    of = {k: a.effect.parameter(k).nuisance for k in jump}
    off = [jump[k] / wanders[nuisance] for k, nuisance in of.items() if nuisance in wanders]
    return not off or float(np.linalg.norm(off)) > MAX_WANDER * scale


def _sentence(before: Amendment, after: Amendment, when: float) -> str:
    """Return a statement of the two values and the time [s] between them."""
    small = MIN_SHARE * max(before.ratio, after.ratio)
    if before.ratio < small:
        return f"{brief(after)}, but only after {when:.0f} s of the run"
    if after.ratio < small:
        return f"{brief(before)}, but only before {when:.0f} s of the run"
    return f"{brief(before)}, which changes at {when:.0f} s of the run to {brief(after)}"


CHANGE_IN_TIME = Unnamed(
    titles={NAME: "a parameter of the sensor that changes during the run"}, find=find, is_cause=True
)
