"""Propose effects that act roughly: cut-offs, surfaces, objects, sectors, lattices, mixtures.

Each proposer looks at the residuals of a fit where its effect would show, and returns candidates with start values
and the gain that the frozen nuisances promise. None of them decides: `decide` fits and compares.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sensorgraph.diagnosis.scan.fit import log_likelihood, start_state, thin, thin_state
from sensorgraph.diagnosis.scan.gauss_newton import MOST_CORNERS
from sensorgraph.diagnosis.scan.likelihood import FINEST
from sensorgraph.diagnosis.scan.propose_obstacles import missing_or_moved, nudged, unmapped
from sensorgraph.diagnosis.scan.propose_surfaces import black, glass, mirror
from sensorgraph.diagnosis.scan.residuals import FEW, LEAST_GAIN, View
from sensorgraph.diagnosis.scan.score_test import Candidate
from sensorgraph.diagnosis.scan.settings import NoiseBounds
from sensorgraph.effects import EFFECTS
from sensorgraph.types import Floats


def rough_candidates(view: View) -> list[Candidate]:
    """Ask every proposer."""
    found: list[Candidate] = []
    for propose in PROPOSERS:
        found += [c for c in propose(view) if c.gain > LEAST_GAIN]
    return sorted(found, key=lambda c: -c.gain)


def cut_offs(view: View) -> list[Candidate]:
    """max_range, min_range, incidence_dropout: exact profile of the gain over every threshold."""
    found = []
    dead = view.dead
    blind = np.where(view.near, -0.7 - view.log_p, dead)
    mu = np.where(view.aimed & (view.mu < view.range_max), view.mu, np.nan)
    for name, parameter, value, upward in (
        ("max_range", "R", mu, True),
        ("min_range", "r_min", mu, False),
        ("incidence_dropout", "alpha_max", np.where(np.isfinite(mu), view.incidence, np.nan), True),
    ):
        ok = np.isfinite(value)
        if not ok.any():
            continue
        v, d = value[ok], (blind if name == "min_range" else dead)[ok]
        order = np.argsort(-v if upward else v)
        total = np.cumsum(d[order])
        at = int(total.argmax())
        n_lost = int((view.lost | view.near)[ok][order][: at + 1].sum())
        if n_lost < 3:
            continue
        v = v[order]
        beyond = v[at + 1] if at + 1 < len(v) else v[at]
        found.append(
            Candidate(
                amendment=EFFECTS[name](**{parameter: float((v[at] + beyond) / 2)}), gain=float(total[at])
            )
        )
    return found


def sectors(view: View) -> list[Candidate]:
    """sector_bias: the run of neighbouring rays whose mean residual explains most."""
    responsibilities = view.fitted.solution.responsibilities
    bearings = view.data.sensor.bearings
    found = []
    for weight in (responsibilities.weight, _broad(view)):
        valid = view.fitted.cast.jacobian.valid & view.returned
        w = np.where(valid, weight, 0.0)
        num, den = (w * responsibilities.residual).sum(axis=0), w.sum(axis=0)
        n = len(num)
        cn, cd = np.concatenate([[0.0], np.cumsum(num)]), np.concatenate([[0.0], np.cumsum(den)])
        i, j = np.triu_indices(n + 1, 1)
        few = (j - i) <= 0.8 * n
        i, j = i[few], j[few]
        s, d = cn[j] - cn[i], cd[j] - cd[i]
        score = 0.5 * s**2 / np.maximum(d, 1e-9) - 1.5 * np.log(n)
        at = int(score.argmax())
        half = 0.5 * float(np.median(np.diff(bearings))) if n > 1 else 0.01
        amendment = EFFECTS["sector_bias"](
            theta1=float(bearings[i[at]] - half),
            theta2=float(bearings[j[at] - 1] + half),
            b=float(s[at] / max(d[at], 1e-9)),
        )
        found.append(Candidate(amendment=amendment, gain=float(score[at])))
    return sorted(found, key=lambda c: -c.gain)[:1]


def _broad(view: View) -> Floats:
    """Weigh readings far off as well, but less than near ones."""
    e = view.fitted.solution.responsibilities.residual
    sigma = view.sigma
    return np.asarray(np.where(view.returned, 1 / (sigma**2 * (1 + (e / (6 * sigma)) ** 2) * 6), 0.0))


def self_occlusion(view: View) -> list[Candidate]:
    """self_occlusion: rays that read one and the same, whatever the pose."""
    n_scans = view.z.shape[0]
    odd = view.short.sum(axis=0) > 0.3 * n_scans
    if not odd.any():
        return []
    found = []
    bearings = view.data.sensor.bearings
    edges = np.flatnonzero(np.diff(np.concatenate([[0], odd.astype(int), [0]])))
    for first, last in zip(edges[::2], edges[1::2] - 1, strict=True):
        z = view.z[:, first : last + 1]
        r0 = float(np.median(z[view.short[:, first : last + 1]]))
        sector = slice(first, last + 1)
        mu = np.minimum(np.where(view.aimed[:, sector], view.mu[:, sector], np.inf), r0)
        some = np.zeros(view.z.shape, dtype=np.bool_)
        some[:, sector] = True
        gain = float((view.likely(mu.ravel(), some) - view.log_p[some]).sum())
        half = 0.5 * float(np.median(np.diff(bearings))) if len(bearings) > 1 else 0.01
        amendment = EFFECTS["self_occlusion"](
            r0=r0, theta1=float(bearings[first] - half), theta2=float(bearings[last] + half)
        )
        found.append(Candidate(amendment=amendment, gain=gain))
    return found


def lattice(view: View) -> list[Candidate]:
    """Quantisation: few distinct readings, a step apart."""
    z = view.z[view.returned]
    finest = max(view.data.sensor.resolution, FINEST)
    cells, counts = np.unique(np.round(z / FINEST).astype(np.int64), return_counts=True)
    values = cells[counts >= 3] * np.float64(FINEST)
    if len(values) < 5 or len(z) < 200 or counts[counts >= 3].sum() < 0.9 * len(z):
        return []
    q = float(np.median(np.diff(values)))
    if q < 1.7 * finest:
        return []
    grid = q * (1 + np.linspace(-0.08, 0.08, 641))
    few = values[values < max(0.05 / 0.08 * q * 8, values[0] + 12 * q)]  # first where no step can be lost
    for _ in range(6):
        turn = np.exp(2j * np.pi * few[None] / grid[:, None]).mean(axis=1).real
        q = float(grid[int(turn.argmax())])
        width = 0.2 * q / max(few[-1], q)
        grid = q * (1 + np.linspace(-width, width, 201))
        if len(few) == len(values):
            break
        few = values[values < 2.5 * few[-1]]
    k = np.round(z / q)
    on = np.abs(z - k * q) <= 0.5 * finest + 1e-6
    if on.mean() < 0.95:
        return []
    return [
        Candidate(amendment=EFFECTS["quantisation"](q=q), gain=len(z) * max(np.log(q / finest), 0.1) * 0.5)
    ]


def noises(view: View) -> list[Candidate]:
    """range_noise, random_outliers, people: what widens or mixes."""
    found = []
    responsibilities = view.fitted.solution.responsibilities
    ok = view.returned & view.aimed & (responsibilities.stray < 0.5)
    e, r, sigma = responsibilities.residual[ok], view.mu[ok], view.fitted.cast.expected.sigma[ok]
    if ok.sum() > 100:
        base = None
        for k in (0.0, 0.0015, 0.003, 0.005, 0.008, 0.012, 0.02, 0.03):
            best = -np.inf
            for core in (0.75, 0.85, 1.0, 1.15):
                s = np.sqrt((core * sigma) ** 2 + (k * r) ** 2)
                tail = self_tail(e, s, view.noise.tail)
                best = max(best, tail)
            if base is None:
                base = best
            elif best > base + LEAST_GAIN:
                found.append(Candidate(amendment=EFFECTS["range_noise"](k=k), gain=best - base))
    found = sorted(found, key=lambda c: -c.gain)[:1]
    n = max(int(view.returned.sum()), 1)
    odd = int(view.strange.sum())
    if odd > max(FEW, 0.002 * n):
        p = odd / n
        found.append(Candidate(amendment=EFFECTS["random_outliers"](p=p), gain=2.0 * odd * 0.5))
    odd = int(view.short.sum())
    if odd > max(FEW, 0.002 * n):
        found.append(Candidate(amendment=EFFECTS["people"](p=odd / n), gain=2.2 * odd * 0.5))
    return found


def self_tail(e: Floats, s: Floats, tail: float) -> float:
    """Return the log-likelihood of residuals under core and tail."""
    q = (e / s) ** 2
    return float(np.log(((1 - tail) * np.exp(-0.5 * q) + tail / 3 * np.exp(-0.5 * q / 9)) / s + 1e-3).sum())


def optics(view: View) -> list[Candidate]:
    """mixed_pixels, sonar_cone: fits of whole rays on a few scans."""
    if view.data.floors.get("mixed_pixels") == np.inf:
        return []
    found = []
    if _between(view) >= FEW and "mixed_pixels" not in view.fitted.names():
        found += _swept(view, "mixed_pixels", "gamma", np.radians([0.12, 0.2, 0.35, 0.6, 1.0, 1.6]), {})
    if view.short.mean() + view.lost.mean() > 0.1:
        for alpha in np.radians([20.0, 30.0, 45.0, 89.9]):
            found += _swept(
                view,
                "sonar_cone",
                "gamma",
                np.radians([4.0, 6.0, 8.0, 10.0, 12.5, 15.0, 18.0, 22.0, 27.0]),
                {"alpha_max": float(alpha)},
            )
        found = sorted(found, key=lambda c: -c.gain)[:2]
    return found


def _between(view: View) -> int:
    """Count readings at steps in depth that lie between what the two sides read."""
    mu = np.where(view.aimed, np.minimum(view.mu, view.range_max), view.range_max)
    low, high = mu.copy(), mu.copy()
    for a, b in ((slice(1, None), slice(None, -1)), (slice(None, -1), slice(1, None))):
        low[:, a] = np.minimum(low[:, a], mu[:, b])
        high[:, a] = np.maximum(high[:, a], mu[:, b])
    margin = 5 * view.sigma
    with np.errstate(invalid="ignore"):
        inside = view.returned & (view.z > low + margin) & (view.z < high - margin) & (high - low > 0.2)
        return int((inside & (np.abs(view.z - view.mu) > margin)).sum())


def _swept(view: View, name: str, parameter: str, values: Floats, fixed: dict[str, float]) -> list[Candidate]:
    """Try values of one parameter on every so-manieth scan, nuisances frozen."""
    some = 60 if view.data.arena.n_walls <= MOST_CORNERS else 20  # scans
    every = max(1, view.data.n_scans // some)
    few = thin(view.data, every)
    state = thin_state(view.fitted.state, every)
    if state.noise.core > 1.1 or state.noise.tail > 0.1:  # bent by what is looked for
        state = start_state(few, NoiseBounds())
    model = view.fitted.model
    base = log_likelihood(few, model, state)
    best: Candidate | None = None
    for value in values:
        amendment = EFFECTS[name](**{parameter: float(value)}, **fixed)
        gain = (log_likelihood(few, (*model, amendment), state) - base) * every
        if best is None or gain > best.gain:
            best = Candidate(amendment=amendment, gain=gain)
    return [best] if best is not None else []


def tilt(view: View) -> list[Candidate]:
    """Tilt: readings capped by the floor. There h / z = sin(beta cos(theta - theta0)): linear in cos and sin theta."""
    h = view.data.sensor.height
    some = view.short & (view.z > 1.5 * h)
    if h <= 0 or some.sum() < 2 * FEW:
        return []
    bearings = np.broadcast_to(view.data.sensor.bearings, view.z.shape)[some]
    z = view.z[some]
    dip = np.arcsin(h / z)
    rows = np.column_stack([np.cos(bearings), np.sin(bearings)])
    width = np.maximum(3 * view.sigma[some] * h / z**2, 1e-4)  # [rad] of a dip, three sigma
    rng = np.random.default_rng(0)
    best: Floats = np.zeros(2)
    most = 0
    for _ in range(120):
        pair = rng.choice(len(z), 2, replace=False)
        system = rows[pair]
        if abs(np.linalg.det(system)) < 0.05:
            continue
        x = np.linalg.solve(system, dip[pair])
        count = int((np.abs(rows @ x - dip) < width).sum())
        if count > most:
            best, most = x, count
    for _ in range(3):
        inlier = np.abs(rows @ best - dip) < width
        if inlier.sum() < 2 * FEW:
            return []
        w = 1 / width[inlier]
        best = np.asarray(
            np.linalg.lstsq(rows[inlier] * w[:, None], dip[inlier] * w, rcond=None)[0], dtype=np.float64
        )
    beta, theta0 = float(np.hypot(*best)), float(np.arctan2(best[1], best[0]))
    if not 0.003 < beta < 0.5 or most < 0.2 * some.sum():
        return []
    return [Candidate(amendment=EFFECTS["tilt"](beta=beta, theta0=theta0), gain=8.0 * most)]


PROPOSERS: tuple[Callable[[View], list[Candidate]], ...] = (
    cut_offs,
    black,
    glass,
    mirror,
    missing_or_moved,
    nudged,
    unmapped,
    sectors,
    self_occlusion,
    lattice,
    noises,
    optics,
    tilt,
)
