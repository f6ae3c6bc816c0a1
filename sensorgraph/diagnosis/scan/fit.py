"""Fit a set of effects to the scans: cast, differentiate, solve, and cast again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sensorgraph.diagnosis.scan.corner_sums import Corners
from sensorgraph.diagnosis.scan.depth_edges import Edges, find_edges
from sensorgraph.diagnosis.scan.gauss_newton import (
    Solution,
    Solver,
    iterate,
)
from sensorgraph.diagnosis.scan.jacobian import Jacobian, bent_columns, linearise
from sensorgraph.diagnosis.scan.likelihood import (
    ExpectedReadings,
    e_step,
    expected_readings,
    fitted_noise,
)
from sensorgraph.diagnosis.scan.nuisance import (
    State,
    as_cast,
    as_pose_errors,
    corners_of,
    for_model,
    is_cast_at,
    pose_like,
)
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.effects import Amendment
from sensorgraph.effects.nuisance import MOUNT, POSE_LIKE, Nuisance
from sensorgraph.models.cones.settings import measures_cones
from sensorgraph.types import Bools, Floats
from sensorgraph.world.beams import Beams
from sensorgraph.world.cast_memory import MAX_BEAMS, Recent
from sensorgraph.world.scene import Scene


@dataclass(frozen=True, kw_only=True, eq=False)
class Cast:
    """The simulator's output with some effects, and its derivatives."""

    scene: Scene
    beams: Beams
    jacobian: Jacobian
    expected: ExpectedReadings
    edges: Edges | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Fitted:
    """A fitted set of effects, with nuisances."""

    model: tuple[Amendment, ...]
    solution: Solution
    cast: Cast
    solver: Solver

    @property
    def j(self) -> float:
        """[nats] penalised log-likelihood."""
        return self.solution.j

    @property
    def state(self) -> State:
        """Nuisances."""
        return self.solution.state

    def names(self) -> tuple[str, ...]:
        """Return the effects' names."""
        return tuple(a.name for a in self.model)


def cast(data: ScanData, model: Sequence[Amendment]) -> Cast:
    """Run the simulator at the poses of the data."""
    scene = data.scene()
    beams = scene.run((*data.known, *model))
    jacobian = linearise(data, beams, scene.walls, scene.mount, bent_columns(data, model, beams))
    is_wide = measures_cones(data.sensor) or any(a.effect.diagnostics.wide_beam for a in model)
    edges = None if is_wide else _edges(data, scene)
    expected = expected_readings(beams, jacobian.steep, edges, scene.outliers, scene.shorts, scene.lattice)
    return Cast(scene=scene, beams=beams, jacobian=jacobian, expected=expected, edges=edges)


def _edges(data: ScanData, scene: Scene) -> Edges | None:
    """Find the edges of the bare cast; the result is kept as long as geometry and timing are unchanged."""
    parts = (scene.walls, scene.mount, scene.delay, scene.discs, np.array(scene.dip))
    key = b"|".join(part.tobytes() for part in parts)
    edges: Recent[Edges | None] = data.kept(b"edges", lambda: Recent(MAX_BEAMS))
    return edges.get(key, lambda: find_edges(data, bare_cast(scene), scene.walls))


def bare_cast(scene: Scene) -> Beams:
    """Cast without the effects of surfaces on rays."""
    kept, scene.surfaces = scene.surfaces, []
    try:
        return scene.shoot()
    finally:
        scene.surfaces = kept


def start_state(data: ScanData, noise_bounds: NoiseBounds) -> State:
    """Return nuisances at zero, and the poses at which the casts are made."""
    corners = corners_of(data)
    state = State(g=np.zeros(len(Nuisance) + 2 * corners.n_unknowns), delta=data.pose_start)
    state.noise = state.noise.within(noise_bounds)
    return state


def locked(data: ScanData, model: Sequence[Amendment], corners: Corners) -> Bools:
    """Return which nuisances are held at 0: those of effects in the model, the mount of a bare laser, fixed corners."""
    out = np.zeros(len(Nuisance) + 2 * corners.n_unknowns, dtype=np.bool_)
    whole = [a for a in model if a.effect.place is not None or not a.place]  # not on one of several sensors
    held = [nuisance for a in whole for nuisance in a.effect.nuisances]
    if data.laser_frame or data.from_scans:
        held += MOUNT
    out[held] = True
    if corners.rest >= 0:
        out[len(Nuisance) + 2 * corners.rest :][:2] = True
    return out


def columns_of(data: ScanData, fitted: Fitted, amendment: Amendment) -> Floats:
    """Differentiate the readings of a fit by an additional effect at zero strength, (n_scans, k, n_rays)."""
    model = (*fitted.model, amendment)
    data = as_cast(data, fitted.state)
    return np.stack(_difference_quotients(data, model, len(model) - 1, fitted.cast), axis=1)


def slopes(beams: Beams, at: Cast, step: float, jump: float) -> Floats:
    """Return the derivative of the readings (n_scans, n_rays) by a parameter; 0 where a reading jumps."""
    with np.errstate(invalid="ignore"):
        slope = (beams.reading - at.beams.reading) / step
    same = (beams.wall == at.beams.wall) & at.jacobian.valid & np.isfinite(slope) & (np.abs(slope) < jump)
    return np.where(same, slope, 0.0)


def _difference_quotients(data: ScanData, model: Sequence[Amendment], index: int, at: Cast) -> list[Floats]:
    """Differentiate the readings by the smooth parameters of one effect of a model; 0 where a reading jumps.

    Where casts are made at likely poses, mount and delay use the derivatives of the pose errors, also at edges. A joint fit
    then moves along their common direction in a single step.
    """
    amendment, out = model[index], []
    for name, step in amendment.steps.items():
        nuisance = amendment.effect.parameter(name).nuisance
        if data.posed is not None and nuisance in POSE_LIKE and not amendment.place:
            out.append(at.jacobian.nuisances[:, nuisance])
            continue
        moved = [*model]
        moved[index] = amendment.moved_to({name: amendment.parameters.get(name, 0.0) + step})
        scene = data.scene()
        beams = scene.run((*data.known, *moved))
        out.append(slopes(beams, at, step, amendment.effect.parameter(name).jump))
    return out


def solver_for(data: ScanData, model: Sequence[Amendment]) -> tuple[Solver, Cast]:
    """Cast the scene, and differentiate by the effects' smooth parameters."""
    solver, at = solver_of_nuisances(data, model)
    quotients = [q for index in range(len(model)) for q in _difference_quotients(data, model, index, at)]
    return (solver.with_columns(np.stack(quotients, axis=1)) if quotients else solver), at


def solver_of_nuisances(data: ScanData, model: Sequence[Amendment]) -> tuple[Solver, Cast]:
    """Cast the scene; the effects have no columns."""
    at, corners = cast(data, model), corners_of(data)
    none, held = np.zeros((data.n_scans, 0, data.n_rays)), locked(data, model, corners)
    return Solver(data, at.expected, at.jacobian, at.scene.walls, none, corners, held), at


def with_increments(model: Sequence[Amendment], p: Floats) -> tuple[Amendment, ...]:
    """Return a model with increments added to its smooth parameters."""
    out, k = [], 0
    for amendment in model:
        values = {}
        for name in amendment.steps:
            values[name] = amendment.parameters.get(name, 0.0) + float(p[k])
            k += 1
        out.append(amendment.moved_within_bounds(values) if values else amendment)
    return tuple(out)


def fit(
    data: ScanData,
    model: Sequence[Amendment],
    state: State,
    noise_bounds: NoiseBounds,
) -> Fitted:
    """Fit the smooth parameters, nuisances and noise; cast again until the objective no longer increases."""
    best: Fitted | None = None
    model = tuple(model)
    noise_bounds, state = strays_taken(model, noise_bounds), for_model(data, state.copy(), model)
    state.noise = state.noise.within(noise_bounds)
    corners = corners_of(data)
    held_at_0 = locked(data, model, corners)
    # the laser keeps its place: the poses absorb the errors of mount and delay
    state.delta = state.delta + as_pose_errors(data, np.where(held_at_0, state.g, 0.0)[list(POSE_LIKE)])
    state.g[held_at_0] = 0.0
    is_laid, is_cast = data.grain > 0, False
    for _ in range(SCAN.fit.casts):
        if not is_cast:
            laid = as_cast(data, state)  # so that the fit of another effect starts at the same cast
            solver, at = solver_for(laid, model)
            p = np.zeros(solver.n_effects)
        solution = iterate(solver, state, p, noise_bounds)
        solution.state.laid, solution.state.posed = laid.laid, laid.posed
        got = Fitted(model=model, solution=solution, cast=at, solver=solver)
        better = best is None or got.j > best.j + SCAN.fit.min_gain
        if best is None or got.j > best.j:
            best = got
        if (solver.n_effects == 0 and not is_laid and laid.posed is None) or not better:
            break
        state = replace(solution.state, laid=None, posed=None)
        is_cast = _settled(solution) and is_cast_at(laid, state)
        if is_cast and solution.has_converged:
            break
        if is_cast:  # the noise converges more slowly than the effects
            p = solution.p
        else:
            model = with_increments(model, solution.p)
    assert best is not None
    final = with_increments(best.model, best.solution.p)
    state = best.solution.state
    state.effects = pose_like(final)
    if state.posed is not None:  # the laser stays where it was cast from, although effects have moved it
        state.posed = state.posed - as_pose_errors(data, state.effects - pose_like(best.model))
    return Fitted(model=final, solution=best.solution, cast=best.cast, solver=best.solver)


def bare_fit(data: ScanData, noise_bounds: NoiseBounds) -> Fitted:
    """Return the fit without effects from the prior; it is made once for the same data and bounds."""
    key = f"bare fit|{noise_bounds!r}".encode()
    return data.kept(key, lambda: fit(data, (), start_state(data, noise_bounds), noise_bounds))


def _settled(solution: Solution) -> bool:
    """Return whether the last step was much smaller than the standard errors."""
    sd = np.sqrt(np.maximum(np.diag(solution.covariance), 1e-18))
    return bool((np.abs(solution.p) < SCAN.fit.settled_step * sd).all())


def log_p_at(
    data: ScanData, model: Sequence[Amendment], state: State, noise_bounds: NoiseBounds | None = None
) -> Floats:
    """Return the log-likelihood of every reading (n_scans, n_rays) [nats] at given nuisances; one cast, no solve.

    Parameters
    ----------
    noise_bounds : Bounds within which the noise is estimated again; None keeps the noise.
    """
    data = as_cast(data, state)
    solver, at = solver_of_nuisances(data, model)
    shift, noise = solver.shift(state, np.zeros(0)), state.noise
    responsibilities = e_step(data, at.expected, shift, noise)
    if noise_bounds is not None:
        noise_bounds = strays_taken(model, noise_bounds)
        for _ in range(SCAN.fit.rounds):
            noise = fitted_noise(data, at.expected, responsibilities, noise_bounds)
            responsibilities = e_step(data, at.expected, shift, noise)
    return responsibilities.log_p


def log_likelihood(
    data: ScanData, model: Sequence[Amendment], state: State, noise_bounds: NoiseBounds | None = None
) -> float:
    """Return the log-likelihood of a model [nats]; see `log_p_at`."""
    return float(log_p_at(data, model, state, noise_bounds).sum())


def strays_taken(model: Sequence[Amendment], noise_bounds: NoiseBounds) -> NoiseBounds:
    """Set the noise's share of outliers to its minimum if `random_outliers` is in the model, which explains all of them."""
    if not any(a.effect.diagnostics.explains == "strays" for a in model):
        return noise_bounds
    low = noise_bounds.stray[0]
    return replace(noise_bounds, stray=(low, low))


def thin(data: ScanData, every: int) -> ScanData:
    """Return every n-th scan; repeated calls return the same object, which keeps its casts."""
    if every == 1:
        return data
    return data.kept(b"every %d" % every, lambda: data.subset(np.arange(0, data.n_scans, every)))


def thin_state(state: State, every: int) -> State:
    """Return the state of every n-th scan."""
    posed = None if state.posed is None else state.posed[::every]
    return replace(
        state, g=state.g.copy(), delta=state.delta[::every].copy(), posed=posed, noise=replace(state.noise)
    )
