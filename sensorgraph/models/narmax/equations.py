"""One ray of the model `narmax` as text: its equation with lags, and the fitted terms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from robotmodic_ident import Scale, Terms, false_discoveries
from robotmodic_ident.notation.expand import expand
from robotmodic_ident.notation.printing import sum_text
from sensorgraph.models.narmax.candidates import NarmaxForm
from sensorgraph.models.narmax.parameters import FREE_RUN, ONE_STEP, START, NarmaxParameters
from sensorgraph.types import Floats

DIGITS = 8
"""Significant digits of a printed coefficient."""


def lagged_equation(ray: int, names: Sequence[str], theta: Floats, scale: Scale, noise: Floats) -> str:
    """Return the equation of a ray's reading in metres and radians: `r67(k) = ...`."""
    terms, values, _ = expand(Terms.parse(*names), theta, scale)
    text = f"r{ray}(k) = {sum_text(terms, values, digits=DIGITS)}"
    for lag, value in enumerate(noise.tolist(), 1):
        if value:
            text += f" {'-' if value < 0 else '+'} {abs(value):.{DIGITS}g}*e(k-{lag})"
    return text + " + e(k)"


def term_table(names: Sequence[str], theta: Floats, stderr: Floats, err: Floats) -> list[str]:
    """Return lines with each term's coefficient, standard error, 95 % interval and ERR."""
    lines = [f"{'term':<32}{'theta [m]':>14}{'stderr [m]':>13}{'95 % interval':>28}{'ERR':>14}"]
    for name, value, se, share in zip(names, theta.tolist(), stderr.tolist(), err.tolist(), strict=True):
        interval = f"{value - 1.96 * se:.5g} to {value + 1.96 * se:.5g}"
        shown = f"{share:>14.6e}" if np.isfinite(share) else f"{'':>14}"
        lines.append(f"{name:<32}{value:>14.6g}{se:>13.3g}{interval:>28}{shown}")
    return lines


def equation_text(model: NarmaxParameters, ray: int) -> str:
    """Return one ray's equation with lags in metres and radians, its tests, and the fitted terms as text."""
    kept = model.order[ray] >= 0
    if not kept.any():
        return f"ray {ray} never returned in {model.used['rows']} training scans with their lags: no equation"
    every = model.form.names(ray)
    names = [every[i] for i in model.order[ray, kept].tolist()]
    scale = model.scale_of_ray(ray)
    start = model.start_order[ray] >= 0
    noise = model.noise[ray]
    noise_names = [f"e(k-{lag})" for lag in range(1, len(noise) + 1) if noise[lag - 1]]
    nonzero = noise != 0
    bearing = np.degrees(model.sensor.bearings[ray])
    p = ["-" if value < 0 else f"{value:.3g}" for value in model.tests[ray]]
    scales = ", ".join(
        f"{v} -> ({v} - {c:.6g}) / {w:.6g}"
        for v, c, w in zip(model.scale.variables, model.scale.centres, model.scale.widths, strict=True)
    )
    return "\n".join(
        [
            f"ray {ray}, bearing {bearing:.2f} deg: {len(names)} terms and {len(noise_names)} noise terms on "
            f"{model.rows[ray]} scans; sigma {model.sigma[ONE_STEP, ray]:.4g} m one step ahead, "
            f"{model.sigma[FREE_RUN, ray]:.4g} m in free run, {model.sigma[START, ray]:.4g} m for a pose alone",
            lagged_equation(ray, names, model.theta[ray, kept], scale, noise)
            + "   [m; x, y in m, v in m/s, omega in rad/s; k counts scans]",
            "for a pose without history: "
            + lagged_equation(
                ray, [every[i] for i in model.start_order[ray, start].tolist()],
                model.start_theta[ray, start], scale, np.zeros(0),
            ),
            f"p-values of the residual: own past {p[0]}, v {p[1]}, omega {p[2]}; "
            f"probability of no return {model.memory[ray]:.3g} higher after a missing return",
            "",
            f"fitted terms, with {scales}, r -> (r - {model.readings.centre:.6g}) / {model.readings.width:.6g}:",
            *term_table(
                names + noise_names,
                np.r_[model.theta[ray, kept], noise[nonzero]],
                np.r_[model.stderr[ray, kept], model.noise_stderr[ray][nonzero]],
                np.r_[model.err[ray, kept], np.full(len(noise_names), np.nan)],
            ),
        ]
    )  # fmt: skip


def _signals_text(form: NarmaxForm) -> str:
    if not form.lags:
        return "pose and twist, without lags"
    return (
        f"poses at lags 0 to {form.lags} and twist, own reading and {form.neighbours} neighbours on each side "
        f"({form.spacing} rays apart) at lags 1 to {form.lags}"
    )


def summary_of(model: NarmaxParameters) -> Mapping[str, str]:
    """Return form, fitted scans, standard deviations, tests and support as label -> text."""
    terms, form, used = (model.order >= 0).sum(axis=1), model.form, model.used
    medians = [f"{np.median(model.sigma[kind]):.3g}" for kind in (ONE_STEP, FREE_RUN, START)]
    tested = model.tests[:, 0] >= 0
    alarms = false_discoveries(np.where(tested, model.tests[:, 0], np.nan)).sum()
    return {
        "form": f"degree {form.degree} in {_signals_text(form)}: {form.n_candidates} candidates, {terms.min()} to "
        f"{terms.max()} terms per ray, chosen by EBIC; noise terms on {int(model.noise.any(axis=1).sum())} rays",
        "scans": f"{used['rows']} of {used['scans']} fitted, stretches: {used['stretches']}; {used['dropped']} at the "
        "start of a stretch serve as lags only",
        "sigma": f"median {medians[0]} m one step ahead, {medians[1]} m in free run, {medians[2]} m for a pose alone",
        "residual": f"correlated in time on {int(alarms)} of {int(tested.sum())} tested rays (5 % false discoveries)",
        "support": f"{len(model.support.keys)} cells of {model.support.cell:g} m x "
        f"{360 / model.support.n_sectors:g} deg, leverage up to {model.leverage_limit:.3g}",
    }
