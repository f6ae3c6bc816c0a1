"""Identification: structure, intervals, false alarms, and speed beside SysIdentPy and fastcan.

python -m benchmarks.identification structure|noise|intervals|alarms|peers|streaming

Seeds start at 800000; development used others. Times are those of the
processor, one thread: run it with OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1. The peers are no
dependency: `pip install -e ".[peers]"`; without them `peers` says so.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter

from benchmarks.arguments import fastest, parser_of, peak_memory, timed
from robotmodic_ident import Moments, Scale, Terms, fit, lagged, lags, polynomial, select, validate
from robotmodic_ident.selection.model_size import Search
from sensorgraph.world.raycast import cast_laser

FIRST_DATA_SEED = 800_000
CUBIC = polynomial(lags("y", 1, 2) + lags("u", 0, 2), 3)
Signals = dict[str, np.ndarray]

MAO_BILLINGS = {
    "y(k-1)^3": 0.2,
    "y(k-1)*u(k-1)": 0.7,
    "u(k-2)^2": 0.6,
    "y(k-2)": -0.5,
    "y(k-2)*u(k-2)^2": -0.7,
}
"""Int. J. Control 68 (1997) 311: five terms, cubic."""
PIRODDI_SPINELLI = {"u(k-1)": 1.0, "u(k-2)": 0.5, "u(k-1)*u(k-2)": 0.25, "u(k-1)^3": -0.3}
"""Int. J. Control 76 (2003) 1767: deterministic part; its input is slow."""
FIVE_TERMS = {"y(k-1)": 0.5, "u(k-2)": 0.8, "u(k-1)^2": 1.0, "y(k-2)^2": -0.05, "1": 0.5}
"""Of the same kind with memory: y(k-1) and slow u(k-i) explain each other."""
TABLE_2 = {"1": 0.6, "u(k)": -0.5, "u(k-1)": 0.3}
"""The form of Table 2 of the 2004 paper: a turn rate from a mean range about 0.8 m now and before."""
MA_SYSTEM = {"1": 0.5, "y(k-1)": 0.6, "y(k-1)*u(k-1)": -0.15, "u(k-2)": 0.9}


def slow(rng: np.random.Generator, n: int, gain: float = 0.3) -> np.ndarray:
    """Return gain / (1 - 1.6 z^-1 + 0.64 z^-2) times white noise."""
    return lfilter([gain], [1, -1.6, 0.64], rng.normal(size=n + 200))[200:]


def simulate(truth: dict[str, float], u: np.ndarray, noise: np.ndarray, ma: float = 0.0) -> Signals:
    """Run y(k) = sum of terms + e(k) + ma e(k-1)."""
    signals = {"u": u, "y": np.zeros(len(u))}
    rows = [
        (theta, [(signals[f.variable], f.lag or 0, f.power) for f in term])
        for theta, term in zip(truth.values(), Terms.parse(*truth), strict=True)
    ]
    for k in range(2, len(u)):
        total = noise[k] + ma * noise[k - 1]
        for value, factors in rows:
            for source, lag, power in factors:
                value *= source[k - lag] ** power
            total += value
        signals["y"][k] = total
    return signals


def moments_of(record: Signals, terms: Terms) -> Moments:
    """Return moments with variables divided by their size."""
    rows = lagged(record, terms, ["y"])
    scale = Scale.of({v: record[v] for v in terms.variables}, centre=False)
    return Moments(terms, 1, scale=scale).add(rows.columns, rows.targets)


def structure(n_seeds: int) -> None:
    """Print in how many of n_seeds cases exactly the true terms are found."""
    static = polynomial(lags("u", 0, 3), 3)
    cases: list[tuple[str, dict[str, float], Terms, Callable, float, int]] = [
        ("Piroddi-Spinelli, slow AR(2) input", PIRODDI_SPINELLI, CUBIC, slow, np.sqrt(0.02), 1000),
        ("five terms, slow AR(2) input", FIVE_TERMS, CUBIC, lambda r, n: slow(r, n, 0.1), 0.05, 1000),
        ("Mao-Billings, white input", MAO_BILLINGS, CUBIC, lambda r, n: r.uniform(-0.8, 0.8, n), 0.02, 1000),
        ("Table 2, white input about 0.8", TABLE_2, static, white, 0.01, 500),
        ("Table 2, AR(.95) input about 0.8", TABLE_2, static, ar95, 0.01, 500),
    ]
    kinds: list[tuple[str, Search]] = [("bic", "forward"), ("ebic", "forward"), ("ebic", "restart")]
    kinds += [("bic", "exchange"), ("ebic", "exchange")]
    print(f"{'exact of ' + str(n_seeds):<38}" + "".join(f"{c + ' ' + s:>16}" for c, s in kinds))
    for name, truth, terms, source, sigma, n in cases:
        hits, true = np.zeros(len(kinds), dtype=int), {frozenset(t) for t in Terms.parse(*truth)}
        for seed in range(n_seeds):
            rng = np.random.default_rng(FIRST_DATA_SEED + seed)
            record = simulate(truth, source(rng, n), sigma * rng.normal(size=n))
            moments = moments_of(record, terms)
            for j, (criterion, search) in enumerate(kinds):
                chosen = select(moments, criterion=criterion, search=search).chosen(0).tolist()
                hits[j] += {frozenset(t) for t in terms[chosen]} == true
        print(f"{name:<38}" + "".join(f"{h:>16}" for h in hits))


def noise_orders(n_seeds: int) -> None:
    """Print how often the number of noise lags is found, and with it exactly the true terms."""
    candidates = polynomial(lags("y", 1, 2) + lags("u", 0, 2), 2)
    truth = {frozenset(t) for t in Terms.parse(*MA_SYSTEM)}
    print(f"{'of ' + str(n_seeds):<30}{'noise lags':>12}{'terms':>8}{'terms, noise=0':>16}")
    for n in (500, 2000):
        for ma in ((), (0.5,), (0.8,), (0.5, 0.3), (0.0, 0.5), (0.9, 0.5, 0.3)):
            order = exact = plain = 0
            for seed in range(n_seeds):
                rng = np.random.default_rng(FIRST_DATA_SEED + seed)
                u, e = rng.uniform(-1, 1, n), 0.5 * rng.normal(size=n)
                record = simulate(MA_SYSTEM, u, lfilter([1.0, *ma], [1.0], e))
                model = fit(record, "y", candidates, noise="auto")
                order += len(model.noise_terms) == len(ma)
                exact += {frozenset(t) for t in model.terms} == truth
                plain += {frozenset(t) for t in fit(record, "y", candidates).terms} == truth
            print(f"n={n:<6} c={ma!s:<20}{order:>12}{exact:>8}{plain:>16}")


def white(rng: np.random.Generator, n: int) -> np.ndarray:
    """Return white noise about 0.8."""
    return 0.8 + 0.1 * rng.normal(size=n)


def ar95(rng: np.random.Generator, n: int) -> np.ndarray:
    """Return a slow input about 0.8."""
    return 0.8 + 0.03 * lfilter([1], [1, -0.95], rng.normal(size=n + 200))[200:]


def intervals(n_seeds: int) -> None:
    """Print bias of y(k-1) and coverage of 95 % intervals under moving-average noise."""
    terms = Terms.parse(*MA_SYSTEM)
    print(f"{'':<22}{'bias of y(k-1)':>16}{'coverage of ' + ', '.join(MA_SYSTEM):>50}")
    for n, ma in ((500, 0.5), (500, 0.8), (2000, 0.8)):
        for estimator in ("ls", "els", "pem"):
            error, covered = [], []
            for seed in range(n_seeds):
                rng = np.random.default_rng(FIRST_DATA_SEED + seed)
                record = simulate(MA_SYSTEM, rng.uniform(-1, 1, n), rng.normal(size=n), ma)
                model = fit(
                    record, "y", terms, n_terms=4, noise=0 if estimator == "ls" else 1, estimator=estimator
                )
                rows = zip(model.terms.names, model.theta, model.stderr, strict=True)
                found = {name: (theta, stderr) for name, theta, stderr in rows}
                error.append(found["y(k-1)"][0] - 0.6)
                covered.append([abs(found[t][0] - v) < 1.96 * found[t][1] for t, v in MA_SYSTEM.items()])
            cover = "  ".join(f"{100 * c:5.1f} %" for c in np.mean(covered, axis=0))
            print(f"n={n:<5} c={ma} {estimator:<6}{np.mean(error):>+16.4f}{cover:>50}")


def alarms(n_seeds: int) -> None:
    """Print how often residual tests of a right model raise an alarm at n = 1000."""
    terms = Terms.parse(*MA_SYSTEM)
    for ma in (0.0, 0.5):
        single: dict[str, list[float]] = {}
        joint: dict[str, list[bool]] = {}
        for seed in range(n_seeds):
            rng = np.random.default_rng(FIRST_DATA_SEED + seed)
            u = 0.5 * lfilter([1], [1, -0.7], rng.normal(size=1000))
            record = simulate(MA_SYSTEM, u, 0.5 * rng.normal(size=1000), ma)
            model = fit(record, "y", terms, n_terms=4, noise=1 if ma else 0)
            for check in validate(model, record):
                single.setdefault(check.test, []).append(len(check.alarms) / len(check.lags))
                joint.setdefault(check.test, []).append(check.p_value < 0.05)
        for test in single:
            print(
                f"c={ma} {test:<8} {100 * np.mean(single[test]):5.1f} % of lags, {100 * np.mean(joint[test]):5.1f} % jointly"
            )


def room(rng: np.random.Generator, n: int, n_rays: int) -> tuple[Signals, np.ndarray]:
    """Cast rays in a room of 10 x 8 m with three boxes; poses with 1 cm and half a degree, ranges with 1 cm of noise."""
    boxes = np.array([[0, 0, 10, 8], [2, 2, 3, 3], [6, 1, 7.5, 2], [5, 5, 6, 6.5]], dtype=float)
    x, y, phi = np.empty(0), np.empty(0), rng.uniform(-np.pi, np.pi, n)
    while len(x) < n:
        a, b = rng.uniform(0.3, 9.7, 2 * n), rng.uniform(0.3, 7.7, 2 * n)
        low, high = boxes[1:, :2, None] - 0.2, boxes[1:, 2:, None] + 0.2
        free = ~((np.stack([a, b]) > low) & (np.stack([a, b]) < high)).all(axis=1).any(axis=0)
        x, y = np.r_[x, a[free]], np.r_[y, b[free]]
    x, y = x[:n], y[:n]
    corners = boxes[:, [[0, 1], [2, 1], [2, 3], [0, 3]]]  # (n_boxes, 4, 2)
    walls = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    poses = np.column_stack([x, y, phi])
    ranges, _ = cast_laser(walls, poses, np.linspace(-np.pi / 2, np.pi / 2, n_rays), 1e4)
    columns = {
        "x": x + 0.01 * rng.normal(size=n),
        "y": y + 0.01 * rng.normal(size=n),
        "c": np.cos(phi + 0.0087 * rng.normal(size=n)),
        "s": np.sin(phi + 0.0087 * rng.normal(size=n)),
    }
    return columns, ranges + 0.01 * rng.normal(size=ranges.shape)


def peers(n_peer_rays: int) -> None:
    """Time 181 rays x 20,000 poses, 35 terms of degree 3, 20 kept, beside the peers in the same run."""
    columns, ranges = room(np.random.default_rng(FIRST_DATA_SEED), 20_000, 181)
    terms = polynomial(list(columns), 3)
    scale = Scale()  # the peers do not scale either

    def ours() -> np.ndarray:
        return select(Moments(terms, 181, scale=scale).add(columns, ranges), 20).order

    def exchanged() -> np.ndarray:
        return select(Moments(terms, 181, scale=scale).add(columns, ranges), 20, search="exchange").order

    mine, swapped = fastest(ours, 7), fastest(exchanged, 3)
    print(f"{len(terms)} terms: ours {1e3 * mine:.1f} ms for 181 rays; with exchange {1e3 * swapped:.1f} ms")
    rays = np.linspace(0, 180, n_peer_rays).round().astype(int).tolist()
    for name, run in (("SysIdentPy 0.9", sysidentpy_order), ("fastcan 0.6", fastcan_order)):
        try:
            run(columns, terms, ranges[:, 0], 1)
        except ImportError as exc:
            print(f"{name}: not measured, {exc}")
            continue
        times, own, same = [], [], 0
        for ray in rays:
            own.append(fastest(ours, 3))  # in turn, so that both meet the same machine
            with timed() as took:
                theirs = run(columns, terms, ranges[:, ray], 20)
            times.append(took.cpu)
            kept = ["1"] if run is fastcan_order else []  # it centres: the constant comes first
            single = Moments(terms, 1, scale=scale).add(columns, ranges[:, ray])
            order = select(single, 20 + len(kept), keep=kept).order[0, len(kept) :]
            same += [frozenset(t) for t in Terms.parse(*theirs)] == [frozenset(terms.table[i]) for i in order]
        whole = float(np.median(times)) * 181
        print(
            f"{name}: {1e3 * np.median(times):.1f} ms a ray, {whole:.2f} s for 181: {whole / np.median(own):.0f} x ours; "
            f"the same 20 terms in the same order: {same} of {len(rays)} rays"
        )


def sysidentpy_order(columns: Signals, terms: Terms, y: np.ndarray, n_terms: int) -> list[str]:
    """Select with SysIdentPy's FROLS as it documents it, a fixed number of terms, without information criterion."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    X = np.column_stack(list(columns.values()))
    model = FROLS(
        order_selection=False,
        n_terms=n_terms,
        xlag=[[1]] * X.shape[1],  # it has no lag 0: the data are shifted by one sample instead
        ylag=1,
        basis_function=Polynomial(degree=3),
        estimator=LeastSquares(),
        err_tol=None,
        model_type="NFIR",
    )
    model.fit(X=np.r_[X, X[:1]], y=np.r_[y[:1], y][:, None])
    names = list(columns)
    return ["*".join(names[code // 1000 - 2] for code in row if code) or "1" for row in model.final_model]


def fastcan_order(columns: Signals, terms: Terms, y: np.ndarray, n_terms: int) -> list[str]:
    """Select with fastcan; it centres, so the constant is not among its columns."""
    from fastcan import FastCan

    phi = terms.matrix(columns)
    varying = np.flatnonzero(np.ptp(phi, axis=0) > 0)
    selector = FastCan(n_terms, verbose=0).fit(phi[:, varying], y[:, None])
    return [terms.names[i] for i in varying[selector.indices_]]


def streaming(n_poses: int) -> None:
    """Time moments and selection of 1,081 rays x n_poses in blocks that are made on the fly, and their memory."""
    rng = np.random.default_rng(FIRST_DATA_SEED)
    n_rays, block = 1081, 8192
    terms = polynomial(["x", "y", "c", "s"], 3)
    scale = Scale.between({"x": (0, 10), "y": (0, 8), "c": (-1, 1), "s": (-1, 1)})
    moments = Moments(terms, n_rays, scale=scale)
    mix = rng.normal(size=(n_rays, len(terms))).T
    making = adding = 0.0
    for start in range(0, n_poses, block):
        n = min(block, n_poses - start)
        clock = time.process_time()
        phi = rng.uniform(-np.pi, np.pi, n)
        columns = {"x": rng.uniform(0, 10, n), "y": rng.uniform(0, 8, n), "c": np.cos(phi), "s": np.sin(phi)}
        ranges = terms.matrix(columns, scale) @ mix
        ranges += 0.01 * rng.normal(size=n)[:, None]
        made = time.process_time()
        moments.add(columns, ranges)
        making, adding = making + made - clock, adding + time.process_time() - made
    chosen = fastest(lambda: select(moments, 20), 3)
    print(
        f"{n_rays} rays x {n_poses} poses, {len(terms)} terms: moments {adding:.2f} s, selection {1e3 * chosen:.0f} ms, "
        f"data made in {making:.2f} s, peak memory {peak_memory():.0f} MB"
    )


BENCHMARKS = {
    "structure": (structure, 100),
    "noise": (noise_orders, 100),
    "intervals": (intervals, 400),
    "alarms": (alarms, 400),
    "peers": (peers, 8),
    "streaming": (streaming, 1_000_000),
}


def main() -> None:
    """Read the command line."""
    parser = parser_of(__doc__)
    parser.add_argument("what", choices=BENCHMARKS)
    parser.add_argument("--n", type=int, help="seeds, rays of the peers, or poses")
    arguments = parser.parse_args()
    if os.environ.get("OPENBLAS_NUM_THREADS") != "1":
        parser.error("set OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 first: processor time counts every thread")
    run, n = BENCHMARKS[arguments.what]
    run(arguments.n or n)


if __name__ == "__main__":
    main()
