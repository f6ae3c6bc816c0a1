"""Lyapunov exponents of maps and flows with measurement noise: from the series, the model, the cleaned model.

    python -m benchmarks.chaos

3,000 samples of the Hénon and the logistic map, 5,000 of the Lorenz system every 0.03 s (degree 3); noise in shares of
the standard deviation; mean and spread over five seeds that development did not use. `series`: Rosenstein's method,
neighbours followed over steps 1 to 6 (Hénon), 0 to 5 (logistic). `model`: tangent map of the identified polynomial.
`cleaned`: the same after `without_noise`; along the cleaned orbit where a free run leaves (the logistic map at 4).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from planners.types import Floats
from robotmodic_ident import IdentError, Narmax, fit, polynomial
from robotmodic_ident.analysis import lyapunov, lyapunov_along, lyapunov_of_series, states_of, without_noise

LORENZ_SEEDS = range(900, 905)
SAMPLE_PERIOD = 0.03  # [s] of the Lorenz samples


def henon(n: int) -> Floats:
    """Return samples of the attractor at a = 1.4, b = 0.3."""
    y = [0.1, 0.1]
    for _ in range(n + 100):
        y.append(1 - 1.4 * y[-1] ** 2 + 0.3 * y[-2])
    return np.array(y[-n:])


def logistic(n: int) -> Floats:
    """Return samples of the map at r = 4."""
    y = [0.3]
    for _ in range(n + 100):
        y.append(4 * y[-1] * (1 - y[-1]))
    return np.array(y[-n:])


def lorenz(n: int) -> Floats:
    """Return samples (n, 3) at 10, 28, 8/3, by Runge and Kutta in steps of 3 ms."""

    def flow(s: Floats) -> Floats:
        return np.array([10 * (s[1] - s[0]), s[0] * (28 - s[2]) - s[1], s[0] * s[1] - 8 / 3 * s[2]])

    h, s, out = SAMPLE_PERIOD / 10, np.ones(3), []
    for k in range(10 * (n + 500)):
        a = flow(s)
        b = flow(s + h / 2 * a)
        c = flow(s + h / 2 * b)
        s = s + h / 6 * (a + 2 * b + 2 * c + flow(s + h * c))
        if k % 10 == 9:
            out.append(s)
    return np.array(out[500:])


def noisy(clean: Floats, share: float, rng: np.random.Generator) -> Floats:
    """Add measurement noise."""
    return np.asarray(clean + share * clean.std(axis=0) * rng.normal(size=clean.shape))


def free(models: Narmax | Sequence[Narmax], series: Floats, rng: np.random.Generator, period: float) -> float:
    """Return the exponent of free runs; nan where they leave."""
    try:
        steps = 2000 if period == 1.0 else 4000
        found = lyapunov(models, states_of(models, series, 64, rng), period=period, n_steps=steps)
    except IdentError:
        return math.nan
    return float(found.values[0]) if found.lost < 0.5 else math.nan


def of_map(
    clean: Floats, signals: list[str], fit_range: tuple[int, int]
) -> Callable[[float, int], list[float]]:
    """Return the three estimates for a share of noise and a seed."""

    def estimate(share: float, seed: int) -> list[float]:
        rng = np.random.default_rng(seed)
        y = noisy(clean, share, rng)
        series = lyapunov_of_series(y, dimension=2, theiler=10, fit=fit_range).exponent
        model = fit({"y": y}, "y", polynomial(signals, 2))
        cleaned = without_noise(model, {"y": y})
        along = float(lyapunov_along(cleaned.model, {"y": cleaned.series}).values[0])
        again = free(cleaned.model, cleaned.series, rng, 1.0)
        return [series, free(model, y, rng, 1.0), again if math.isfinite(again) else along]

    return estimate


def of_lorenz(clean: Floats) -> Callable[[float, int], list[float]]:
    """Return the estimates of the flow; its three models are not cleaned."""
    terms = polynomial(["x(k-1)", "y(k-1)", "z(k-1)"], 3)

    def estimate(share: float, seed: int) -> list[float]:
        rng = np.random.default_rng(seed)
        table = noisy(clean, share, rng)
        data = dict(zip("xyz", table.T, strict=True))
        models = [fit(data, v, terms, search="forward") for v in "xyz"]
        return [math.nan, free(models, table, rng, SAMPLE_PERIOD), math.nan]

    return estimate


def main() -> None:
    """Print the table."""
    systems = (
        ("Hénon", 0.4192, of_map(henon(3000), ["y(k-1)", "y(k-2)"], (1, 6)), (0.0, 0.01, 0.05)),
        ("logistic, r = 4", math.log(2), of_map(logistic(3000), ["y(k-1)"], (0, 5)), (0.0, 0.01, 0.03)),
        ("Lorenz [1/s]", 0.9056, of_lorenz(lorenz(5000)), (0.0, 0.01)),
    )
    print("| system | noise | truth | series | model | cleaned |\n|---|---:|---:|---:|---:|---:|")
    for name, truth, estimate, shares in systems:
        for share in shares:
            found = np.array([estimate(share, seed) for seed in LORENZ_SEEDS]) / truth - 1
            cells = []
            for column in found.T:
                known = column[np.isfinite(column)]
                gone = "" if len(known) in (0, len(column)) else f", {len(column) - len(known)} left"
                cells.append(f"{known.mean():+.1%} ± {known.std():.1%}{gone}" if len(known) else "–")
            print(f"| {name} | {share:.0%} | {truth:.4f} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
