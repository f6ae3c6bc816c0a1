"""Search of the rough parameters of an effect, on which readings do not depend smoothly, along the likelihood."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize_scalar

from sensorgraph.diagnosis.scan.fit import Fitted, fit, log_likelihood
from sensorgraph.diagnosis.scan.nuisance import State
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.effects import Amendment


def searched(
    data: ScanData, got: Fitted, noise_bounds: NoiseBounds, *, rounds: int, first: float, turns: int
) -> Fitted:
    """Search the rough parameters of the last effect, then fit again."""
    for _ in range(turns):
        polished = polish(
            data, got.model, len(got.model) - 1, got.state, noise_bounds, rounds=rounds, first=first
        )
        better = fit(data, polished, got.state, noise_bounds)
        gained = better.j - got.j
        if gained > 0:
            got = better
        if gained < 2:
            break
    return got


def polish(
    data: ScanData,
    model: tuple[Amendment, ...],
    index: int,
    state: State,
    noise_bounds: NoiseBounds,
    *,
    rounds: int,
    first: float,
) -> tuple[Amendment, ...]:
    """Improve the rough parameters of one effect, with fixed nuisances.

    An effect that widens or mixes the readings has one parameter and is correlated with the noise, so the noise is
    estimated again at every value. The parameters of other effects are improved one after another by a pattern search.

    Parameters
    ----------
    rounds : Number of rounds over all parameters; more are made while a step still grows.
    first : Scale of the first steps.
    """
    amendment = model[index]
    steps = {k: first * step for k, step in amendment.search_steps.items()}
    if not steps:
        return model
    if amendment.effect.absorber:
        return _peaked(data, model, index, state, noise_bounds, factor=1 + 2 * first)
    current = [*model]
    best = log_likelihood(data, current, state)
    for turn in range(SCAN.fit.max_strides):
        if turn >= rounds and all(s <= first * amendment.search_steps[k] for k, s in steps.items()):
            break
        moved = False
        for name in steps:
            for sign in (1.0, -1.0):
                trial, value = [*current], current[index][name] + sign * steps[name]
                trial[index] = current[index].moved_within_bounds({name: value})
                got = log_likelihood(data, trial, state)
                if got > best + 1e-6:
                    best, current, moved = got, trial, True
                    steps[name] *= 1.5
                    break
            else:
                steps[name] *= 0.4
        if not moved and all(s < SCAN.fit.settled_step * amendment.search_steps[k] for k, s in steps.items()):
            break
    return tuple(current)


def _peaked(
    data: ScanData,
    model: tuple[Amendment, ...],
    index: int,
    state: State,
    noise_bounds: NoiseBounds,
    *,
    factor: float,
) -> tuple[Amendment, ...]:
    """Move the single rough parameter of an effect to its most likely value, by a factor of at most `factor`."""
    (name,) = model[index].search_steps
    start = model[index][name]

    def at(u: float) -> tuple[Amendment, ...]:
        value = start * float(np.exp(u))
        return (*model[:index], model[index].moved_within_bounds({name: value}), *model[index + 1 :])

    reach = float(np.log(factor))
    found = minimize_scalar(
        lambda u: -log_likelihood(data, at(u), state, noise_bounds),
        bounds=(-reach, reach),
        method="bounded",
        options={"xatol": SCAN.fit.profile_tolerance},
    )
    return at(float(found.x))
