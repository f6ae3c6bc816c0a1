"""Draw identified models: the measured and predicted series, the residual tests, the surface."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from robotmodic_ident import Narmax
from robotmodic_ident.analysis import sobol, surface
from robotmodic_ident.errors import IdentError
from robotmodic_ident.records import lagged
from robotmodic_ident.scale import size_of
from sensorgraph.identification.identify import IdentifiedSignal
from sensorgraph.show.figures.style import (
    ALARM,
    FINE,
    INK,
    SMALL,
    SOFT,
    SOLID,
    TEAL,
    TEXT,
    TINY,
    colour_bar,
    new_figure,
    reduce_frame,
    save_figure,
)
from sensorgraph.types import Floats

MAX_SAMPLES = 400
"""Maximum number of samples of the series that is drawn."""
MAX_LAGS = 25


def identified_picture(found: IdentifiedSignal, path: Path) -> None:
    """Draw a model: the held-out series, the autocorrelation of the residual, the tests, and the surface."""
    figure = new_figure(10.5, 6.2)
    top, bottom = figure.subfigures(2, 1, height_ratios=[1.15, 1.0])
    series(top.subplots(), found)
    left, middle, right = bottom.subplots(1, 3)
    _scatter(left, found)
    _correlation(middle, found)
    _surface(figure, right, found)
    equation = found.model.equation(digits=3)
    figure.suptitle(
        equation if len(equation) < 130 else f"{equation[:127]}…", x=0.012, ha="left", fontsize=9.5, color=INK
    )
    save_figure(figure, path)


def series(axes: Any, found: IdentifiedSignal, *, most: int = MAX_SAMPLES, unit: str = "") -> None:
    """Draw the longest held-out record: measured, one step ahead and, if it differs, free run."""
    i = int(np.argmax([len(m) for m in found.measured]))
    shown = slice(0, most)
    when = np.arange(len(found.measured[i]), dtype=np.float64) * (found.data.period or 1.0)
    axes.plot(when[shown], found.measured[i][shown], color=INK, lw=1.4, label="measured")
    one = found.scores["one_step"]
    is_dynamic = found.free_run is not found.one_step
    label = "one step ahead" if is_dynamic else "predicted"
    axes.plot(
        when[shown],
        found.one_step[i][shown],
        color=TEAL,
        lw=1.2,
        label=_label(label, one.r, one.r_low, one.r_high),
    )
    if is_dynamic:
        free = found.scores["free_run"]
        axes.plot(
            when[shown], found.free_run[i][shown], color=ALARM, lw=1.0, ls=(0, (4, 2)),
            label=_label("free run", free.r, free.r_low, free.r_high),
        )  # fmt: skip
    axes.set_xlabel("time [s]" if found.data.period else "sample", color=INK, fontsize=TEXT)
    axes.set_ylabel(f"{found.question.output}{f' [{unit}]' if unit else ''}", color=INK)
    axes.grid(color=SOLID, lw=FINE)
    axes.legend(
        loc="lower left", bbox_to_anchor=(0, 1), ncols=3, frameon=False, fontsize=SMALL, labelcolor=INK
    )
    axes.margins(x=0.01)
    reduce_frame(axes)


def _label(text: str, r: float, low: float, high: float) -> str:
    return f"{text}: r = {r:.3f} ({low:.3f} to {high:.3f})" if np.isfinite(r) else text


def _scatter(axes: Any, found: IdentifiedSignal) -> None:
    x, y = (np.concatenate(part) for part in (found.measured, found.free_run))
    ok = np.isfinite(x) & np.isfinite(y)
    step = max(1, int(ok.sum()) // 2000)
    x, y = x[ok][::step], y[ok][::step]
    if len(x):
        ends = [float(min(x.min(), y.min())), float(max(x.max(), y.max()))]
        axes.plot(ends, ends, color=SOFT, lw=0.8)
    axes.plot(x, y, ".", ms=3, color=TEAL, alpha=0.4, mew=0)
    axes.set_xlabel(f"measured {found.question.output}", color=INK, fontsize=TEXT)
    axes.set_ylabel(
        "free run" if found.free_run is not found.one_step else "predicted", color=INK, fontsize=TEXT
    )
    reduce_frame(axes)


def _correlation(axes: Any, found: IdentifiedSignal) -> None:
    """Draw the autocorrelation of the one-step residual with its 95 % band, and the p-values of the tests."""
    total, n = np.zeros(MAX_LAGS + 1), 0
    pieces = [
        (m - p)[np.isfinite(m) & np.isfinite(p)] for m, p in zip(found.measured, found.one_step, strict=True)
    ]
    unit = size_of(*pieces)
    for piece in pieces:
        e = piece / unit
        e = e - e.mean() if len(e) else e
        n += len(e)
        for lag in range(min(MAX_LAGS + 1, len(e))):
            total[lag] += float(e[lag:] @ e[: len(e) - lag])
    rho = total / total[0] if total[0] > 0 else total
    bound = 1.96 / np.sqrt(max(n, 1))
    axes.axhspan(-bound, bound, color=SOLID, zorder=0, linewidth=0)
    axes.vlines(np.arange(1, MAX_LAGS + 1), 0, rho[1:], color=TEAL, lw=2)
    axes.axhline(0, color=SOFT, lw=0.8)
    axes.set(ylim=(-1.05, 1.05))
    axes.set_xlabel("lag [samples]", color=INK, fontsize=TEXT)
    axes.set_ylabel("autocorrelation of the residual", color=INK, fontsize=TEXT)
    lines = [f"{t['test']}: p {_p(t['p_value'])}" for t in found.validation[:8]]
    axes.text(
        0.98, 0.98, "\n".join(lines), transform=axes.transAxes, ha="right", va="top", fontsize=TINY, color=INK
    )
    reduce_frame(axes)


def _p(value: float | None) -> str:
    return "–" if value is None else ("< 0.001" if value < 0.001 else f"= {value:.3f}")


def _surface(figure: Any, axes: Any, found: IdentifiedSignal) -> None:
    """Draw the output over the two signals of largest influence, with the others at their medians."""
    try:
        columns = lagged(found.test, found.model.terms, [found.model.output]).columns
        surface_map(figure, axes, found.model, columns)
    except (IdentError, ValueError):  # fewer than two signals, or a basis without a closed form
        axes.set_axis_off()


def surface_map(figure: Any, axes: Any, model: Narmax, columns: dict[str, Floats]) -> None:
    """Draw a model over its two signals of largest total Sobol index, and the data points.

    The colours span the output at the data points; grey marks values outside, where the model extrapolates.
    """
    from matplotlib import colormaps
    from matplotlib.ticker import MaxNLocator

    shares = sobol(model, columns).total
    a, b = sorted(shares, key=lambda s: -shares[s])[:2]
    grid = [np.linspace(float(columns[s].min()), float(columns[s].max()), 60) for s in (a, b)]
    at = {s: float(np.median(values)) for s, values in columns.items() if s not in (a, b)}
    z = surface(model, (a, grid[0]), (b, grid[1]), at)
    seen = model.terms.matrix(columns, model.scale) @ model.theta
    low, high = np.quantile(seen, [0.01, 0.99]).tolist()
    room = 0.1 * (high - low) or 1.0
    levels = MaxNLocator(14).tick_values(low - room, high + room)
    colours = colormaps["viridis"].with_extremes(under=SOLID, over=SOLID)
    mesh = axes.contourf(grid[0], grid[1], z, levels=levels, cmap=colours, extend="both")
    step = max(1, len(columns[a]) // 600)
    axes.plot(columns[a][::step], columns[b][::step], ".", ms=2, color="white", alpha=0.7, mew=0)
    axes.set_xlabel(a, color=INK, fontsize=TEXT)
    axes.set_ylabel(b, color=INK, fontsize=TEXT)
    colour_bar(figure, mesh, axes, model.output)
    reduce_frame(axes)
