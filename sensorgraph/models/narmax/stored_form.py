"""Checks of the options and of the stored arrays of the model `narmax`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from logs.run import RangeSensor
from robotmodic_ident import Scale
from sensorgraph.errors import SensorgraphError
from sensorgraph.models.narmax.candidates import NarmaxForm, ReadingScale, form_from
from sensorgraph.models.narmax.settings import NARMAX
from sensorgraph.models.polynomial.complexity import Auto
from sensorgraph.models.polynomial.stored_form import check_order, check_scale
from sensorgraph.models.polynomial.support import QUANTILES, Support
from sensorgraph.models.residual_memory import MAX_MEMORY
from sensorgraph.models.stored_numbers import check_range, check_shape
from sensorgraph.types import Ints

OPTIONS = dict.fromkeys(("lags", "degree", "neighbours", "noise_lags", "n_terms"), Auto)
ARRAYS = (
    "order", "err", "theta", "stderr", "noise", "noise_stderr", "tests", "rows", "start_order", "start_theta",
    "theta_none", "memory", "sigma", "spread", "root",
)  # fmt: skip
_WHOLE = ("order", "rows", "start_order")


def restored(
    sensor: RangeSensor, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
) -> dict[str, Any]:
    """Check the output of `state` and return the parameters of the model by name.

    Raises
    ------
    ValueError : An array has a wrong shape or an invalid term index.
    """
    form = check_form(form_from(header["form"]))
    q, k, s = sensor.n_rays, arrays["order"].shape[-1], arrays["start_order"].shape[-1]
    m, static, lags = len(form.shared), len(form.static), form.noise_lags
    shapes = (
        (q, k), (q, k), (q, k), (q, k), (q, lags), (q, lags), (q, 3), (q,), (q, s), (q, s), (q, static), (q,),
        (3, q), (3, q, len(QUANTILES)), (static, static),
    )  # fmt: skip
    for name, shape in zip(ARRAYS, shapes, strict=True):
        check_shape(name, arrays[name], shape, "iu" if name in _WHOLE else "f")
    check_order(arrays["order"], m + len(form.readings))
    check_order(arrays["start_order"], m)
    if not np.isin(arrays["start_order"], np.r_[-1, form.static]).all():
        raise ValueError("start_order holds terms with lags, expected terms of the pose alone")
    _check_neighbours(form, arrays["order"], m)
    for name in ("rows", "sigma", "spread"):
        check_range(name, arrays[name], 0)
    check_range("memory", arrays["memory"], 0, MAX_MEMORY)
    check_range("tests", arrays["tests"], -1, 1)
    scale = Scale.from_dict(header["scale"])
    check_scale(scale, form.degree)
    centre, width = map(float, header["readings"])
    check_range("the width of the readings", width, 1e-6)
    return dict(
        sensor=sensor, form=form, scale=scale, readings=ReadingScale(centre=centre, width=width),
        leverage_limit=float(header["leverage_limit"]), support=Support.restore(header["support"], arrays),
        used={name: int(header["used"][name]) for name in ("scans", "rows", "dropped", "stretches")},
        **{name: arrays[name] for name in ARRAYS},
    )  # fmt: skip


def form_of(options: Mapping[str, Any]) -> NarmaxForm:
    """Return the form that the options define.

    Raises
    ------
    SensorgraphError : An option is out of range.
    """
    chosen = {name: options.get(name, "auto") for name in OPTIONS}
    default = {name: getattr(NARMAX, name) for name in OPTIONS}
    form = NarmaxForm(spacing=1, **{name: default[name] if v == "auto" else v for name, v in chosen.items()})
    try:
        return check_form(form)
    except ValueError as exc:
        raise SensorgraphError(str(exc)) from exc


def check_form(form: NarmaxForm) -> NarmaxForm:
    """Check that a form is valid and small enough to be fitted.

    Raises
    ------
    ValueError : A number is out of range.
    """
    check_range("lags", form.lags, 0, NARMAX.max_lags)
    check_range("degree", form.degree, 0, 20)
    check_range("terms", form.n_terms, 1, NARMAX.max_candidates)
    check_range("neighbours", form.neighbours, 0, 100)
    check_range("spacing", form.spacing, 1, NARMAX.max_spacing)
    check_range("noise_lags", form.noise_lags, 0, NARMAX.max_lags)
    if (count := form.n_shared) > NARMAX.max_candidates:
        raise ValueError(
            f"degree {form.degree} and {form.lags} lags make {count} candidates, expected at most {NARMAX.max_candidates}; "
            "specify fewer lags or a lower degree"
        )
    return form


def _check_neighbours(form: NarmaxForm, order: Ints, m: int) -> None:
    """Check that no ray uses a neighbour beyond the ends of the scan.

    Raises
    ------
    ValueError : A neighbour does not exist.
    """
    for ray, j in zip(*np.nonzero(order >= m), strict=True):
        if not 0 <= ray + form.readings[int(order[ray, j]) - m][0] < len(order):
            raise ValueError(f"ray {ray} reads a neighbour that does not exist")
