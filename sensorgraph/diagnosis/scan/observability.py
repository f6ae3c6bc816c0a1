"""Report effects that a run could not have shown, and what would distinguish two effects.

    evidence(x) = min over n of  [ (x - n)' M (x - n) + |n / tau|² ] / 2

Here x is an effect of the scan channel, written as a shift of the nuisance parameters. M is the normal matrix
of the fit with the pose errors eliminated, and n are the nuisance parameters with their tolerances tau. The
evidence is the log Bayes factor that this run would contribute if the effect were present. For effects without
derivatives, the rays that would be lost or change their reading are counted instead; for missing returns, the evidence is the
expected log-likelihood ratio of the losses.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from sensorgraph.diagnosis.engine.verdict import OBSERVABLE_SIZE
from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.normal_equations import System, boxed
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.score_test import Hypothesis, hypotheses
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.worth import price
from sensorgraph.effects import EFFECTS, Amendment, Effect
from sensorgraph.effects.exposures import falls_short, listed
from sensorgraph.types import Bools, Floats


def not_observable(exposure: RunExposure) -> dict[str, str]:
    """Return the effects that a run could not have shown, each with the reason."""
    out = _hidden_by_poses(exposure.data)
    present = set(exposure.fitted.names())
    for found in (_told_by_effects(exposure), _smooth(exposure)):
        for name, why in found.items():
            if name not in present and name not in out:
                out[name] = why
    return {name: out[name] for name in EFFECTS if name in out}


def evidence_at_materiality(exposure: RunExposure) -> dict[str, float]:
    """Return the evidence [nats] that each smooth effect of the whole sensor would have at its materiality, after its price."""
    out = {}
    for hypothesis in exposure.hypotheses[0]:
        amendment, effect = hypothesis.amendment, hypothesis.amendment.effect
        if effect.sizes and not amendment.place:
            shifts = [hypothesis.directions @ (size / OBSERVABLE_SIZE) for size in _sizes(effect)]
            out[effect.name] = min(map(exposure.nats, shifts)) - price(amendment, exposure.data)
    return out


def _hidden_by_poses(data: ScanData) -> dict[str, str]:
    out: dict[str, str] = {}
    if data.laser_frame:
        why = "the poses are those of the laser, so they do not depend on the mount"
        out |= {name: why for name, effect in EFFECTS.items() if effect.stage == "mount"}
    if data.from_scans:
        why = "the poses were located with these scans and absorb it; it can be estimated from driving alone, with a minute of driving and turning"
        out |= {
            name: why for name, effect in EFFECTS.items() if not data.may_show(effect) and name not in out
        }
    elif data.laser_frame:
        why = "the poses were fitted to these scans and absorb it"
        out |= {
            name: why
            for name, effect in EFFECTS.items()
            if effect.diagnostics.hidden_by_slam and name not in out
        }
    return out


def _told_by_effects(exposure: RunExposure) -> dict[str, str]:
    """Query the effects that define their own condition of observability."""
    out = {}
    for name, effect in EFFECTS.items():
        if effect.diagnostics.unobservable is None:
            continue
        typical = effect.typical(OBSERVABLE_SIZE)
        why = effect.diagnostics.unobservable(exposure, typical, exposure.need_of(effect))
        if why:
            out[name] = why
    return out


def _sizes(effect: Effect) -> Floats:
    """Return shifts (m, k) of OBSERVABLE_SIZE materialities; four directions for a shift in the plane."""
    sizes = np.array([OBSERVABLE_SIZE * effect.sizes.get(name, 0.0) for name in effect.steps])
    if len(effect.sizes) == 2:
        angle = np.arange(4) * np.pi / 4
        return np.asarray(np.stack([np.cos(angle), np.sin(angle)], axis=1) * sizes)
    return np.asarray(sizes[None])


def _smooth(exposure: RunExposure) -> dict[str, str]:
    """Test effects in the span of the nuisance parameters, and effects with separate columns."""
    out: dict[str, str] = {}
    blind: dict[str, list[str]] = {}
    partly: dict[str, list[str]] = {}
    for hypothesis in exposure.hypotheses[0]:
        amendment, effect = hypothesis.amendment, hypothesis.amendment.effect
        if not effect.sizes or (amendment.place and effect.place is None):  # on one of several sensors
            continue
        need = exposure.need(amendment)
        nats = [exposure.nats(hypothesis.directions @ size) for size in _sizes(effect)]
        if min(nats) >= need:
            continue
        if amendment.place:
            group = blind if max(nats) < need else partly
            group.setdefault(effect.name, []).append(amendment.place)
            continue
        reason = _lacks(effect, exposure)
        if max(nats) >= need:
            angle = int(45 * int(np.argmin(nats)))
            reason = f"not along {angle}° (0° is forward): {reason}"
        out[effect.name] = (
            f"{reason}; at {OBSERVABLE_SIZE:g} times its materiality, {falls_short(min(nats), need)}"
        )
    for name, places in blind.items():
        out[name] = f"{listed(places)}: observed too rarely for {OBSERVABLE_SIZE:g} times its materiality"
    for name, places in partly.items():
        said = f"{listed(places)}: a shift across the line of sight would not show"
        out[name] = f"{out[name]}; {said}" if name in out else said
    return out


def _lacks(effect: Effect, exposure: RunExposure) -> str:
    """Return what the run lacks to show a smooth effect."""
    why = effect.diagnostics.why_unseen
    if callable(why):
        return why(exposure)
    return why or f"it varies with {effect.varies}"


def separation(a: Amendment, b: Amendment) -> str:
    """Return the observation that would distinguish two effects."""
    hint = a.effect.rivals.get(b.name) or b.effect.rivals.get(a.name)
    return (
        hint
        or f"{a.effect.title} varies with {a.effect.varies}; {b.effect.title} varies with {b.effect.varies}"
    )


class RunExposure:
    """Surfaces, ranges and angles that the rays of a run met (see `sensorgraph.effects.interfaces.Exposure`)."""

    def __init__(self, data: ScanData, fitted: Fitted) -> None:
        self.data, self.fitted = data, fitted
        self.solver = fitted.solver
        self.tau = self.solver.scaled(fitted.state)
        self.n = self.solver.n_g
        self.arena, self.sensor = data.arena, data.sensor
        self.twists, self.span = data.twists, data.span
        self.beams, expected = fitted.cast.beams, fitted.cast.expected
        self.reading = expected.reading
        with np.errstate(invalid="ignore"):
            self.seen = (expected.reading < data.sensor.range_max) & (expected.p_return > 0.5)
        self.seen &= ~np.isnan(data.ranges)
        self.valid = self.solver.jacobian.valid
        self.wall = self.beams.wall
        self.incidence = np.where(self.seen, np.nan_to_num(self.beams.incidence), 0.0)
        self.range = np.where(self.seen, self.reading, 0.0)
        self.n_seen = int(self.seen.sum())
        noise, bounds = fitted.state.noise, SCAN.noise
        self.core = bounds.core
        self.loss = max(bounds.loss[1], noise.loss)
        self.stray = max(bounds.stray[1], noise.stray)

    def need(self, amendment: Amendment) -> float:
        """Return the evidence [nats] that is required to name an effect."""
        return SCAN.selection.threshold + price(amendment, self.data)

    def need_of(self, effect: Effect) -> float:
        """Return the evidence [nats] that is required to name an effect with all its parameters."""
        return self.need(effect(**{p.name: 1.0 for p in effect.parameters}))

    @cached_property
    def hypotheses(self) -> tuple[list[Hypothesis], System]:
        """Smooth effects as directions among unknowns, and the normal equations of these."""
        return hypotheses(self.data, self.fitted)

    def nats(self, x: Floats) -> float:
        """Return the expected evidence [nats] if the truth differs by unknowns x (n,) from a model without them."""
        matrix, n = self.hypotheses[1].matrix, len(self.fitted.solution.system.right)
        right = matrix @ x
        return _missing(matrix[:n, :n], right[:n], float(x @ right), self.tau, self.solver.locked)

    def nats_of_columns(self, columns: Floats, size: float) -> list[float]:
        """Return the expected evidence [nats] of each of several smooth changes of the readings, with nuisances refitted.

        Parameters
        ----------
        columns : (n_scans, k, n_rays) Change of the readings per unit.
        size : Size of the change, in units.
        """
        n, weight = self.n, self.fitted.solution.responsibilities.weight
        solver = self.solver.with_columns(columns)
        matrix = solver.assemble(weight, self.fitted.state.pose_scale).matrix
        return [
            _missing(
                matrix[:n, :n], size * matrix[:n, k], float(size**2 * matrix[k, k]), self.tau, solver.locked
            )
            for k in range(len(matrix) - columns.shape[1], len(matrix))
        ]

    def lost(self, chance: Floats | float, some: Bools) -> float:
        """Return the expected evidence if rays `some` return with probability `chance`, with the loss refitted.

        It is the Kullback-Leibler divergence, with the probability q of a return and the refitted loss `taken`.

            Σ q log(q / (1 - taken)) + (1 - q) log((1 - q) / taken).
        """
        p = np.clip(np.broadcast_to(chance, some.shape)[some], 1e-6, 1.0)
        loss = self.fitted.state.noise.loss
        taken = min(self.loss, loss + float((1 - p).sum()) / max(self.n_seen, 1))
        q = np.clip(p * (1 - loss), 1e-9, 1 - 1e-9)
        gone = 1 - q
        gain = float((q * np.log(q / (1 - taken)) + gone * np.log(gone / taken)).sum())
        rest = self.n_seen - len(p)
        return gain + rest * float(
            loss * np.log(loss / taken) + (1 - loss) * np.log((1 - loss) / (1 - taken))
        )


def _missing(matrix: Floats, right: Floats, square: float, tau: Floats, held: Bools) -> float:
    """Return half of the squared length that bounded nuisances do not absorb."""
    x = boxed(matrix, right, tau, SCAN.nuisance.max_tolerances * tau, held).x
    taken = float(right @ x - 0.5 * x @ matrix @ x - 0.5 * np.sum((x[: len(tau)] / tau) ** 2))
    return max(0.5 * square - taken, 0.0)
