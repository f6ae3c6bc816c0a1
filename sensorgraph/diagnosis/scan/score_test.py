"""Predict the gain of every smooth effect without fitting it: the score test (Rao 1948).

    gain = max over x, s of  q(x, x + D s)  -  max over x of  q(x, x)
    q(x, m) = right' m - m' matrix m / 2 - |g / tau|² / 2,   |g| <= max_tolerances tau

Here `matrix` and `right` are the normal equations of the fit without the effect, with the pose errors
eliminated. The first of the unknowns x are the nuisance parameters g, with tolerances tau. D are the directions
of an effect among them, and s is its size.

Every effect that shifts readings smoothly lies in the span of the nuisance columns. A moved wall, a moved
obstacle and a scaled map shift corners together; a bias, a scale and a mount each have a tolerance-sized
copy. One assembled system therefore predicts the gain of each effect, with no prior on the effect and the
nuisances refitted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensorgraph.diagnosis.scan.fit import Fitted, columns_of, slopes
from sensorgraph.diagnosis.scan.normal_equations import BorderedProblem, System, limits, with_prior
from sensorgraph.diagnosis.scan.nuisance import as_cast, corners_of, effects_with_nuisances
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.effects import EFFECTS, Amendment, Effect
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.types import Bools, Floats
from sensorgraph.world.sensor_parts import part_names, sensor_of_rays

MAP_PLACES = ("wall", "obstacle", None, "spot", "sector")
"""Order in which effects of the map are tested; the first of equal ones counts."""


STAGES_OF_ONE_SENSOR = ("mount", "range")
"""Stages of the effects that may apply to one of several sensors."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """An effect to be fitted, with its expected gain."""

    amendment: Amendment
    gain: float
    """[nats] Expected gain over the fit without it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Hypothesis:
    """An effect at zero, as directions among the unknowns of a fit."""

    amendment: Amendment
    directions: Floats
    """(n, k) Change of the unknowns per unit of each smooth parameter of the effect."""
    nuisances: tuple[Nuisance, ...] = ()
    """Tolerance-sized copies of the effect, held at 0 during the test."""


def smooth_candidates(data: ScanData, fitted: Fitted) -> list[Candidate]:
    """Return every smooth effect with its start values and expected gain, best first."""
    solver, tau = fitted.solver, fitted.solver.scaled(fitted.state)
    found, system = hypotheses(as_cast(data, fitted.state), fitted)
    n_fitted = len(fitted.solution.system.right)

    def problem(locked: Bools) -> BorderedProblem:
        limit = limits(len(system.right), SCAN.nuisance.max_tolerances * tau, locked)
        limit[n_fitted:] = 0.0  # the columns of hypotheses
        return BorderedProblem(with_prior(system.matrix, tau), system.right, -limit, limit)

    plain, out = problem(solver.locked), []
    here = plain.optimum.x
    reference = _quadratic(system, tau, here, here)
    for hypothesis in found:
        amendment, asked = hypothesis.amendment, plain
        if hypothesis.nuisances:
            locked = solver.locked.copy()
            locked[list(hypothesis.nuisances)] = True
            asked = problem(locked)
        value, size = _along(system, tau, asked, hypothesis.directions)
        names = amendment.effect.steps
        moved = {k: amendment.parameters.get(k, 0.0) + float(v) for k, v in zip(names, size, strict=True)}
        out.append(Candidate(amendment=amendment.moved_to(moved), gain=value - reference))
    return sorted(out, key=lambda c: -c.gain)


def hypotheses(data: ScanData, fitted: Fitted) -> tuple[list[Hypothesis], System]:
    """Return the smooth effects that the model lacks, and the normal equations of the fit with their columns.

    Most lie in the span of the nuisances. The others add columns of their own, after the unknowns of the fit: effects whose
    derivatives are not among the nuisances and, of several sensors, bias, scale and mount of each.
    """
    system, present = fitted.solution.system, {(a.name, a.place) for a in fitted.model}
    own = [
        (effect.at_neutral(), columns_of(data, fitted, effect.at_neutral()))
        for effect in EFFECTS.values()
        if effect.has_own_columns and effect.name not in fitted.names()
    ]
    own += _of_one_sensor(data, fitted)
    n_fitted = len(system.right)
    if own:
        wide = fitted.solver.with_columns(np.concatenate([columns for _, columns in own], axis=1))
        system = wide.assemble(fitted.solution.responsibilities.weight, fitted.state.pose_scale)
    units = np.eye(len(system.right))
    out = []
    for effect in effects_with_nuisances():
        copies = effect.nuisances
        if (effect.name, "") in present or fitted.solver.locked[list(copies)].all():
            continue
        at_zero = effect(**dict.fromkeys(effect.steps, 0.0))
        out.append(Hypothesis(amendment=at_zero, directions=units[:, list(copies)], nuisances=copies))
    out += _of_the_map(data, fitted, units[:, len(Nuisance) : fitted.solver.n_g])
    for at, columns in own:
        out.append(Hypothesis(amendment=at, directions=units[:, n_fitted : n_fitted + columns.shape[1]]))
        n_fitted += columns.shape[1]
    return out, system


def _of_one_sensor(data: ScanData, fitted: Fitted) -> list[tuple[Amendment, Floats]]:
    """Return bias, scale and mount of each of several sensors, each with its columns (n_scans, k, n_rays)."""
    if not data.sensor.is_composite:
        return []
    owner = sensor_of_rays(data.sensor)
    present = {(a.name, a.place) for a in fitted.model}
    out = []
    for effect in effects_with_nuisances():
        if effect.stage not in STAGES_OF_ONE_SENSOR:
            continue
        by_parameter = _columns_of_sensors(data, fitted, effect)  # (k, n_scans, n_rays)
        for number, name in enumerate(part_names(data.sensor)):
            at = effect(**{**dict.fromkeys(effect.steps, 0.0), **effect.at_neutral().parameters}).at(name)
            if (at.name, at.place) not in present:
                out.append((at, np.where(owner == number, by_parameter, 0.0).transpose(1, 0, 2)))
    return out


def _columns_of_sensors(data: ScanData, fitted: Fitted, effect: Effect) -> Floats:
    """Differentiate the readings of a fit by an effect on each of several sensors, (k, n_scans, n_rays).

    The columns of a ray belong to the effect on its own sensor.
    """
    places = part_names(data.sensor)
    out, at = [], fitted.cast
    for name, step in effect.steps.items():
        values = {**dict.fromkeys(effect.steps, 0.0), **effect.at_neutral().parameters, name: step}
        beams = data.scene().run(
            (*data.known, *fitted.model, *(effect(**values).at(place) for place in places))
        )
        out.append(slopes(beams, at, step, effect.parameter(name).jump))
    return np.stack(out)


def _of_the_map(data: ScanData, fitted: Fitted, of_corners: Floats) -> list[Hypothesis]:
    """Return effects of the map geometry as shifts of its corners: walls first, then obstacles, then the whole map.

    Parameters
    ----------
    of_corners : (n, 2 n_unknowns) Unit vectors of the corners and obstacles among the unknowns.
    """
    corners = corners_of(data)
    if corners.count == 0:
        return []
    present = {(a.name, a.place) for a in fitted.model}
    changed = {a.place for a in fitted.model if a.effect.place == "obstacle"}
    length = np.hypot(*np.diff(data.arena.walls, axis=1)[:, 0].T)
    is_short = length < 2 * SCAN.naming.min_wall_pixels * data.grain  # each further wall costs one solution
    short = {name for name, few in zip(data.arena.names, is_short, strict=True) if few}
    out = []
    for effect in sorted(EFFECTS.values(), key=lambda e: MAP_PLACES.index(e.place)):
        if effect.diagnostics.corner_shifts is None:
            continue
        for found in effect.diagnostics.corner_shifts(data.arena, fitted.cast.scene.walls, corners.ends):
            if (effect.name, found.place) in present or found.place in changed:
                continue
            if effect.place == "wall" and found.place in short:
                continue
            if found.place and corners.rest >= 0 and found.shift[corners.rest].any():
                continue  # few rays meet it, and it has no unknown
            directions = of_corners @ corners.unknowns(found.shift.reshape(2 * corners.count, -1))
            at_zero = effect(**dict.fromkeys(effect.steps, 0.0))
            if found.place:
                at_zero = at_zero.at(found.place, found.xy)
            out.append(Hypothesis(amendment=at_zero, directions=directions))
    return out


def _along(system: System, tau: Floats, problem: BorderedProblem, directions: Floats) -> tuple[float, Floats]:
    """Return the maximum of q(x, x + D s) and the size s, for directions D (n, k) without a prior on s."""
    across = system.matrix @ directions
    corner = directions.T @ across
    corner[np.diag_indices(len(corner))] += 1e-9 + 1e-9 * np.diag(corner)
    x = problem.with_border(across, corner, directions.T @ system.right)
    own, size = np.split(x, [len(across)])
    return _quadratic(system, tau, own, own + directions @ size), size


def _quadratic(system: System, tau: Floats, x: Floats, moved: Floats) -> float:
    """Return q(x, moved) [nats]: the gain of shifts `moved` (n,), minus the prior term of the nuisances in x (n,)."""
    gain = system.right @ moved - 0.5 * moved @ system.matrix @ moved
    return float(gain - 0.5 * np.sum((x[: len(tau)] / tau) ** 2))
