"""Cascaded tanks and Silverbox of nonlinearbenchmark.org: free run on the official test part, beside what others published.

    python -m benchmarks.nonlinear_benchmarks [FOLDER] [--only tanks|silverbox] [--picture tanks.png]

FOLDER holds `cascaded_tanks.csv` and `silverbox_SNLS80mV.csv.gz` (default ../shared/data/nonlinear-benchmarks). Both sets
go through `auto_fit` as it is: lags, degree, terms and limits are chosen on the training part alone. A test run starts
from the first 50 outputs and is scored after them, as the packages nonlinear_benchmarks and IdentiBench do.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.arguments import parser_of, timed
from robotmodic_ident import AutoFit, auto_fit

FOLDER = Path("../shared/data/nonlinear-benchmarks")
WARM_UP = 50
"""[samples] at the start of a test record whose outputs are given; they are not scored."""
Signals = dict[str, np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """One data set: its official parts, and what was published for its test records."""

    name: str
    train: Signals
    tests: Mapping[str, Signals]
    unit: str
    per_unit: float
    """Values of the file per unit that is printed."""
    published: Mapping[str, str]
    """Champneys, Beintema, Tóth, Schoukens, Rogers 2024 (arXiv 2405.10779), and IdentiBench for FROLS."""


def cascaded_tanks(folder: Path) -> Benchmark:
    """Read the tanks: 1,024 samples of 4 s to train, as many to test."""
    table = np.genfromtxt(folder / "cascaded_tanks.csv", delimiter=",", skip_header=1)
    return Benchmark(
        name="cascaded tanks",
        train={"u": table[:, 0], "y": table[:, 2]},
        tests={"test": {"u": table[:, 1], "y": table[:, 3]}},
        unit="V",
        per_unit=1.0,
        published={"test": "0.413 polynomial NARX, 0.396 GRU"},
    )


def silverbox(folder: Path) -> Benchmark:
    """Read Silverbox, cut as the official loader does: multisine to train, multisine and arrow to test."""
    table = np.genfromtxt(folder / "silverbox_SNLS80mV.csv.gz", delimiter=",", skip_header=1)[:, :2]

    def part(first: int, last: int) -> Signals:
        return {"u": table[first:last, 0].copy(), "y": table[first:last, 1].copy()}

    return Benchmark(
        name="Silverbox",
        train=part(40_650, 105_712),
        tests={
            "multisine": part(105_712, 127_400),
            "arrow": part(100, 40_575),
            "arrow, no extrapolation": part(100, 32_100),
        },
        unit="mV",
        per_unit=1e-3,
        published={
            "multisine": "1.49 best, 8.50 FROLS",
            "arrow": "2.38 best, 16.15 FROLS",
            "arrow, no extrapolation": "0.95 best, 7.54 FROLS",
        },
    )


def free_run(found: AutoFit, record: Signals) -> np.ndarray:
    """Run free over a test record, of whose outputs only the first WARM_UP are looked at."""
    known = np.full(len(record["y"]), np.nan)
    known[:WARM_UP] = record["y"][:WARM_UP]
    return found.model.predict_mpo({**record, "y": known}, warm_up=WARM_UP)


def run(benchmark: Benchmark) -> AutoFit:
    """Identify on the training part, then print the row of every test record, and the model."""
    with timed() as took:
        found = auto_fit(benchmark.train, "y", ["u"])
    for name, record in benchmark.tests.items():
        error = (record["y"] - free_run(found, record))[WARM_UP:]
        rmse = float(np.sqrt(np.mean(error**2))) / benchmark.per_unit
        print(
            f"{benchmark.name + ', ' + name:<36}{rmse:>8.3f} {benchmark.unit:<4}{benchmark.published[name]:<36}"
            f"{len(found.model.terms):>6}{found.chosen.order:>7}{found.chosen.degree:>8}{took.cpu:>9.0f} s"
        )
    return found


def describe(found: AutoFit) -> None:
    """Print what was tried, and the terms with their intervals."""
    for trial in found.trials:
        print(
            f"    order {trial.order}, degree {trial.degree}, limits {trial.limits}: {trial.n_terms} of "
            f"{trial.n_candidates} terms, RMSE on what was hidden {trial.rmse:.4g}"
        )
    model = found.model
    print(f"    {model.equation()}")
    for name, theta, stderr in zip(model.terms.names, model.theta, model.stderr, strict=True):
        print(f"    {name:<24}{theta:>14.6g}  95 % ± {1.96 * stderr:.2g}")


def draw(found: AutoFit, benchmark: Benchmark, path: Path) -> None:
    """Draw the test record, measured and run free, and what is left."""
    from matplotlib import pyplot as plt

    (record,) = benchmark.tests.values()
    predicted = free_run(found, record)
    figure, (above, below) = plt.subplots(
        2, 1, figsize=(10, 5), sharex=True, height_ratios=[3, 1], layout="constrained"
    )
    above.plot(record["y"], color="0.1", lw=1.5, label="measured")
    above.plot(predicted, color="#0b7a75", lw=1.2, label="free run from the first 50 samples")
    above.axvspan(0, WARM_UP, color="0.9", lw=0)
    above.set_ylabel("water level [V]")
    above.legend(frameon=False, loc="upper right", ncols=2)
    above.set_ylim(top=11.5)
    below.axhline(0, color="0.7", lw=0.8)
    below.plot(record["y"] - predicted, color="#b3361b", lw=1.0)
    below.set_ylabel("residual [V]")
    below.set_xlabel("sample (4 s)")
    below.margins(x=0.01)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    """Read the command line and print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("folder", nargs="?", type=Path, default=FOLDER)
    parser.add_argument("--only", choices=("tanks", "silverbox"))
    parser.add_argument("--picture", type=Path, help="of the tanks")
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    sets = {"tanks": cascaded_tanks, "silverbox": silverbox}
    print(f"{'set':<36}{'ours':>8}     {'published':<36}{'terms':>6}{'order':>7}{'degree':>8}{'CPU':>9}")
    for name in [arguments.only] if arguments.only else list(sets):
        benchmark = sets[name](arguments.folder)
        found = run(benchmark)
        describe(found)
        if name == "tanks" and arguments.picture:
            draw(found, benchmark, arguments.picture)


if __name__ == "__main__":
    main()
