"""Compare the selected model with alternatives over whole records: linear models, friction, unsigned outputs."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from robotmodic_ident.errors import IdentError
from robotmodic_ident.estimation.prediction_error import LevenbergMarquardt
from robotmodic_ident.fitting import fit, refined
from robotmodic_ident.model import Narmax
from robotmodic_ident.prediction.recursion import UNLIMITED
from robotmodic_ident.records import Record, cut
from robotmodic_ident.selection.candidates import dictionary
from robotmodic_ident.selection.hidden_stretches import whole_mean_square
from robotmodic_ident.selection.readable_forms import friction_models, magnitude_models
from robotmodic_ident.trials import AutoSettings, Trial


def over_whole_records(
    model: Narmax, best: Trial, trials: Sequence[Trial], records: Sequence[Record], settings: AutoSettings
) -> tuple[Narmax, Trial]:
    """Return the model, or an alternative with a far smaller free-run error over whole records.

    A search on pieces of a long record does not measure the drift of a free run over the whole record, which is large
    for an integrating output. Friction and unsigned outputs cannot be described by polynomials.
    """

    def error(one: Narmax) -> float:
        return whole_mean_square(one, records, settings.warm_up)

    found = [(error(one), one, trial) for trial in trials for one in trial.found]
    if not found:
        return model, best
    worth = min(found, key=lambda one: one[0])[0] * (1.0 + settings.max_whole_loss) ** 2
    least, other, trial = min(
        (one for one in found if one[0] <= worth), key=lambda one: len(one[1].terms), default=found[0]
    )
    if not least < (1.0 - settings.min_whole_gain) ** 2 * error(model):
        return model, best
    kept = other
    if not other.is_magnitude:
        descended = refined(other, records, "simulation", "hac")
        stay = LevenbergMarquardt(max_steps=0)
        kept = descended if error(descended) < least else refined(other, records, "simulation", "hac", stay)
    note = f"this model has the least free-run error over whole records: order {trial.order}, degree {trial.degree}"
    return replace(kept, notes=(*kept.notes, note), stop="cv"), replace(trial, rmse=float(np.sqrt(least)))


def unexplained(model: Narmax, records: Sequence[Record], settings: AutoSettings) -> float:
    """Return the free-run RMSE over whole records divided by the standard deviation of the output."""
    spread = np.nanstd(np.concatenate([record.signals[model.output] for record in records]))
    return float(np.sqrt(whole_mean_square(model, records, settings.warm_up)) / max(spread, 1e-300))


def linear_trial(
    records: Sequence[Record], best: Trial, inputs: Sequence[str], settings: AutoSettings
) -> Trial:
    """Return linear models estimated in free run over one long section at the start of every record."""
    heads = _heads(records, 2 * settings.max_rows)
    output = best.found[0].output
    found = []
    for order in dict.fromkeys((settings.orders[0], best.order)):
        terms = dictionary(output, inputs, order, 1, settings.max_product_lag)
        with suppress(IdentError):
            found.append(
                fit(
                    heads,
                    output,
                    terms,
                    n_terms=len(terms),
                    search="forward",
                    estimator="simulation",
                    limits=best.limits,
                )
            )
    return replace(
        best, degree=1, n_candidates=len(terms), n_terms=len(terms), rmse=float("nan"), found=tuple(found)
    )


def other_forms(
    records: Sequence[Record], best: Trial, inputs: Sequence[str], settings: AutoSettings
) -> list[Trial]:
    """Return linear models with dry friction, and linear models of a signed output with measured magnitude."""
    output, out = best.found[0].output, []
    heads = _heads(records, settings.max_friction_rows)
    order = settings.orders[0]
    found = {order: friction_models(heads, output, inputs, order, best.limits)}
    if (
        best.limits[1] == UNLIMITED[1]
    ):  # a magnitude often rests at its minimum 0, so only the upper limit counts
        heads = _heads(records, 2 * settings.max_rows)
        for order in (order for order in settings.orders if order <= settings.max_magnitude_order):
            found[order] = [*found.get(order, []), *magnitude_models(heads, output, inputs, order)]
    for order, models in found.items():
        out += [replace(best, order=order, degree=1, n_terms=len(m.terms), found=(m,)) for m in models]
    return out


def _heads(records: Sequence[Record], n: int) -> list[Record]:
    """Return the start of every record, about n samples in total."""
    share = n / sum(map(len, records))
    return [cut(record, slice(0, int(share * len(record)) + 1)) for record in records]
