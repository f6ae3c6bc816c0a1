"""A diagnosis becomes an .rrd: measured, nominal and amended scans on one timeline, by rerun, without a viewer."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from sensorgraph.diagnosis.report.arena_figure import PlaceMark
from sensorgraph.diagnosis.report.comparison import CLIP_SIGMAS, ComparedScans, SimulatedScans
from sensorgraph.show.rerun_file import BACKGROUND, DIM, ORANGE, WALL, WHITE, folded, recorded

MAX_SCANS = 400
MARK, BLUE, TEAL = (255, 90, 120), (110, 160, 255), (70, 220, 190)


def write(
    compared: ComparedScans,
    path: Path,
    *,
    report: str,
    marks: Sequence[PlaceMark] = (),
) -> None:
    """Write `path` (.rrd).

    Parameters
    ----------
    report : markdown shown next to the scans
    marks : what is marked on the map
    """
    n = len(compared.stamps)
    shown = np.linspace(0, n - 1, min(n, MAX_SCANS)).round().astype(np.intp)
    ray = most_improved_ray(compared)
    models = [("nominal", compared.before, ORANGE)]
    if compared.is_amended:
        models.append(("amended", compared.after, TEAL))
    with recorded(path, "diagnosis", _layout(compared, ray)) as recording:
        _log_static(recording, compared, models, report)
        _log_marks(recording, marks)
        _send_scans(recording, compared, models, shown, ray)


def most_improved_ray(compared: ComparedScans) -> int:
    """Return the ray whose readings the amendment explains most; without one, the ray that is off most."""
    before = np.nansum(compared.before.clipped(compared.sigma) ** 2, axis=0)
    after = np.nansum(compared.after.clipped(compared.sigma) ** 2, axis=0) if compared.is_amended else 0.0
    return int(np.argmax(before - after))


def _log_static(
    recording: rr.RecordingStream,
    compared: ComparedScans,
    models: Sequence[tuple[str, SimulatedScans, tuple[int, int, int]]],
    report: str,
) -> None:
    """Log walls, path, styles, bars and report."""
    recording.log("plan", rr.Transform3D(scale=[1, -1, 1]), static=True)  # the 2-D view's y points down
    recording.log(
        "plan/arena", rr.LineStrips2D(list(compared.arena.walls), colors=WALL, radii=-0.8), static=True
    )
    recording.log("plan/path", rr.LineStrips2D([compared.poses[:, :2]], colors=DIM, radii=-0.4), static=True)
    recording.log("plan/robot", rr.Arrows2D.from_fields(colors=BLUE, radii=-2.0), static=True)
    recording.log("plan/measured", rr.Points2D.from_fields(colors=WHITE, radii=-2.2), static=True)
    recording.log("report", rr.TextDocument(report, media_type="text/markdown"), static=True)
    for name, model, colour in models:
        recording.log(f"plan/{name}", rr.Points2D.from_fields(colors=colour, radii=-1.6), static=True)
        recording.log(
            f"plan/enlarged/{name}", rr.Points2D.from_fields(colors=colour, radii=-2.2), static=True
        )
        for series in ("gap", "residual"):
            style = rr.SeriesLines(colors=colour, names=name, widths=1.4)
            recording.log(f"{series}/{name}", style, static=True)
        clipped = model.clipped(compared.sigma)
        seen = np.isfinite(clipped)
        mean = 100 * np.where(seen, clipped, 0.0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
        bars = rr.BarChart(mean, abscissa=np.degrees(compared.sensor.bearings), color=colour)
        recording.log(f"bearing/{name}", bars, static=True)


def _log_marks(recording: rr.RecordingStream, marks: Sequence[PlaceMark]) -> None:
    walls = [wall for mark in marks for wall in mark.walls]
    if walls:
        recording.log("plan/marks/walls", rr.LineStrips2D(walls, colors=MARK, radii=-2.5), static=True)
    if marks:
        places = rr.Points2D([m.xy for m in marks], labels=[m.title for m in marks], colors=MARK, radii=-6.0)
        recording.log("plan/marks/places", places, static=True)


def _send_scans(
    recording: rr.RecordingStream,
    compared: ComparedScans,
    models: Sequence[tuple[str, SimulatedScans, tuple[int, int, int]]],
    shown: np.ndarray[tuple[int], np.dtype[np.intp]],
    ray: int,
) -> None:
    """Send the scans, and the gap over time, as columns."""
    time = [rr.TimeColumn("time", duration=compared.stamps[shown]), rr.TimeColumn("scan", sequence=shown)]
    poses = compared.poses[shown]
    x0, y0, x1, y1 = compared.arena.bounds
    size = max(0.3, 0.03 * max(x1 - x0, y1 - y0))
    arrows = size * np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=1)
    recording.send_columns("plan/robot", time, rr.Arrows2D.columns(origins=poses[:, :2], vectors=arrows))
    clouds = {"plan/measured": compared.measured}
    for name, model, _ in models:
        clouds[f"plan/{name}"] = model.simulated
        clouds[f"plan/enlarged/{name}"] = compared.enlarged_ranges(model)
    for entity, ranges in clouds.items():
        scan, column = np.nonzero(np.isfinite(ranges[shown]))
        hit = shown[scan], column
        points = compared.ends(np.ravel_multi_index(hit, ranges.shape), ranges[hit])
        columns = rr.Points2D.columns(positions=points).partition(np.bincount(scan, minlength=len(shown)))
        recording.send_columns(entity, time, columns)
    for name, model, _ in models:
        gap = 100 * model.rms(compared.sigma)[shown]
        recording.send_columns(f"gap/{name}", time, rr.Scalars.columns(scalars=gap))
        residual = 100 * model.clipped(compared.sigma)[shown, ray]
        recording.send_columns(f"residual/{name}", time, rr.Scalars.columns(scalars=residual))


def _layout(compared: ComparedScans, ray: int) -> rrb.Blueprint:
    """Scans on the arena, the gap enlarged and the report above; gap over time, one ray, and bearing below."""
    x0, y0, x1, y1 = compared.limits
    bounds = rrb.VisualBounds2D(x_range=[x0, x1], y_range=[-y1, -y0])
    amended = ", amended (teal)" if compared.is_amended else ""
    plan = rrb.Spatial2DView(
        name=f"measured (white), nominal (orange){amended}",
        origin="/",
        contents=["/plan/**", "- /plan/enlarged/**"],
        visual_bounds=bounds,
        background=BACKGROUND,
    )
    larger = f", {compared.magnification} times as large" if compared.magnification > 1 else ""
    off = rrb.Spatial2DView(
        name=f"the gap{larger}: on the wall is right",
        origin="/",
        contents=["/plan/arena", "/plan/enlarged/**", "/plan/marks/**", "/plan/robot"],
        visual_bounds=bounds,
        background=BACKGROUND,
    )
    words = rrb.TextDocumentView(name="report", origin="/report")
    top = 100 * float(np.quantile(compared.before.rms(compared.sigma), 0.99))
    gap = rrb.TimeSeriesView(
        name="RMS gap per scan [cm]",
        origin="/gap",
        axis_y=rrb.ScalarAxis(range=(0.0, 1.15 * max(top, 100 * compared.sigma))),
        plot_legend=rrb.Corner2D.LeftTop,
    )
    reach = 100 * CLIP_SIGMAS * compared.sigma * 1.05
    far = 100 * np.abs(compared.before.clipped(compared.sigma)[:, ray])
    if np.isfinite(far).any():
        reach = min(reach, 1.3 * float(np.nanquantile(far, 0.98)))
    degrees = np.degrees(compared.sensor.bearings[ray])
    one = rrb.TimeSeriesView(
        name=f"residual of ray {ray} at {degrees:.0f} degrees [cm], cut at {CLIP_SIGMAS:g} sigmas",
        origin="/residual",
        axis_y=rrb.ScalarAxis(range=(-reach, reach)),
        plot_legend=rrb.Corner2D.LeftTop,
    )
    names = ["amended", "nominal"] if compared.is_amended else ["nominal"]
    bars = rrb.BarChartView(
        name="mean residual per ray [cm] over bearing [degrees]",
        origin="/bearing",
        contents=[f"/bearing/{name}" for name in reversed(names)],
        plot_legend=rrb.PlotLegend(visible=False),
    )
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(plan, off, words),
            rrb.Horizontal(gap, one, bars),
            row_shares=[3, 2],
        ),
        *folded(),
        auto_views=False,
    )
