"""A real wall follower as a polynomial: the SCITOS G5 of Freire, Veloso and Barreto (LARS 2009), UCI data set 194.

    python -m benchmarks.wall_following_uci ../shared/data/uci-wall-following

24 ultrasound readings at 9 Hz and one of four motor classes, 5,456 samples in time order. The classes become turn
rates in units of the sharp turn: forward 0, slight left +0.5, slight right -0.5, sharp right -1. (Descriptions of the
set swap the names of three classes; the encoding follows the names in the file.) Ten contiguous blocks are held out
in turn, with a second at each border left out of the training. Scores are of all ten together; a class is the
nearest of the four rates, and no prediction leaves their range. The nearest-neighbour classifier is the black box that a polynomial has to stand beside.
"""

from __future__ import annotations

import gzip
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.arguments import parser_of
from planners.types import Floats
from robotmodic_ident import Narmax, Record, Terms, fit, lags, polynomial
from sensorgraph.identification.identify import score

TURN_OF_CLASS = {
    "Move-Forward": 0.0,
    "Slight-Left-Turn": 0.5,
    "Slight-Right-Turn": -0.5,
    "Sharp-Right-Turn": -1.0,
}
FOLDS = 10
BORDER_SAMPLES = 9  # samples, one second
SECTOR_HALF_WIDTH = 2  # sonars to each side of a sector's middle
N_NEIGHBOURS = 5
SONARS = [f"S{i + 1}" for i in range(24)]
SECTOR_MIDDLES = {"M1": 0, "M7": 6, "M13": 12, "M19": 18}
"""Least reading of the five sonars about S1, S7, S13, S19: four ways, a quarter turn apart."""

Blocks = Sequence[tuple[list[Record], Record]]
Predict = Callable[[list[Record], Record], Floats]


def read(folder: Path) -> Record:
    """Return sonars, sector minima and turn rates, in time order."""
    lines = gzip.decompress((folder / "sensor_readings_24.data.gz").read_bytes()).decode().splitlines()
    rows = [line.split(",") for line in lines if line and not line.startswith("S1,")]
    sonar = np.array([[float(cell) for cell in row[:24]] for row in rows])
    signals = dict(zip(SONARS, sonar.T, strict=True))
    for name, middle in SECTOR_MIDDLES.items():
        around = [(middle + i) % 24 for i in range(-SECTOR_HALF_WIDTH, SECTOR_HALF_WIDTH + 1)]
        signals[name] = sonar[:, around].min(axis=1)
    return Record(signals={**signals, "turn": np.array([TURN_OF_CLASS[row[24].strip()] for row in rows])})


def part(record: Record, start: int, stop: int) -> Record:
    """Cut a stretch out."""
    return Record(signals={name: values[start:stop] for name, values in record.signals.items()})


def blocks(record: Record) -> Blocks:
    """Return ten pairs of training records and the block held out between them."""
    edges = np.linspace(0, len(record), FOLDS + 1).astype(int).tolist()
    out = []
    for a, b in pairwise(edges):
        around = [
            part(record, 0, max(a - BORDER_SAMPLES, 0)),
            part(record, min(b + BORDER_SAMPLES, len(record)), len(record)),
        ]
        out.append(([r for r in around if len(r)], part(record, a, b)))
    return out


def polynomials(terms: Terms, kept: list[Narmax], *, free: bool = False) -> Predict:
    """Fit the polynomial; in free run its own last rate stands for the measured one."""

    def predict(train: list[Record], test: Record) -> Floats:
        kept.append(fit(train, "turn", terms, search="forward", criterion="ebic"))
        return kept[-1].predict_mpo(test) if free else kept[-1].predict_osa(test)

    return predict


def nearest(train: list[Record], test: Record, names: Sequence[str]) -> Floats:
    """Let the five nearest of all training readings vote."""
    known, asked = (
        np.column_stack([np.concatenate([r.signals[s] for r in rs]) for s in names]) for rs in (train, [test])
    )
    turn = np.concatenate([r.signals["turn"] for r in train])
    votes = turn[cKDTree(known).query(asked, k=N_NEIGHBOURS)[1]]
    rates = np.array(list(TURN_OF_CLASS.values()))
    return np.asarray(rates[(votes[:, :, None] == rates).sum(axis=1).argmax(axis=1)])


def constant(train: list[Record], test: Record) -> Floats:
    """Say the mean of the training."""
    return np.full(len(test), np.concatenate([r.signals["turn"] for r in train]).mean())


def persistence(train: list[Record], test: Record) -> Floats:
    """Say the last measured rate again."""
    return np.concatenate([[np.nan], test.signals["turn"][:-1]])


def classes(turn: Floats) -> Floats:
    """Return the nearest of the four rates."""
    rates = np.array(list(TURN_OF_CLASS.values()))
    return np.asarray(rates[np.abs(turn[:, None] - rates).argmin(axis=1)])


def row(label: str, folds: Blocks, predict: Predict, size: str = "–") -> str:
    """Return one line of the table."""
    measured = [test.signals["turn"] for _, test in folds]
    said = [
        np.clip(predict(train, test), min(TURN_OF_CLASS.values()), max(TURN_OF_CLASS.values()))
        for train, test in folds
    ]
    s = score(measured, said)
    x, y = np.concatenate(measured), np.concatenate(said)
    right = classes(y[np.isfinite(y)]) == x[np.isfinite(y)]
    each = [right[x[np.isfinite(y)] == rate].mean() for rate in TURN_OF_CLASS.values()]
    r = f"{s.r:.3f} ({s.r_low:.3f} to {s.r_high:.3f})" if np.isfinite(s.r) else "–"
    return f"| {label} | {size} | {s.rmse:.3f} | {r} | {right.mean():.1%} | {np.mean(each):.1%} |"


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path)
    record = read(parser.parse_args().folder)
    folds = blocks(record)
    now = [f"{s}(k)" for s in SONARS]
    sectors = [f"{s}(k)" for s in SECTOR_MIDDLES]
    forms = {
        "24 sonars, degree 1": (polynomial(now, 1), False),
        "24 sonars, degree 2": (polynomial(now, 2), False),
        "4 sector minima, degree 3": (polynomial(sectors, 3), False),
        "4 sector minima, degree 5": (polynomial(sectors, 5), False),
        "4 sector minima and the last turn, degree 3": (
            polynomial([*sectors, *lags("turn", 1, 1)], 3),
            False,
        ),
        "the same in free run": (polynomial([*sectors, *lags("turn", 1, 1)], 3), True),
    }
    print(
        "| predictor | terms | RMSE | r (95 %) | right class | mean over classes |\n|---|---:|---:|---|---:|---:|"
    )
    print(row("constant", folds, constant))
    print(row("persistence: the last turn again", folds, persistence))
    for label, (terms, free) in forms.items():
        kept: list[Narmax] = []
        line = row(f"polynomial: {label}", folds, polynomials(terms, kept, free=free), "SIZE")
        print(line.replace("SIZE", f"{np.median([len(m.terms) for m in kept]):.0f} of {len(terms)}"))
    for label, names in (("24 sonars", SONARS), ("4 sector minima", list(SECTOR_MIDDLES))):
        print(row(f"{N_NEIGHBOURS} nearest neighbours, {label}", folds, partial(nearest, names=names)))
    print(
        f"\n```\n{fit(record, 'turn', polynomial(sectors, 3), criterion='ebic', n_terms=8).equation(digits=3)}\n```"
    )


if __name__ == "__main__":
    main()
