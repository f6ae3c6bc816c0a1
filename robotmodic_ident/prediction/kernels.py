"""Compiled loops that run a model sample by sample: ŷ = Σ numerator / (1 + Σ denominator) + Σ noise.

Each term is theta_j * base_j(k) * Π factor(past or noise at k - lag). A model with feedback cannot be evaluated column
by column, because each sample depends on earlier ones. The factors of inputs are evaluated beforehand with numpy
(`base`); a table lists the factors of past outputs and of noise.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from robotmodic_ident.kernel import inner_kernel, kernel
from robotmodic_ident.moments import MAX_OUTPUT
from robotmodic_ident.types import Floats, Ints

KIND_POWER, KIND_COS, KIND_SIN, KIND_LEGENDRE, KIND_CHEBYSHEV, KIND_SPLINE, KIND_WAVELET = range(7)
KIND_ABS, KIND_TANH = 7, 8
"""Kinds of factors."""
COL_LAG, COL_OF_NOISE, COL_KIND, COL_HARMONIC, COL_FIRST, COL_SECOND, COL_EXPONENT, COL_MINUS = range(8)
"""Columns of the integer table of factors."""
N_COLUMNS = COL_MINUS + 1
GROUP_NUMERATOR, GROUP_DENOMINATOR, GROUP_NOISE = range(3)
"""Part of the model that contains a term: ŷ = Σ numerator / (1 + Σ denominator) + Σ noise."""


class ModelTable(NamedTuple):
    """A model over some samples, as the kernels take it."""

    base: Floats
    """(n, n_terms) product of the input factors of each term."""
    theta: Floats
    """(n_terms,) coefficients."""
    group: Ints
    """(n_terms,) numerator, denominator or noise."""
    starts: Ints
    """(n_terms + 1,) first row of each term in `table`."""
    table: Ints
    """(n_factors, N_COLUMNS) integers that describe each factor of past outputs or noise."""
    scales: Floats
    """(n_factors, 2) centre and width."""
    limits: Floats
    """(2,) saturation limits of the output."""
    look_back: int
    """Number of samples at the start that are known."""


@inner_kernel
def spline(degree: int, index: int, count: int, t: float) -> float:
    """Evaluate B-spline `index` of `count` on uniform knots over [-1, 1]; 0 outside, nan of nan.

    With knots at integers i, B_i,p(x) = ((x - i) B_i,p-1(x) + (i + p + 1 - x) B_i+1,p-1(x)) / p (de Boor 1978).
    """
    if math.isnan(t):  # the whole part of nan is no index
        return t
    x = (t + 1.0) / 2.0 * (count - degree) - index + degree  # knots at 0, 1, ..., degree + 1
    if t < -1.0 or t > 1.0 or x < 0.0 or x > degree + 1:
        return 0.0
    values = np.zeros(degree + 1)
    cell = min(int(x), degree)
    values[cell] = 1.0
    for p in range(1, degree + 1):
        for i in range(degree + 1 - p):
            values[i] = ((x - i) * values[i] + (i + p + 1 - x) * values[i + 1]) / p
    return float(values[0])


@kernel
def shape(kind: int, harmonic: int, first: int, second: int, t: float) -> float:
    """Evaluate one function of one (scaled) variable."""
    if kind == KIND_COS:
        return math.cos(harmonic * t)
    if kind == KIND_SIN:
        return math.sin(harmonic * t)
    if kind in (KIND_LEGENDRE, KIND_CHEBYSHEV):
        before, value = 1.0, t
        for n in range(1, harmonic):
            ahead = 2.0 * t * value - before
            if kind == KIND_LEGENDRE:
                ahead = ((2 * n + 1) * t * value - n * before) / (n + 1)
            before, value = value, ahead
        return value
    if kind == KIND_SPLINE:
        return spline(harmonic, first, second, t)
    if kind == KIND_WAVELET:
        r = 2.0**harmonic * (t + 1.0) / 2.0 - first
        return (1.0 - r * r) * math.exp(-0.5 * r * r)
    if kind == KIND_ABS:
        return abs(t)
    if kind == KIND_TANH:
        return math.tanh(t)
    return t


@kernel
def slope(kind: int, harmonic: int, first: int, second: int, t: float) -> float:
    """Differentiate `shape` by t."""
    if kind == KIND_COS:
        return -harmonic * math.sin(harmonic * t)
    if kind == KIND_SIN:
        return harmonic * math.cos(harmonic * t)
    if kind == KIND_LEGENDRE:  # P'(n+1) = P'(n-1) + (2n+1) P(n)
        before, value, d_before, d_value = 1.0, t, 0.0, 1.0
        for n in range(1, harmonic):
            ahead = ((2 * n + 1) * t * value - n * before) / (n + 1)
            d_ahead = d_before + (2 * n + 1) * value
            before, value, d_before, d_value = value, ahead, d_value, d_ahead
        return d_value
    if kind == KIND_CHEBYSHEV:  # T'(n) = n U(n-1)
        before, value = 0.0, 1.0
        for _ in range(1, harmonic):
            before, value = value, 2.0 * t * value - before
        return harmonic * value
    if kind == KIND_SPLINE:
        if harmonic == 0:
            return 0.0
        low = spline(harmonic - 1, first - 1, second - 1, t) if first > 0 else 0.0
        high = spline(harmonic - 1, first, second - 1, t) if first < second - 1 else 0.0
        return (low - high) * (second - harmonic) / 2.0
    if kind == KIND_WAVELET:
        r = 2.0**harmonic * (t + 1.0) / 2.0 - first
        return (r * r - 3.0) * r * math.exp(-0.5 * r * r) * 2.0**harmonic / 2.0
    if kind == KIND_ABS:
        return math.copysign(1.0, t)
    if kind == KIND_TANH:
        return 1.0 - math.tanh(t) ** 2
    return 1.0


@inner_kernel
def argument(row: Ints, source: Floats, k: int) -> float:
    """Return the argument of a factor at sample k: a value, or the difference of two values."""
    if row[COL_MINUS]:
        return float(source[k - row[COL_LAG]] - source[k - row[COL_MINUS]])
    return float(source[k - row[COL_LAG]])


@inner_kernel
def factor(row: Ints, centre: float, width: float, v: float) -> float:
    """Evaluate one factor of a term at the value of its signal."""
    value = shape(row[COL_KIND], row[COL_HARMONIC], row[COL_FIRST], row[COL_SECOND], (v - centre) / width)
    out = value
    for _ in range(1, row[COL_EXPONENT]):
        out *= value
    return out


@inner_kernel
def factor_slope(row: Ints, centre: float, width: float, v: float) -> float:
    """Differentiate one factor by the value of its signal."""
    t = (v - centre) / width
    out = (
        row[COL_EXPONENT]
        * slope(row[COL_KIND], row[COL_HARMONIC], row[COL_FIRST], row[COL_SECOND], t)
        / width
    )
    if row[COL_EXPONENT] > 1:
        value = shape(row[COL_KIND], row[COL_HARMONIC], row[COL_FIRST], row[COL_SECOND], t)
        for _ in range(1, row[COL_EXPONENT]):
            out *= value
    return float(out)


@inner_kernel
def value_at(k: int, model: ModelTable, past: Floats, noise: Floats, phi: Floats) -> tuple[float, float]:
    """Return (prediction, denominator) at sample k and fill phi (n_terms,), the value of each term."""
    base, theta, group, starts, table, scales, _, _ = model
    top, bottom, noise_part = 0.0, 1.0, 0.0
    for j in range(len(theta)):
        v = base[k, j]
        for i in range(starts[j], starts[j + 1]):
            source = noise if table[i, COL_OF_NOISE] else past
            v *= factor(table[i], scales[i, 0], scales[i, 1], argument(table[i], source, k))
        phi[j] = v
        if group[j] == GROUP_NUMERATOR:
            top += theta[j] * v
        elif group[j] == GROUP_DENOMINATOR:
            bottom += theta[j] * v
        else:
            noise_part += theta[j] * v
    return top / bottom + noise_part, bottom


@kernel
def run(
    model: ModelTable,
    measured: Floats,
    free: bool,
    out: Floats,
    past: Floats,
    noise: Floats,
    gradient: Floats,
) -> bool:
    """Run a model over one segment, or over a block of it that starts `look_back` samples earlier.

    Returns False if the run diverges, otherwise True.

    Parameters
    ----------
    measured : (n,) Measured outputs; nan: unknown.
    free : Whether past outputs are predictions and noise is zero; otherwise, past outputs are measured.
    out : (n,) Filled with the prediction from sample `look_back`; unchanged where it is unknown.
    past : (n,) Past outputs; filled with the prediction in free run.
    noise : (n,) Filled with the residual unless in free run; unchanged where it is unknown.
    gradient : (n, n_terms or more) Filled with dŷ/dtheta; (0, 0): not computed.
        Further columns are initial conditions, whose given first rows are propagated.
    """
    limits, look_back, (n, m) = model.limits, model.look_back, model.base.shape
    phi, by_lag = np.zeros(m), np.zeros(look_back + 1)
    wanted = len(gradient) > 0
    for k in range(look_back, n):
        value, bottom = value_at(k, model, past, noise, phi)
        held = value < limits[0] or value > limits[1]
        value = min(max(value, limits[0]), limits[1]) if held else value
        if not math.isfinite(value):
            continue
        if abs(value) > MAX_OUTPUT:
            return False
        out[k] = value
        if free:
            past[k] = value
        elif math.isfinite(measured[k]):
            noise[k] = measured[k] - value
        if wanted and not held:
            fill_gradient(k, model, past, noise, phi, bottom, free, by_lag, gradient)
    return True


@inner_kernel
def add_earlier(k: int, by_lag: Floats, gradient: Floats) -> None:
    """Add Σ_lag by_lag[lag] * gradient[k - lag] to gradient[k], and reset by_lag to zeros."""
    for lag in range(1, len(by_lag)):
        weight = by_lag[lag]
        if weight != 0.0:
            for parameter in range(gradient.shape[1]):
                gradient[k, parameter] += weight * gradient[k - lag, parameter]
            by_lag[lag] = 0.0


@inner_kernel
def fill_gradient(
    k: int,
    model: ModelTable,
    past: Floats,
    noise: Floats,
    phi: Floats,
    bottom: float,
    free: bool,
    by_lag: Floats,
    gradient: Floats,
) -> None:
    """Fill gradient[k] by the chain rule: dŷ(k)/dθ = ∂ŷ(k)/∂θ + Σ_lag ∂ŷ(k)/∂y(k - lag) * dy(k - lag)/dθ.

    In one-step prediction, the second sum is over the noise e(k - lag) = measured - ŷ, whose gradient is -dŷ/dθ.

    Parameters
    ----------
    by_lag : (look_back + 1,) buffer for the derivatives by the output or noise at each lag; zeros before and after
    """
    base, theta, group, starts, table, scales, _, _ = model
    m = len(theta)
    ratio = 0.0
    for j in range(m):
        if group[j] == GROUP_NUMERATOR:
            ratio += theta[j] * phi[j] / bottom
    for j in range(m):
        outer = 1.0
        if group[j] == GROUP_NUMERATOR:
            outer = 1.0 / bottom
        elif group[j] == GROUP_DENOMINATOR:
            outer = -ratio / bottom
        gradient[k, j] += outer * phi[j]
        if theta[j] == 0.0:
            continue  # a candidate term that is not in the model
        for i in range(starts[j], starts[j + 1]):
            of_noise = table[i, COL_OF_NOISE] == 1
            if of_noise == free:
                continue  # measured outputs do not depend on theta, and free runs have no noise
            before = k - table[i, COL_LAG]
            if of_noise and not math.isfinite(past[before]):
                continue  # unknown noise is 0 for every theta
            source = noise if of_noise else past
            inner = base[k, j] * factor_slope(
                table[i], scales[i, 0], scales[i, 1], argument(table[i], source, k)
            )
            for other in range(starts[j], starts[j + 1]):
                if other != i:
                    row = table[other]
                    side = noise if row[COL_OF_NOISE] else past
                    inner *= factor(row, scales[other, 0], scales[other, 1], argument(row, side, k))
            weight = outer * theta[j] * inner * (-1.0 if of_noise else 1.0)
            by_lag[table[i, COL_LAG]] += weight
            if table[i, COL_MINUS]:
                by_lag[table[i, COL_MINUS]] -= weight
    add_earlier(k, by_lag, gradient)


@kernel
def run_ahead(model: ModelTable, measured: Floats, noise: Floats, steps: int) -> Floats:
    """Predict each sample (n,) `steps` ahead, from measurements up to `steps` samples before it."""
    limits, (n, m) = model.limits, model.base.shape
    out = np.full(n, np.nan)
    past, quiet = measured.copy(), noise.copy()
    phi = np.zeros(m)
    for last in range(model.look_back + steps - 1, n):
        first = last - steps + 1
        value = np.nan
        for k in range(first, last + 1):
            value, _ = value_at(k, model, past, quiet, phi)
            if value < limits[0] or value > limits[1]:
                value = min(max(value, limits[0]), limits[1])
            if not abs(value) <= MAX_OUTPUT:  # unknown, as are the predictions that depend on it
                value = np.nan
            past[k], quiet[k] = value, 0.0
        out[last] = value
        for k in range(first, last + 1):
            past[k], quiet[k] = measured[k], noise[k]
    return out
