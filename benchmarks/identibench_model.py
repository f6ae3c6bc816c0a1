"""`auto_fit` as a model of IdentiBench, which downloads its data sets and scores free runs; it is no dependency of ours.

    pip install identibench
    python -m benchmarks.identibench_model Tanks_Sim Silverbox_Sim

or, in Python, `identibench.run_benchmark(spec, build_model=build_model)`. Training and validation parts are both
training data here: `auto_fit` leaves out stretches of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Protocol

import numpy as np

from benchmarks.arguments import parser_of
from robotmodic_ident import AutoFit, AutoSettings, auto_fit
from robotmodic_ident.trials import AUTO


class Context(Protocol):
    """What is used of IdentiBench's TrainingContext: sequences (u (n, n_inputs), y (n, n_outputs), attributes)."""

    def get_train_sequences(self) -> Iterable[tuple[np.ndarray, np.ndarray, Any]]: ...

    def get_valid_sequences(self) -> Iterable[tuple[np.ndarray, np.ndarray, Any]]: ...


def build_model(context: Context, settings: AutoSettings = AUTO) -> Callable[..., np.ndarray]:
    """Identify every output by itself; return a predictor (u, y_init, attributes) -> (len(u), n_outputs)."""
    records = [
        {**columns("u", u), **columns("y", y)}
        for u, y, *_ in (*context.get_train_sequences(), *context.get_valid_sequences())
    ]
    inputs = sorted(name for name in records[0] if name.startswith("u"))
    outputs = sorted(name for name in records[0] if name.startswith("y"))
    found: list[AutoFit] = [auto_fit(records, output, inputs, settings=settings) for output in outputs]

    def predict(u: np.ndarray, y_init: np.ndarray, *_: Any) -> np.ndarray:
        known = np.full((len(u), len(outputs)), np.nan)
        known[: len(y_init)] = np.reshape(y_init, (-1, len(outputs)))
        record = {**columns("u", u), **columns("y", known)}
        return np.column_stack([one.model.predict_mpo(record, warm_up=len(y_init)) for one in found])

    return predict


def columns(letter: str, values: np.ndarray) -> dict[str, np.ndarray]:
    """Name the columns of (n, n_signals), or (n,) of one, `u0`, `u1`, ...; two digits where there are many."""
    table = np.asarray(values, dtype=np.float64)
    table = table[:, None] if table.ndim == 1 else table
    digits = len(str(table.shape[1] - 1))
    return {f"{letter}{i:0{digits}d}": table[:, i] for i in range(table.shape[1])}


def main() -> None:
    """Run the benchmarks that are named."""
    parser = parser_of(__doc__)
    parser.add_argument("names", nargs="+", help="keys of identibench.simulation_benchmarks")
    import identibench

    for name in parser.parse_args().names:
        result = identibench.run_benchmark(identibench.simulation_benchmarks[name], build_model=build_model)
        print(name, result["metric_name"], result["metric_score"], result["test_sets"])


if __name__ == "__main__":
    main()
