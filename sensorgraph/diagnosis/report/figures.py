"""Pictures of a diagnosis; matplotlib is imported when the first is drawn."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from planners.arena import Arena
from sensorgraph.diagnosis.diagnose import Finding
from sensorgraph.diagnosis.report.comparison import Compared, Side, bare_gap, sections
from sensorgraph.diagnosis.report.phrases import place_words
from sensorgraph.diagnosis.result import ChannelResult, Gap, Unknown
from sensorgraph.diagnosis.scan.model_selection import THRESHOLD
from sensorgraph.effects import Amendment
from sensorgraph.show.figures.style import (
    ALARM,
    INK,
    SOFT,
    SOLID,
    draw_floor,
    new_figure,
    reduce_frame,
    save_figure,
)
from sensorgraph.types import Floats

BEFORE, AFTER, PALE = ALARM, "#2a788e", "#eceef2"
MOST_POINTS = 6000
"""End points in one picture of the arena."""


def draw(finding: Finding, compared: Compared | None, folder: Path) -> dict[str, Path]:
    """Draw every picture that the finding has something for; name -> file."""
    out: dict[str, Path] = {}
    if compared is not None:
        out["arena"] = folder / "arena.png"
        arena_picture(finding, compared, out["arena"])
        out["residuals"] = folder / "residuals.png"
        residuals_picture(finding, compared, out["residuals"])
    gaps = _gaps(finding)
    if gaps:
        out["gap"] = folder / "gap.png"
        others = {"scan, bare simulator": bare_gap(finding), "scan, second run": finding.second_gap}
        gap_picture(gaps, {k: g for k, g in others.items() if g is not None}, out["gap"])
    if finding.explained is not None and any(step.tried for step in finding.explained.steps):
        out["ranking"] = folder / "ranking.png"
        ranking_picture(finding, out["ranking"])
    plan = getattr(finding, "next_run", None)
    trajectory = getattr(plan, "trajectory", None)
    if trajectory is not None:
        out["next_run"] = folder / "next_run.png"
        next_run_picture(trajectory.poses, finding.data.arena, out["next_run"])
    return out


def next_run_picture(poses: Floats, arena: Arena, path: Path) -> None:
    """Draw the way (n, 3) of the next run over the arena, time as colour."""
    from matplotlib.collections import LineCollection

    x0, y0, x1, y1 = arena.bounds
    aspect = float(np.clip((y1 - y0) / max(x1 - x0, 1e-9), 0.2, 3.0))
    wide = min(6.0, 5.5 / aspect)
    figure = new_figure(wide + 1.2, wide * aspect + 0.8)
    axes = figure.subplots()
    draw_floor(axes, arena)
    moved = np.concatenate([[True], np.hypot(*np.diff(poses[:, :2], axis=0).T) > 1e-4])
    way = poses[moved][:: max(1, int(moved.sum()) // 2000), :2]
    share = np.linspace(0, 1, max(len(way) - 1, 1))
    pieces = list(np.stack([way[:-1], way[1:]], axis=1))
    line = LineCollection(pieces, array=share[: len(pieces)], cmap="viridis", linewidths=1.4, zorder=3)
    axes.add_collection(line)
    some = poses[:: max(1, len(poses) // 150)]
    axes.quiver(
        some[:, 0], some[:, 1], np.cos(some[:, 2]), np.sin(some[:, 2]), np.linspace(0, 1, len(some)),
        cmap="viridis", scale=22, width=0.003, headwidth=0, headlength=0, headaxislength=0, zorder=4,
    )  # fmt: skip
    axes.plot(*poses[0, :2], "o", ms=8, mfc="white", mec=ALARM, mew=2.0, zorder=6)
    axes.set_title(
        "from the ring on, dark to bright; strokes: where the robot faces", fontsize=9, color=INK, loc="left"
    )
    save_figure(figure, path)


def _gaps(finding: Finding) -> dict[str, Gap]:
    """Return the gaps worth a picture: where something was found first, and the scan channel's."""
    told = {name: result for name, result in finding.channels.items() if result.gap is not None}
    first = [n for n, result in told.items() if result.effects or result.unknown is not None]
    names = dict.fromkeys([*first, *(n for n in told if n == "scan")]) or dict.fromkeys(told)
    return {name: gap for name in names if (gap := told[name].gap) is not None}


def arena_picture(finding: Finding, compared: Compared, path: Path) -> None:
    """Draw where the rays ended, coloured by residual, before and after."""
    from matplotlib.collections import LineCollection

    x0, y0, x1, y1 = compared.frame
    aspect = (y1 - y0) / (x1 - x0)
    sides = [
        ("before: the simulator as mapped", compared.before),
        ("after: with what was found", compared.after),
    ]
    if not compared.is_amended:
        sides = [("measured against the simulator as mapped", compared.before)]
    stacked = aspect < 0.5
    across, down = (1, len(sides)) if stacked else (len(sides), 1)
    wide = float(min(8.6 if across == 1 else 4.1, 6.6 / aspect))
    figure = new_figure(
        max(wide * across + 1.5, 5.5), wide * aspect * down + 0.5 + 0.4 * down + 0.35 * _is_lossy(compared)
    )
    charts = list(figure.subplots(down, across, sharex=True, sharey=True, squeeze=False).ravel())
    factor = compared.enlarged
    top = float(f"{100 * max(1.2 * compared.typical, 2.5 * compared.sigma):.1g}")
    colours = _diverging()
    for axes, (title, side) in zip(charts, sides, strict=False):
        draw_floor(axes, compared.arena)
        axes.plot(compared.poses[:, 0], compared.poses[:, 1], color=SOFT, lw=0.6, alpha=0.5, zorder=1)
        dots = _points(axes, compared, side, top, colours)
        axes.set_title(title, fontsize=9.5, color=INK, loc="left")
        axes.set(xlim=(x0, x1), ylim=(y0, y1))
        moved = _displaced(compared.before.walls, side.walls)
        axes.add_collection(
            LineCollection(list(moved), colors=AFTER, linewidths=1.4, linestyles=(0, (4, 2)), zorder=6)
        )
        _marks(axes, compared, finding.effects, finding.unknown)
    if len(charts) == 2 and not stacked:
        charts[1].set_ylabel("")
    bar = figure.colorbar(dots, ax=charts, location="right", shrink=0.75, aspect=35, pad=0.015, extend="both")
    enlarged = f", drawn {factor} times as large" if factor > 1 else ""
    bar.set_label(f"measured − simulated [cm]{enlarged}", color=INK, fontsize=8)
    bar.ax.tick_params(labelsize=8, colors=INK)
    bar.outline.set_visible(False)
    handles, labels = charts[0].get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside lower left", frameon=False, fontsize=8, labelcolor=INK)
    save_figure(figure, path)


def _is_lossy(compared: Compared) -> bool:
    """Tell whether more rays are lost than a careful set-up loses, one in a thousand."""
    return bool(compared.before.missing.mean() > 0.003)


def _displaced(walls: Floats, other: Floats) -> Floats:
    """Return the walls that stand elsewhere, not those that have only become longer or shorter."""
    if walls.shape != other.shape or len(walls) == 0:
        return np.zeros((0, 2, 2))
    way = walls[:, 1] - walls[:, 0]
    normal = np.stack([-way[:, 1], way[:, 0]], axis=1) / np.maximum(np.hypot(*way.T), 1e-9)[:, None]
    off = np.abs(((other - walls) * normal[:, None]).sum(axis=2)).max(axis=1)
    return np.asarray(other[off > 1e-3])


def _diverging() -> Any:
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("short-long", ["#0b4f6c", AFTER, "#cfd4dc", BEFORE, "#7d1130"])


def _points(axes: Any, compared: Compared, side: Side, top: float, colours: Any) -> Any:
    """Draw a fair sample of end points; those far off stand where they were measured."""
    rng = np.random.default_rng(0)
    shown = np.isfinite(side.residual) & side.clear
    flat = np.flatnonzero(shown)
    flat = np.sort(rng.choice(flat, MOST_POINTS, replace=False)) if len(flat) > MOST_POINTS else flat
    residual = side.residual.ravel()[flat]
    ends = compared.ends(flat, compared.set_off(side).ravel()[flat])
    dots = axes.scatter(
        ends[:, 0],
        ends[:, 1],
        c=100 * residual,
        s=3.0,
        cmap=colours,
        vmin=-top,
        vmax=top,
        linewidths=0,
        zorder=5,
        rasterized=True,
    )
    missing = np.flatnonzero(side.missing)
    share = len(missing) / max(side.missing.size, 1)
    missing = np.sort(rng.choice(missing, 1500, replace=False)) if len(missing) > 1500 else missing
    if len(missing) and _is_lossy(compared):
        ends = compared.ends(missing, side.aimed.ravel()[missing])
        label = f"no return where one is expected ({100 * share:.1f} % of all rays)"
        axes.scatter(
            ends[:, 0],
            ends[:, 1],
            s=9,
            facecolors="none",
            edgecolors="#c9892b",
            linewidths=0.7,
            zorder=5,
            label=label,
        )
    return dots


def _marks(axes: Any, compared: Compared, effects: Sequence[Amendment], unknown: Unknown | None) -> None:
    """Mark where effects sit, and where something unknown is left."""
    for a in effects:
        xy = a.location.xy if a.location is not None else None
        if a.name == "unmapped_obstacle" or a.name == "wheel_slip":
            xy = (a["x"], a["y"])
        if a.place:
            _mark_walls(axes, compared, a)
        elif xy is not None:
            _ring(axes, compared, xy, a.effect.title)
    if unknown is not None and unknown.deviation is not None and unknown.deviation.xy is not None:
        where = unknown.deviation
        if where.partition.startswith("wall"):
            name = where.label.split(",")[0]
            _line(
                axes,
                [w for n, w in zip(compared.arena.names, compared.arena.walls, strict=True) if n == name],
            )
        _ring(axes, compared, where.xy or (0.0, 0.0), "unknown")


def _mark_walls(axes: Any, compared: Compared, a: Amendment) -> None:
    chosen = sections(compared.arena, a)
    if chosen:
        _line(axes, chosen)
        middle = np.mean([wall.mean(axis=0) for wall in chosen], axis=0)
        _label(axes, compared, (float(middle[0]), float(middle[1])), a.effect.title)


def _line(axes: Any, walls: Sequence[Floats]) -> None:
    from matplotlib.collections import LineCollection

    axes.add_collection(
        LineCollection(list(walls), colors=ALARM, linewidths=5.0, alpha=0.35, zorder=3.5, capstyle="round")
    )


def _ring(axes: Any, compared: Compared, xy: tuple[float, float], text: str) -> None:
    axes.plot(*xy, "o", ms=20, mfc="none", mec=ALARM, mew=1.6, zorder=7)
    _label(axes, compared, xy, text)


def _label(axes: Any, compared: Compared, xy: tuple[float, float], text: str) -> None:
    x0, y0, x1, y1 = compared.arena.bounds
    right, upper = xy[0] > (x0 + x1) / 2, xy[1] > (y0 + y1) / 2
    axes.annotate(
        text, xy, xytext=(-16 if right else 16, -22 if upper else 22), textcoords="offset points",
        ha="right" if right else "left", va="center", fontsize=8.5, color=ALARM, zorder=8,
        bbox={"boxstyle": "round,pad=0.25", "fc": "white", "ec": "none", "alpha": 0.85},
        arrowprops={"arrowstyle": "-", "color": ALARM, "lw": 0.8},
    )  # fmt: skip


def gap_picture(gaps: dict[str, Gap], others: dict[str, Gap], path: Path) -> None:
    """Draw the gap before and after beside the noise floor, in three units, a row per channel.

    Parameters
    ----------
    others : further gaps of the scan channel, by what to call them
    """
    rows = [(name, gap, name) for name, gap in gaps.items()]
    at = next((i + 1 for i, row in enumerate(rows) if row[2] == "scan"), len(rows))
    rows[at:at] = [(name, gap, "scan") for name, gap in others.items()]
    figure = new_figure(10.0, 0.35 + 1.15 * len(rows), layout=None)
    grid = figure.subplots(len(rows), 3, squeeze=False)
    figure.subplots_adjust(
        left=0.12,
        right=0.985,
        top=1 - 0.42 / (0.35 + 1.15 * len(rows)),
        bottom=0.02,
        wspace=0.22,
        hspace=0.55,
    )
    for charts, (title, gap, channel) in zip(grid, rows, strict=True):
        fits = (gap.before, gap.after, gap.noise_floor)
        unit = "cm" if channel == "scan" else "cm/s"
        least = gap.noise_floor.nats_per_ray
        columns = (
            (f"{title}: RMS gap [{unit}]", [100 * f.rmse_m for f in fits]),
            ("in units of the nominal noise", [f.normalised for f in fits]),
            ("nats per reading above the floor", [f.nats_per_ray - least for f in fits]),
        )
        for axes, (label, values) in zip(charts, columns, strict=True):
            if not np.isfinite(values).all():
                axes.set_axis_off()
                continue
            _bars(axes, values, least=0.02 if label.startswith("nats") else 0.0)
            axes.set_title(label, fontsize=8, color=SOFT, loc="left", pad=3)
        charts[0].set_yticks([2, 1, 0], ["before", "after", "noise floor"], fontsize=8.5, color=INK)
        charts[0].tick_params(axis="y", length=0)
    save_figure(figure, path)


def _bars(axes: Any, values: Sequence[float], *, least: float) -> None:
    top = max(*values, least, 1e-12)
    axes.barh([2, 1, 0], np.maximum(values, 0.0), color=[BEFORE, AFTER, SOFT], height=0.68)
    for y, value in zip([2, 1, 0], values, strict=True):
        text = f"{value:.3g}".replace("-", "−") if abs(value) >= 5e-4 else "0"
        axes.text(max(value, 0) + 0.015 * top, y, text, va="center", fontsize=8, color=INK)
    axes.set(xlim=(0.0, 1.22 * top), ylim=(-0.5, 2.5))
    axes.set_yticks([])
    axes.set_xticks([])
    for side in ("top", "right", "bottom"):
        axes.spines[side].set_visible(False)
    axes.spines["left"].set_color(SOLID)


def ranking_picture(finding: Finding, path: Path) -> None:
    """Draw the evidence of what was tried, round by round."""
    assert finding.explained is not None
    rounds = [(step.chosen, _distinct(step.tried)) for step in finding.explained.steps if step.tried][:5]
    lines = sum(len(tried) for _, tried in rounds) + 0.9 * len(rounds)
    height = max(0.27 * lines + 0.5, 1.5)
    figure = new_figure(10.0, height, layout=None)
    axes = figure.subplots()
    figure.subplots_adjust(left=0.30, right=0.97, top=1 - 0.08 / height, bottom=0.42 / height)
    y = 0.0
    ticks: list[float] = []
    labels: list[str] = []
    best = max(gain for _, tried in rounds for _, gain in tried)
    top = max(best, 2 * THRESHOLD)
    for k, (chosen, tried) in enumerate(rounds, start=1):
        words = (
            "the first is accepted"
            if chosen
            else "nothing more is accepted"
            if k > 1
            else "nothing is accepted"
        )
        axes.text(
            0.008 * top,
            y + 0.05,
            f"round {k}: {words}",
            fontsize=8,
            color=SOFT,
            va="center",
            fontweight="bold",
        )
        y -= 0.9
        lead = tried[0][1]
        for i, (a, gain) in enumerate(tried):
            taken = bool(chosen) and i == 0
            axes.barh(y, max(gain, 0.0), color=AFTER if taken else "#b9c0cc", height=0.7)
            behind = "" if i == 0 else f"   ({gain - lead:+,.0f} to the first)"
            axes.text(
                max(gain, 0) + 0.006 * top,
                y,
                f"{gain:,.0f}{behind}".replace("-", "−"),
                va="center",
                fontsize=8,
                color=INK,
            )
            ticks.append(y)
            labels.append(", ".join(filter(None, [a.effect.title, place_words(a)])))
            y -= 1.0
    axes.set_yticks(ticks, labels, fontsize=8.5, color=INK)
    axes.set(xlim=(0, 1.25 * top), ylim=(y + 0.4, 0.6))
    axes.axvline(THRESHOLD, color=ALARM, lw=0.9, ls=(0, (4, 3)))
    axes.set_xlabel(
        f"evidence [nats] beyond the price of the parameters; dashed: the {THRESHOLD:g} that a name takes",
        fontsize=8,
        color=INK,
    )
    reduce_frame(axes)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    save_figure(figure, path)


def _distinct(tried: Sequence[tuple[Amendment, float]]) -> list[tuple[Amendment, float]]:
    """Return at most five candidates, those of one effect at one place once."""
    out: list[tuple[Amendment, float]] = []
    for a, gain in tried:
        if not any(a.name == b.name and (a.place == b.place and abs(gain - g) < 1) for b, g in out):
            out.append((a, gain))
    return out[:5]


def residuals_picture(finding: Finding, compared: Compared, path: Path) -> None:
    """Draw mean residual, and scatter or surprises, over bearing, range, incidence, time, turn rate and speed."""
    variables = compared.variables()
    rows = ["mean", _second_row(finding.channels.get("scan"))]
    figure = new_figure(11.0, 3.9, layout=None)
    grid = figure.subplots(2, len(variables), sharey="row")
    figure.subplots_adjust(left=0.06, right=0.995, top=0.90, bottom=0.115, wspace=0.10, hspace=0.18)
    sides = [("before", compared.before, BEFORE)]
    if compared.is_amended:
        sides.append(("after", compared.after, AFTER))
    for row, (charts, kind) in enumerate(zip(grid, rows, strict=True)):
        values = [(label, _values(side, kind, compared.sigma), colour) for label, side, colour in sides]
        low, high = np.inf, -np.inf
        for axes, (name, (variable, edges)) in zip(charts, variables.items(), strict=True):
            centres = (edges[1:] + edges[:-1]) / 2
            index = np.searchsorted(edges, variable, side="right") - 1
            index = np.where((index >= 0) & (index < len(centres)) & np.isfinite(variable), index, -1)
            for label, value, colour in values:
                thick = 2.4 if label == "before" and compared.is_amended else 1.2
                mean, error = compared.profile(value, index, len(centres))
                seen = np.isfinite(mean)
                if not seen.any():
                    continue
                axes.fill_between(
                    centres[seen],
                    (mean - 2 * error)[seen],
                    (mean + 2 * error)[seen],
                    color=colour,
                    alpha=0.18,
                    lw=0,
                )
                axes.plot(
                    centres[seen], mean[seen], color=colour, lw=thick, marker="o", ms=1.5 * thick, label=label
                )
                low, high = min(low, float(mean[seen].min())), max(high, float(mean[seen].max()))
            axes.axhline(0.0 if kind != "spread" else 1.0, color=SOFT, lw=0.7, zorder=0)
            axes.grid(color=PALE, lw=0.6)
            reduce_frame(axes)
            axes.tick_params(labelsize=7)
            axes.set_xlim(edges[0], edges[-1])
            if row == 1:
                axes.set_xlabel(name, fontsize=8.5, color=INK)
            else:
                axes.tick_params(labelbottom=False)
            if axes is not charts[0]:
                axes.tick_params(left=False)
        if high >= low:
            least = 100 * compared.sigma * 0.5 if kind == "mean" else 0.5
            middle, half = (low + high) / 2, max(0.62 * (high - low), least)
            bottom = -0.06 * half if kind == "strange" else middle - half
            charts[0].set_ylim(bottom, middle + half)
        words = {
            "mean": "mean residual [cm]",
            "spread": "scatter over noise",
            "strange": "not as expected [%]",
        }
        charts[0].set_ylabel(words[kind], fontsize=8.5, color=INK)
    if compared.is_amended:
        grid[0][0].legend(
            loc="lower left",
            bbox_to_anchor=(0, 1.0),
            ncols=2,
            frameon=False,
            fontsize=8.5,
            labelcolor=INK,
            borderaxespad=0.2,
        )
    save_figure(figure, path)


def _second_row(result: ChannelResult | None) -> str:
    found = [] if result is None else [w.family for w in result.deviations if w.family != "bias"]
    return "spread" if found and found[0] == "spread" else "strange"


def _values(side: Side, kind: str, sigma: float) -> Floats:
    if kind == "mean":
        return 100 * side.clipped(sigma)
    if kind == "spread":
        return np.asarray(np.abs(side.clipped(sigma)) / side.sigma / np.sqrt(2 / np.pi))
    return np.where(side.clear, 100.0 * side.strange, np.nan)
