"""Coefficients, noise terms, standard errors and residual tests of one ray.

Model: y(k) = phi(k)·theta + sum_l c_l e(k-l) + e(k). Prediction error: e = (y - Q beta) / C(q).
Here phi = Q R, beta = R theta, and C(q) = 1 + c_1 q⁻¹ + ... filters in time.

If the least-squares residual is correlated, beta and c minimise e'e (prediction error, Ljung 1999, ch. 7). Gauss-Newton
steps (J'J)⁻¹ J'e start from the estimate of Hannan and Rissanen. Lags of the noise do not cross gaps. The tests are
Lagrange multiplier tests (Breusch 1978, Godfrey 1978), as in `robotmodic_ident.validate`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from planners.kernel import outer_kernel
from robotmodic_ident.estimation.noise_model import ALARM, TESTED_LAGS
from sensorgraph.models.narmax.sequences import positions
from sensorgraph.models.residual_memory import MAX_MEMORY
from sensorgraph.types import Bools, Floats, Ints

MAX_STEPS = 3
"""Maximum number of Gauss-Newton steps, from a consistent start; they end when one brings no gain."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RayEstimate:
    """Estimated coefficients of one ray."""

    kept: Bools
    """(n_columns,) mask of the k terms that are still needed with the noise terms."""
    theta: Floats
    """(k,) coefficients."""
    stderr: Floats
    """(k,) standard errors."""
    noise: Floats
    """(noise_lags,) coefficients of the noise; 0 where no noise terms are needed."""
    noise_stderr: Floats
    """(noise_lags,) standard errors."""
    sigma: float
    """[m] Standard deviation of the one-step residual, corrected for the coefficients; nan without degrees of freedom."""
    tests: Floats
    """(3,) p-values of the residual against its own past, v and omega; nan with too few rows."""


class Stretches:
    """Rows of one ray as runs of consecutive scans; filters and lags start again in each run."""

    def __init__(self, index: Ints) -> None:
        """Store the index (n,) of the scans, increasing; consecutive scans differ by 1, so a gap must skip a number."""
        self.position = positions(np.r_[True, np.diff(index) != 1])[: len(index)]

    def lagged(self, values: Floats, lag: int) -> Floats:
        """Return the values (n,) of `lag` scans before; 0 before the start of a stretch."""
        out = np.zeros_like(values)
        out[lag:] = values[: len(values) - lag]
        return np.where(self.position >= lag, out, 0.0)

    def whitened(self, noise: Floats, values: Floats) -> Floats:
        """Filter values (n, m) by 1 / C(q) = 1 / (1 + c1 q⁻¹ + ...), from rest at the start of each stretch."""
        out = np.array(values, order="C")
        _whiten(out, noise, self.position)
        return out


@outer_kernel
def _whiten(values: Floats, noise: Floats, position: Ints) -> None:
    """Subtract sum_l c_l times row k - l from each row k of values (n, m), in the order of the rows."""
    for k in range(len(values)):
        for lag in range(1, min(len(noise), position[k]) + 1):
            for j in range(values.shape[1]):
                values[k, j] -= noise[lag - 1] * values[k - lag, j]


def estimate(phi: Floats, y: Floats, twists: Floats, index: Ints, noise_lags: int) -> RayEstimate:
    """Estimate and test the equation of one ray.

    Parameters
    ----------
    phi : (n, k) Columns of its terms, the constant first.
    y : (n,) [m] Measured ranges.
    twists : (n, 2) [m/s, rad/s]
    index : (n,) Number of each scan; a gap skips a number.
    """
    n, k = phi.shape
    zero = np.zeros(noise_lags)
    if n <= k:
        theta: Floats = np.asarray(np.linalg.lstsq(phi, y, rcond=None)[0], dtype=np.float64)
        nan = np.full(3, np.nan)
        return RayEstimate(
            kept=np.ones(k, dtype=np.bool_), theta=theta, stderr=np.zeros(k), noise=zero, noise_stderr=zero,
            sigma=np.nan, tests=nan,
        )  # fmt: skip
    Q, R = np.linalg.qr(phi)
    runs = Stretches(index)
    beta = Q.T @ y
    e = y - Q @ beta
    noise, jacobian = zero, Q
    if noise_lags and _correlated(e, Q, runs, TESTED_LAGS[0]) < ALARM:
        beta, noise = _prediction_error(Q, y, e, runs, noise_lags)
        e, jacobian = _linearised(Q, y, beta, noise, runs)
        kept = _kept_by_bic(jacobian, e, beta, noise, R)
        if not kept.all():
            fewer = estimate(phi[:, kept], y, twists, index, noise_lags)
            whole = kept.copy()
            whole[kept] = fewer.kept
            return replace(fewer, kept=whole)
    degrees_of_freedom = max(n - jacobian.shape[1], 1)
    sigma = float(np.sqrt(e @ e / degrees_of_freedom))
    spread = sigma**2 * np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    inverse_R = np.linalg.pinv(R)
    variance = np.einsum("ij,jk,ik->i", inverse_R, spread[:k, :k], inverse_R)
    return RayEstimate(
        kept=np.ones(k, dtype=np.bool_), theta=inverse_R @ beta, stderr=np.sqrt(np.maximum(variance, 0.0)),
        noise=noise,
        noise_stderr=np.sqrt(np.maximum(np.diagonal(spread)[k:], 0.0)) if noise.any() else zero,
        sigma=sigma, tests=_tests(e, jacobian, twists, runs),
    )  # fmt: skip


def _prediction_error(
    Q: Floats, y: Floats, e: Floats, runs: Stretches, noise_lags: int
) -> tuple[Floats, Floats]:
    """Minimise e'e over beta (k,) and c (noise_lags,) by Gauss-Newton: step = (J'J)⁻¹ J'e.

    Start (Hannan and Rissanen 1982): least squares of y on Q and the lags of the least-squares residual.
    """
    k = Q.shape[1]
    past = np.column_stack([runs.lagged(e, lag) for lag in range(1, noise_lags + 1)])
    both = np.column_stack([Q, past])
    start = np.linalg.lstsq(both.T @ both, both.T @ y, rcond=None)[0]
    noise = _invertible(start[k:])
    beta = start[:k]
    error, jacobian = _linearised(Q, y, beta, noise, runs)
    cost = float(error @ error)
    for _ in range(MAX_STEPS):
        step = np.linalg.lstsq(jacobian.T @ jacobian, jacobian.T @ error, rcond=None)[0]
        trial = beta + step[:k], _invertible(noise + step[k:])
        new_error, new_jacobian = _linearised(Q, y, *trial, runs)
        new = float(new_error @ new_error)
        if not new < cost:
            break
        (beta, noise), error, jacobian, cost = trial, new_error, new_jacobian, new
    plain = float(e @ e)
    return (beta, noise) if cost < plain else (Q.T @ y, np.zeros(noise_lags))


def _kept_by_bic(jacobian: Floats, e: Floats, beta: Floats, noise: Floats, R: Floats) -> Bools:
    """Return a mask of the terms (k,) that BIC keeps next to the noise terms, by backward elimination.

    A term i is removed while theta_i² / (sigma² ((J'J)⁻¹)_ii) < log n is smallest for it. Coloured noise makes lagged
    readings seem necessary; with its coefficients known, they are not. The constant is kept.
    """
    k = len(beta)
    to_terms = np.eye(jacobian.shape[1])
    to_terms[:k, :k] = R
    J = jacobian @ to_terms  # derivatives by the coefficients of the terms
    size = np.sqrt(np.maximum((J**2).sum(axis=0), np.finfo(np.float64).tiny))
    J = J / size
    gram = J.T @ J
    cross = J.T @ (
        e + jacobian @ np.r_[beta, noise][: jacobian.shape[1]]
    )  # without noise columns if the noise is 0
    kept = np.ones(len(gram), dtype=np.bool_)
    variance, penalty = float(e @ e) / len(e), np.log(len(e))
    while kept[:k].sum() > 1:
        inverse = np.linalg.pinv(gram[np.ix_(kept, kept)], hermitian=True)
        theta = inverse @ cross[kept]
        gain = theta**2 / (variance * np.maximum(np.diagonal(inverse), np.finfo(np.float64).tiny))
        place = np.flatnonzero(kept)
        removable = (place > 0) & (place < k)
        weakest = int(np.argmin(np.where(removable, gain, np.inf)))
        if gain[weakest] >= penalty:
            break
        kept[place[weakest]] = False
    return kept[:k]


def _linearised(Q: Floats, y: Floats, beta: Floats, noise: Floats, runs: Stretches) -> tuple[Floats, Floats]:
    """Return the prediction errors e (n,) and J = -de/d(beta, c) (n, k + noise_lags): Q / C, and lags of e / C."""
    if not noise.any():
        return y - Q @ beta, Q
    filtered = runs.whitened(noise, np.column_stack([Q, y - Q @ beta]))
    e = filtered[:, -1]
    slopes = runs.whitened(noise, e[:, None])[:, 0]
    past = [runs.lagged(slopes, lag) for lag in range(1, len(noise) + 1)]
    return e, np.column_stack([filtered[:, :-1], *past])


def _invertible(noise: Floats) -> Floats:
    """Move the roots of C(q) to within the unit circle."""
    roots = np.abs(np.roots(np.r_[1.0, noise])) if noise.any() else np.zeros(1)
    share = min(1.0, MAX_MEMORY / max(float(roots.max(initial=0.0)), 1e-12))
    return np.asarray(noise * share ** np.arange(1, len(noise) + 1))


def _correlated(e: Floats, G: Floats, runs: Stretches, n_lags: int) -> float:
    """Return the p-value of the residual (n,) against its own past, orthogonal to the gradients G (n, k)."""
    return _multiplier_tests(e, G, [e], runs, n_lags)[0]


def _tests(e: Floats, G: Floats, twists: Floats, runs: Stretches) -> Floats:
    past = [e, *(twists - twists.mean(axis=0)).T]
    return np.array(_multiplier_tests(e, G, past, runs, TESTED_LAGS[0]))


def _multiplier_tests(
    e: Floats, G: Floats, pasts: Sequence[Floats], runs: Stretches, n_lags: int
) -> list[float]:
    """Return the p-values of Lagrange multiplier tests of e (n,) against the lags of each signal (n,) in `pasts`.

    Statistic: g' V⁻¹ g / sigma², with the score g = Z'e - Z'G (G'G)⁻¹ G'e and V = Z'Z - Z'G (G'G)⁻¹ G'Z.
    Here Z holds the lags and G (n, k) the gradients. Under the null it is chi-squared with rank(V) degrees of freedom.
    """
    while n_lags > 1 and (runs.position >= n_lags).mean() < 0.5:  # fewer lags for short stretches
        n_lags -= 1
    use = runs.position >= n_lags
    target, G = e[use], G[use]
    if len(target) <= n_lags + G.shape[1] + 1:
        return [float("nan")] * len(pasts)
    inverse = np.linalg.pinv(G.T @ G, hermitian=True)
    variance = float(target @ target) / len(target)
    explained = inverse @ (G.T @ target)
    out = []
    for past in pasts:
        Z = np.column_stack([runs.lagged(past, lag)[use] for lag in range(1, n_lags + 1)])
        ZG, square = Z.T @ G, Z.T @ Z
        size = np.sqrt(np.diagonal(square))
        size = np.where(size > 0, size, 1.0)
        values, vectors = np.linalg.eigh((square - ZG @ inverse @ ZG.T) / np.outer(size, size))
        kept = values > 1e-12  # smaller values are rounding errors
        if not kept.any() or variance <= 0:
            out.append(float("nan"))
            continue
        score = vectors[:, kept].T @ ((Z.T @ target - ZG @ explained) / size)
        out.append(float(chdtrc(int(kept.sum()), float((score**2 / values[kept]).sum()) / variance)))
    return out
