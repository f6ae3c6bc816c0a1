"""The chance of one reading, term by term, compiled; `likelihood.plain_judge` says the same in numpy."""

from __future__ import annotations

import math

import numpy as np

from planners.kernel import kernel
from sensorgraph.types import Floats

ROOT2, ROOT_TAU = math.sqrt(2.0), math.sqrt(2 * math.pi)
LOG_P, WEIGHT, RESIDUAL, CORE, TAIL, LOST, STRAY = range(7)


@kernel
def _below(x: float) -> float:
    """Return the standard normal's integral up to x."""
    return 0.5 * math.erfc(-x / ROOT2)


@kernel
def mixture(
    z: Floats,
    mu: Floats,
    sigma: Floats,
    p_return: Floats,
    alternative: Floats,
    p_alternative: Floats,
    limits: tuple[float, float, float],
    noise: tuple[float, float, float, float],
    often: tuple[float, float],
    lattice: float,
    wide: float,
    floor: float,
) -> Floats:
    """Judge n readings.

    Parameters
    ----------
    z : (n,) [m] measured; inf lost, -inf too near, nan broken
    mu : (n,) [m] expected; inf where nothing can be seen
    sigma : (n,) [m] of the core
    p_return : (n,) chance that the ray returns at all
    alternative, p_alternative : (n,) [m] on the other side of an edge, nan for none, and the chance of being there
    limits : [m] least and largest range, cell of a reading
    noise : share of the tail, of lost, of stray readings, and stray ones that an effect adds
    often : chance of a short reading and of one that is lost beside an edge
    lattice : [m] step that effects put readings on; 0 none
    wide : tail's sigma over the core's
    floor : chance of a reading that nothing explains

    Returns
    -------
    (7, n) LOG_P [nats], WEIGHT [1/m²], RESIDUAL [m], and the chances CORE, TAIL, LOST and STRAY
    """
    nearest, farthest, cell = limits
    share, loss, stray_noise, stray_effect = noise
    short, lost_at_edge = often
    stray = 1 - (1 - stray_effect) * (1 - stray_noise)
    rest = (1 - stray) * (1 - short)
    p_stray = stray / farthest
    out = np.zeros((7, len(z)))
    for k in range(len(z)):
        reading, expected, s = z[k], mu[k], sigma[k]
        aimed, returned = math.isfinite(expected), math.isfinite(reading)
        if math.isnan(reading):
            continue
        inside = _below((farthest - expected) / s) if aimed else 0.0
        p_core = p_tail = 0.0
        edge = p_alternative[k] > 0
        if returned:
            p = 0.0
            p_back = p_return[k] * (1 - loss) * inside
            if aimed:
                e = reading - expected
                out[RESIDUAL, k] = e
                own = rest * p_back * (1 - p_alternative[k])
                if lattice > 0:
                    steps = reading / lattice
                    if abs(steps - np.round(steps)) * lattice > 0.51 * cell + 1e-9:
                        own = 1e-9
                    half = lattice / 2
                    t = wide * s
                    core = (_below((e + half) / s) - _below((e - half) / s)) / cell
                    tail = (_below((e + half) / t) - _below((e - half) / t)) / cell
                else:
                    u = e / s
                    core = math.exp(-0.5 * u * u) / (ROOT_TAU * s)
                    u /= wide
                    tail = math.exp(-0.5 * u * u) / (ROOT_TAU * s * wide)
                p_core, p_tail = own * (1 - share) * core, own * share * tail
                p = p_core + p_tail
            there = alternative[k]
            if edge and math.isfinite(there):
                u = (reading - there) / (2 * s)
                near = math.exp(-0.5 * u * u) / (2 * ROOT_TAU * s)
                low, high = min(there, expected), max(there, expected)
                flat = 1 / max(high - low, 0.01) if low < reading < high else 0.0
                p += rest * p_back * p_alternative[k] * (0.9 * near + 0.1 * flat)
            if short > 0:
                top = min(expected, farthest) if aimed else farthest
                if reading < top:
                    p += (1 - stray) * short / max(top, 0.05)
            total = p + p_stray + floor / farthest
            out[CORE, k], out[TAIL, k], out[STRAY, k] = p_core / total, p_tail / total, p_stray / total
            out[WEIGHT, k] = (out[CORE, k] + out[TAIL, k] / (wide * wide)) / (s * s)
        else:
            seen = p_return[k] * inside if aimed else 0.0
            gone = rest * (1 - seen)
            if reading > 0:
                p_lost = (1 - stray) * seen * loss
                p_gone = p_lost + gone + (lost_at_edge if edge else 0.0)
                total = p_gone * (1 - short) + floor
                out[LOST, k] = p_lost / total
            else:
                too_near = _below((nearest - expected) / s) if aimed else 0.0
                total = rest * too_near + 0.5 * gone + floor
        out[LOG_P, k] = math.log(total)
    return out
