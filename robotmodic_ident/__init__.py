"""Identify polynomial, ARMAX and NARMAX models from data; the package is independent of robots.

`fit(records, output, terms)` selects terms, estimates their coefficients and returns a `Narmax`. `validate` tests its
residuals, and `scores` compares its predictions with persistence. `robotmodic_ident.analysis` computes slopes, Sobol
indices, frequency responses and Lyapunov exponents. `robotmodic_ident.export` writes C and LaTeX. Heavy libraries are
imported when a name is first used.

* `terms`, `basis_functions`, `bases/`: Candidate terms, which are products of lagged signals, and families of them.
* `records`, `scale`, `moments`: The data, that is signals over time, their scaling and the sums for a fit.
* `selection/`: Selection of the terms and of the model size.
* `estimation/`: Estimation of coefficients beyond least squares.
* `fitting`, `automatic`: `fit` combines selection and estimation; `auto_fit` also selects lags and degree.
* `model`, `prediction/`, `notation/`, `export`: The model, its predictions, its text form and its files.
* `validation/`, `analysis/`: Residual tests and scores; analysis of a model.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from robotmodic_ident.automatic import AutoFit, auto_fit
    from robotmodic_ident.bases import BASES, bspline, chebyshev, fourier, legendre, polynomial, wavelet
    from robotmodic_ident.errors import IdentError
    from robotmodic_ident.fitting import fit
    from robotmodic_ident.model import Narmax
    from robotmodic_ident.moments import Moments
    from robotmodic_ident.records import LaggedData, Record, blocks, halves, lagged, lags
    from robotmodic_ident.scale import Scale
    from robotmodic_ident.selection.candidates import output_limits
    from robotmodic_ident.selection.exact_dependence import Dependence, independent
    from robotmodic_ident.selection.select import Selection, select
    from robotmodic_ident.terms import Terms
    from robotmodic_ident.trials import AutoSettings
    from robotmodic_ident.validation.residual_tests import ResidualTest, false_discoveries, validate
    from robotmodic_ident.validation.score import (
        Extrapolation,
        HorizonScore,
        Score,
        extrapolation,
        score,
        scores,
    )

__all__ = [
    "BASES",
    "AutoFit",
    "AutoSettings",
    "Dependence",
    "Extrapolation",
    "HorizonScore",
    "IdentError",
    "LaggedData",
    "Moments",
    "Narmax",
    "Record",
    "ResidualTest",
    "Scale",
    "Score",
    "Selection",
    "Terms",
    "auto_fit",
    "blocks",
    "bspline",
    "chebyshev",
    "extrapolation",
    "false_discoveries",
    "fit",
    "fourier",
    "halves",
    "independent",
    "lagged",
    "lags",
    "legendre",
    "output_limits",
    "polynomial",
    "score",
    "scores",
    "select",
    "validate",
    "wavelet",
]

_MODULES = {
    "automatic": "AutoFit auto_fit",
    "bases": "BASES bspline chebyshev fourier legendre polynomial wavelet",
    "errors": "IdentError",
    "fitting": "fit",
    "model": "Narmax",
    "moments": "Moments",
    "records": "LaggedData Record blocks halves lagged lags",
    "scale": "Scale",
    "selection.candidates": "output_limits",
    "selection.exact_dependence": "Dependence independent",
    "selection.select": "Selection select",
    "terms": "Terms",
    "trials": "AutoSettings",
    "validation.residual_tests": "ResidualTest false_discoveries validate",
    "validation.score": "Extrapolation HorizonScore Score extrapolation score scores",
}
"""Module -> its public names."""


def __getattr__(name: str) -> Any:
    """Import a public name from its module on first use."""
    module = next((module for module, names in _MODULES.items() if name in names.split()), None)
    if module is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(import_module(f"{__name__}.{module}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
