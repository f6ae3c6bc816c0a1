"""Coefficients, noise terms, standard errors and tests of the residuals of one ray.

Where the least-squares residual is correlated, noise terms c1 e(k-1) + ... are estimated with the others by the
prediction error (Ljung 1999, ch. 7): from the start of Hannan and Rissanen, then Gauss-Newton. Lags of the noise do
not cross gaps. Tests are Lagrange multiplier tests (Breusch 1978, Godfrey 1978), as in `robotmodic_ident.validate`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from sensorgraph.models.narmax.settings import NARMAX
from sensorgraph.types import Bools, Floats, Ints


@dataclass(frozen=True, kw_only=True, eq=False)
class RayEstimate:
    """The coefficients of one ray."""

    kept: Bools
    """(n_columns,) the terms that are still needed beside the noise terms; k of them."""
    theta: Floats
    """(k,)"""
    stderr: Floats
    """(k,)"""
    noise: Floats
    """(noise_lags,) 0 where no noise terms are needed."""
    noise_stderr: Floats
    """(noise_lags,)"""
    sigma: float
    """[m] of the one-step residual, corrected for the coefficients; nan if no row is left."""
    tests: Floats
    """(3,) p-values: the residual against its own past, against v, against omega; nan where there is too little."""


class Stretches:
    """Rows of one ray as runs of consecutive scans; filters and lags start anew in each."""

    def __init__(self, index: Ints) -> None:
        """Take index (n,) of the scans, increasing; a stretch number must not be shared: gaps break the count."""
        first = np.r_[True, np.diff(index) != 1] if len(index) else np.zeros(0, dtype=np.bool_)
        starts = np.flatnonzero(first)
        lengths = np.diff(np.r_[starts, len(index)])
        self.position = np.arange(len(index)) - np.repeat(starts, lengths)
        self._groups = []
        size = np.ceil(np.log2(np.maximum(lengths, 1))).astype(int)
        for power in np.unique(size).tolist():  # of similar lengths, padded to one
            mine = np.flatnonzero(size == power)
            longest = int(lengths[mine].max())
            place = starts[mine][:, None] + np.arange(longest)
            there = np.arange(longest) < lengths[mine][:, None]
            self._groups.append((np.where(there, place, 0), there))

    def lagged(self, values: Floats, lag: int) -> Floats:
        """Return values (n,) of `lag` scans ago; 0 before the start of a stretch."""
        out = np.zeros_like(values)
        out[lag:] = values[: len(values) - lag]
        return np.where(self.position >= lag, out, 0.0)

    def whitened(self, noise: Floats, values: Floats) -> Floats:
        """Filter values (n, m) by 1 / (1 + c1 q^-1 + ...), at rest before each stretch."""
        if not noise.any():
            return values
        from scipy.signal import lfilter  # 0.3 s to import, for rays with noise terms only

        if len(values) and self.position[-1] == len(values) - 1:  # one stretch
            return np.asarray(lfilter([1.0], np.r_[1.0, noise], values, axis=0))
        out = np.empty_like(values)
        for place, there in self._groups:
            filtered = lfilter([1.0], np.r_[1.0, noise], values[place], axis=1)
            out[place[there]] = filtered[there]
        return out


def estimate(phi: Floats, y: Floats, twists: Floats, index: Ints, noise_lags: int) -> RayEstimate:
    """Estimate one ray.

    Parameters
    ----------
    phi : (n, k) columns of its terms, the constant first
    y : (n,) [m]
    twists : (n, 2)
    index : (n,) number of each scan, in which a gap leaves a number out
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
    if noise_lags and _correlated(e, Q, runs, NARMAX.tested_lags) < NARMAX.alarm:
        beta, noise = _prediction_error(Q, y, e, runs, noise_lags)
        e, jacobian = _linearised(Q, y, beta, noise, runs)
        kept = _needed(jacobian, e, beta, noise, R)
        if not kept.all():
            fewer = estimate(phi[:, kept], y, twists, index, noise_lags)
            whole = kept.copy()
            whole[kept] = fewer.kept
            return replace(fewer, kept=whole)
    free = max(n - jacobian.shape[1], 1)
    sigma = float(np.sqrt(e @ e / free))
    spread = sigma**2 * np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    back = np.linalg.pinv(R)
    variance = np.einsum("ij,jk,ik->i", back, spread[:k, :k], back)
    return RayEstimate(
        kept=np.ones(k, dtype=np.bool_),
        theta=back @ beta,
        stderr=np.sqrt(np.maximum(variance, 0.0)),
        noise=noise,
        noise_stderr=np.sqrt(np.maximum(np.diagonal(spread)[k:], 0.0)) if noise.any() else zero,
        sigma=sigma,
        tests=_tests(e, jacobian, twists, runs),
    )


def _prediction_error(
    Q: Floats, y: Floats, e: Floats, runs: Stretches, noise_lags: int
) -> tuple[Floats, Floats]:
    """Return coefficients (k,) and noise (noise_lags,) of least prediction error."""
    k = Q.shape[1]
    past = np.column_stack([runs.lagged(e, lag) for lag in range(1, noise_lags + 1)])
    both = np.column_stack([Q, past])
    start = np.linalg.lstsq(both.T @ both, both.T @ y, rcond=None)[0]
    noise = _invertible(start[k:])
    beta = start[:k]
    error, jacobian = _linearised(Q, y, beta, noise, runs)
    cost = float(error @ error)
    for _ in range(NARMAX.max_steps):
        step = np.linalg.lstsq(jacobian.T @ jacobian, jacobian.T @ error, rcond=None)[0]
        trial = beta + step[:k], _invertible(noise + step[k:])
        new_error, new_jacobian = _linearised(Q, y, *trial, runs)
        new = float(new_error @ new_error)
        if not new < cost:
            break
        gain = (cost - new) / cost
        (beta, noise), error, jacobian, cost = trial, new_error, new_jacobian, new
        if gain < NARMAX.converged:
            break
    plain = float(e @ e)
    return (beta, noise) if cost < plain else (Q.T @ y, np.zeros(noise_lags))


def _needed(jacobian: Floats, e: Floats, beta: Floats, noise: Floats, R: Floats) -> Bools:
    """Tell which terms (k,) are worth their cost by BIC beside the noise terms; the least needed goes first.

    Coloured noise makes lagged readings look needed; once its coefficients are known, they are not. The constant stays.
    """
    k = len(beta)
    turn = np.eye(jacobian.shape[1])
    turn[:k, :k] = R
    J = jacobian @ turn  # slopes by the coefficients of the terms
    size = np.sqrt(np.maximum((J**2).sum(axis=0), np.finfo(np.float64).tiny))
    J = J / size
    gram = J.T @ J
    cross = J.T @ (e + jacobian @ np.r_[beta, noise][: jacobian.shape[1]])  # no noise columns where it is 0
    kept = np.ones(len(gram), dtype=np.bool_)
    variance, price = float(e @ e) / len(e), np.log(len(e))
    while kept[:k].sum() > 1:
        inverse = np.linalg.pinv(gram[np.ix_(kept, kept)], hermitian=True)
        theta = inverse @ cross[kept]
        gain = theta**2 / (variance * np.maximum(np.diagonal(inverse), np.finfo(np.float64).tiny))
        place = np.flatnonzero(kept)
        may_go = (place > 0) & (place < k)
        weakest = int(np.argmin(np.where(may_go, gain, np.inf)))
        if gain[weakest] >= price:
            break
        kept[place[weakest]] = False
    return kept[:k]


def _linearised(Q: Floats, y: Floats, beta: Floats, noise: Floats, runs: Stretches) -> tuple[Floats, Floats]:
    """Return the prediction errors (n,) and minus their slopes (n, k + noise_lags)."""
    if not noise.any():
        return y - Q @ beta, Q
    filtered = runs.whitened(noise, np.column_stack([Q, y - Q @ beta]))
    e = filtered[:, -1]
    slopes = runs.whitened(noise, e[:, None])[:, 0]
    past = [runs.lagged(slopes, lag) for lag in range(1, len(noise) + 1)]
    return e, np.column_stack([filtered[:, :-1], *past])


def _invertible(noise: Floats) -> Floats:
    """Draw the roots of the noise polynomial back to within the unit circle."""
    roots = np.abs(np.roots(np.r_[1.0, noise])) if noise.any() else np.zeros(1)
    share = min(1.0, NARMAX.largest_root / max(float(roots.max(initial=0.0)), 1e-12))
    return np.asarray(noise * share ** np.arange(1, len(noise) + 1))


def _correlated(e: Floats, G: Floats, runs: Stretches, n_lags: int) -> float:
    """Return the p-value of the residual (n,) against its own past, freed of the gradients G (n, k)."""
    return _multiplier_tests(e, G, [e], runs, n_lags)[0]


def _tests(e: Floats, G: Floats, twists: Floats, runs: Stretches) -> Floats:
    past = [e, *(twists - twists.mean(axis=0)).T]
    return np.array(_multiplier_tests(e, G, past, runs, NARMAX.tested_lags))


def _multiplier_tests(
    e: Floats, G: Floats, pasts: Sequence[Floats], runs: Stretches, n_lags: int
) -> list[float]:
    """Return the p-values of e (n,) against the lags of signals (n,), once what G (n, k) explains is taken from them."""
    while n_lags > 1 and (runs.position >= n_lags).mean() < 0.5:  # of short stretches, fewer lags
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
        kept = values > 1e-12  # below is rounding
        if not kept.any() or variance <= 0:
            out.append(float("nan"))
            continue
        score = vectors[:, kept].T @ ((Z.T @ target - ZG @ explained) / size)
        out.append(float(chdtrc(int(kept.sum()), float((score**2 / values[kept]).sum()) / variance)))
    return out
