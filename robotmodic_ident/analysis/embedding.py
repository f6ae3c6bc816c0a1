"""Delay embedding, nearest neighbours from another passage of the orbit, and surrogates of a series."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from robotmodic_ident.errors import IdentError
from robotmodic_ident.types import Floats

N_NEIGHBOUR_CANDIDATES = 64
"""Number of nearest neighbours searched for one that is far enough in time."""


def embed(series: ArrayLike, dimension: int, lag: int = 1) -> Floats:
    """Return delay vectors (n - (dimension - 1) * lag, dimension * n_signals) of a series (n,) or (n, n_signals)."""
    table = np.asarray(series, dtype=np.float64)
    table = table[:, None] if table.ndim == 1 else table
    if dimension < 1 or lag < 1:
        raise ValueError(f"dimension and lag are {dimension}, {lag}, expected 1 or more")
    if not np.isfinite(table).all():
        raise IdentError("the series has unknown samples; use a segment without them")
    n = len(table) - (dimension - 1) * lag
    if n < 2:
        raise IdentError(f"{len(table)} samples are too few for {dimension} delays of {lag}")
    return np.concatenate([table[i * lag : i * lag + n] for i in range(dimension)], axis=1)


def neighbours(points: Floats, theiler: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return pairs (i, j), where j is the nearest distinct neighbour of i more than `theiler` samples away."""
    k = min(N_NEIGHBOUR_CANDIDATES + 2 * theiler, len(points))
    near, index = (np.asarray(part) for part in cKDTree(points).query(points, k=k))
    other = (np.abs(index - np.arange(len(points))[:, None]) > theiler) & (near > 0)
    found = other.any(axis=1)
    if not found.any():
        raise IdentError(f"no sample has a neighbour more than {theiler} samples away; use a longer series")
    first = other.argmax(axis=1)
    mine = np.flatnonzero(found)
    return mine, index[mine, first[mine]].astype(np.intp)


def surrogate(series: Floats, rng: np.random.Generator, *, rounds: int = 100) -> Floats:
    """Return linear noise with the same values and nearly the same spectrum: a surrogate with random phases.

    The method is iterated amplitude adjustment (Schreiber and Schmitz, Phys. Rev. Lett. 77, 1996). All columns of
    (n, n_signals) get the same phase shifts, which preserves their linear dependence.
    """
    table = np.asarray(series, dtype=np.float64)
    flat = table[:, None] if table.ndim == 1 else table
    size = np.abs(np.fft.rfft(flat, axis=0))
    phase = np.angle(np.fft.rfft(flat, axis=0))
    values = np.sort(flat, axis=0)
    turn = rng.uniform(0, 2 * np.pi, (len(size), 1))
    out = np.fft.irfft(size * np.exp(1j * (phase + turn)), n=len(flat), axis=0)
    for _ in range(rounds):
        rank = out.argsort(axis=0).argsort(axis=0)
        matched = np.take_along_axis(values, rank, axis=0)
        spectrum = np.fft.rfft(matched, axis=0)
        fresh = np.fft.irfft(size * np.exp(1j * np.angle(spectrum)), n=len(flat), axis=0)
        if np.allclose(fresh, out, atol=1e-9 * float(np.ptp(values))):
            break
        out = fresh
    rank = out.argsort(axis=0).argsort(axis=0)
    out = np.take_along_axis(values, rank, axis=0)
    return out[:, 0] if table.ndim == 1 else out
