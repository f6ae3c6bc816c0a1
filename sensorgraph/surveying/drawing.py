"""Pictures of fleet.html as SVG: trends with standard errors, and maps of changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sensorgraph.surveying.building import CELL
from sensorgraph.surveying.quantities import Label
from sensorgraph.types import Floats

WIDTH, HEIGHT, LEFT, BOTTOM, TOP = 400.0, 150.0, 46.0, 20.0, 8.0
MAP_WIDTH = 900.0
INK, SOFT, CALM, ALARM, NEW, GONE = "#23262f", "#6d7282", "#2a788e", "#d1345b", "#e07b00", "#1f5fc4"


def trend(points: Sequence[tuple[float, float, float, str]], changes: Sequence[float], label: Label) -> str:
    """Draw values with standard errors over the logs, in their order, and lines at changes.

    Parameters
    ----------
    points : Time [s], value, standard error and day of each log, increasing in time.
    changes : Times [s] of the first logs after a change.
    """
    values = np.array([one[1] - label.neutral for one in points]) * label.factor
    sigmas = np.array([one[2] for one in points]) * label.factor
    low, high = _extent(values, sigmas)
    pad = 0.1 * max(high - low, 1e-9)
    low, high = low - pad, high + pad
    n = len(points)

    def x(k: float) -> float:
        return LEFT + (k + 0.5) / n * (WIDTH - LEFT - 6)

    def y(value: float) -> float:
        return TOP + (high - min(max(value, low), high)) / (high - low) * (HEIGHT - TOP - BOTTOM)

    parts = []
    for tick in _ticks(low, high):
        parts.append(
            f'<line x1="{LEFT}" x2="{WIDTH}" y1="{y(tick):.1f}" y2="{y(tick):.1f}" stroke="#e3e6ec"/>'
            f'<text x="{LEFT - 5}" y="{y(tick) + 3.5:.1f}" text-anchor="end">{tick:g}</text>'
        )
    for t in changes:
        k = next((k for k, one in enumerate(points) if one[0] >= t), 0)
        at = x(k - 0.5)
        parts.append(
            f'<line x1="{at:.1f}" x2="{at:.1f}" y1="{TOP}" y2="{HEIGHT - BOTTOM}" stroke="{ALARM}" stroke-dasharray="4 3"/>'
        )
    for k, (value, sigma) in enumerate(zip(values, sigmas, strict=True)):
        parts.append(
            f'<line x1="{x(k):.1f}" x2="{x(k):.1f}" y1="{y(value - sigma):.1f}" y2="{y(value + sigma):.1f}" stroke="{CALM}" '
            f'opacity=".45"/><circle cx="{x(k):.1f}" cy="{y(value):.1f}" r="2.2" fill="{CALM}"/>'
        )
    ends = (
        f'<text x="{LEFT}" y="{HEIGHT - 4}">{points[0][3]}</text>'
        f'<text x="{WIDTH}" y="{HEIGHT - 4}" text-anchor="end">{points[-1][3]}</text>'
    )
    return _svg(WIDTH, HEIGHT, "".join(parts) + ends)


def _extent(values: Floats, sigmas: Floats) -> tuple[float, float]:
    """Return lowest and highest value to draw, without far outliers (Tukey's outer fences, 3 interquartile ranges)."""
    first, third = np.quantile(values, [0.25, 0.75])
    fence = 3 * (third - first)
    inside = (values >= first - fence) & (values <= third + fence)
    return float((values - sigmas)[inside].min()), float((values + sigmas)[inside].max())


def change_map(walls: Floats, cells: Mapping[str, Mapping[tuple[float, float], int]]) -> str:
    """Draw walls (n, 2, 2) [m], and the cells of changes with the number of logs that show each."""
    low, high = walls.reshape(-1, 2).min(axis=0), walls.reshape(-1, 2).max(axis=0)
    size = np.maximum(high - low, 1e-6)
    factor = MAP_WIDTH / size[0]

    def at(point: Sequence[float]) -> tuple[float, float]:
        return (point[0] - low[0]) * factor, (high[1] - point[1]) * factor

    parts = []
    for kind, colour in (("new", NEW), ("gone", GONE)):
        most = max(cells[kind].values(), default=1)
        for (cx, cy), n in cells[kind].items():
            px, py = at((cx - CELL / 2, cy + CELL / 2))
            side = max(CELL * factor, 2.0)
            parts.append(
                f'<rect x="{px:.1f}" y="{py:.1f}" width="{side:.1f}" height="{side:.1f}" fill="{colour}" '
                f'opacity="{0.25 + 0.75 * n / most:.2f}"/>'
            )
    path = "".join("M{:.1f} {:.1f}L{:.1f} {:.1f}".format(*at(a), *at(b)) for a, b in walls.tolist())
    parts.insert(0, f'<path d="{path}" stroke="{INK}" stroke-width=".8" fill="none" opacity=".7"/>')
    return _svg(MAP_WIDTH, float(size[1] * factor), "".join(parts))


def _ticks(low: float, high: float) -> list[float]:
    """Return three to five round numbers between two values."""
    step = 10.0 ** np.floor(np.log10((high - low) / 2))
    step = next(one * step for one in (1.0, 2.0, 5.0, 10.0) if (high - low) / (one * step) <= 5)
    first = int(np.ceil(low / step))
    return [float(round(k * step, 9)) for k in range(first, int(np.floor(high / step)) + 1)]


def _svg(width: float, height: float, body: str) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}" '
        f'height="{height:.0f}" font-size="10" font-family="system-ui, sans-serif" fill="{SOFT}">{body}</svg>'
    )
