"""A Review becomes an .rrd with its own layout, by rerun. No viewer is needed to make it.

Columns go in blocks (`send_columns`), strictly checked, without wall-clock time. The .rrd can be made again at
any time; the MCAP is the record.
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from sensorgraph.errors import SensorgraphError
from sensorgraph.files import whole
from sensorgraph.show import rerun_maps as view_maps
from sensorgraph.show.rerun_maps import VERDICT
from sensorgraph.types import Floats

if TYPE_CHECKING:  # whoever has a review has imported it; a diagnosis needs neither models nor numba
    from sensorgraph.show.review import Review

BLOCK = 500  # scans a chunk; below, a negative radius is in points of the screen, not in metres
WHITE, ORANGE, GREEN = (235, 235, 240), (255, 150, 40), (90, 220, 140)
WALL, DIM, PLANNED = (150, 150, 165), (80, 100, 135), (60, 75, 110)


def write(seen: Review, path: Path, *, ray: int | None = None) -> None:
    """Write a review as `path` (.rrd) with the 2 x 3 layout as its default blueprint.

    Parameters
    ----------
    ray : whose series is shown; None: the one that looks straight ahead
    """
    ray = int(np.abs(seen.run.sensor.bearings).argmin()) if ray is None else ray
    if not 0 <= ray < seen.run.sensor.n_rays:
        raise SensorgraphError(
            f"ray {ray} does not exist; this sensor has rays 0 to {seen.run.sensor.n_rays - 1}"
        )
    with recorded(path, "review", _layout(seen, ray)) as recording:
        _still(recording, seen)
        for start in range(0, len(seen.shown), BLOCK):
            _scans(recording, seen, slice(start, start + BLOCK), ray)


@contextmanager
def recorded(path: Path, name: str, layout: rrb.Blueprint) -> Iterator[rr.RecordingStream]:
    """Yield a strictly checked recording with its own layout; the file is whole or not there."""
    was_strict = rr.strict_mode()
    rr.set_strict_mode(True)
    try:
        with whole(path) as part:
            recording = rr.RecordingStream("sensorgraph", recording_id=name, send_properties=False)
            recording.save(part, default_blueprint=layout)
            yield recording
            recording.disconnect()
    finally:
        rr.set_strict_mode(was_strict)


def show(path: Path) -> None:
    """Open a review in rerun's viewer, on this machine only."""
    subprocess.Popen(["rerun", "--bind", "127.0.0.1", str(path)])


def _still(recording: rr.RecordingStream, seen: Review) -> None:
    """Log what does not change: walls, paths, maps, cells, bars, report."""
    flip = rr.Transform3D(scale=[1, -1, 1])  # the 2-D view's y points down
    recording.log("plan", flip, static=True)
    if seen.arena is not None:
        recording.log(
            "plan/arena", rr.LineStrips2D(list(seen.arena.walls), colors=WALL, radii=-0.8), static=True
        )
        ends = np.concatenate([seen.arena.walls, np.zeros((seen.arena.n_walls, 2, 1))], axis=2)
        recording.log("space/arena", rr.LineStrips3D(list(ends), colors=WALL, radii=-0.5), static=True)
    else:
        cloud = np.concatenate(seen.points(np.where(seen.measured < 20, seen.measured, np.nan)))
        thin = cloud[:: max(1, len(cloud) // 60_000)]
        recording.log("plan/arena", rr.Points2D(thin, colors=(95, 95, 110), radii=-0.7), static=True)
    if seen.planned is not None:
        recording.log(
            "plan/planned", rr.LineStrips2D([seen.planned], colors=PLANNED, radii=-0.4), static=True
        )
    path = seen.pairing.poses[seen.pairing.paired, :2]
    recording.log("plan/path", rr.LineStrips2D([path], colors=DIM, radii=-0.4), static=True)
    view_maps.log_maps(recording, seen.cells)
    view_maps.log_voxels(recording, seen.cells)
    from sensorgraph.show.review import report

    recording.log("report", rr.TextDocument(report(seen), media_type="text/markdown"), static=True)
    if seen.evaluation is not None:
        rmse = np.nan_to_num(seen.evaluation.rmse_per_ray) * 100
        bars = rr.BarChart(rmse, abscissa=np.degrees(seen.run.sensor.bearings), color=ORANGE)
        recording.log("error_per_ray", bars, static=True)
    for name, colour in (("measured", WHITE), ("predicted", ORANGE)):
        style = rr.SeriesLines(colors=colour, names=name, widths=1.2)
        recording.log(f"ray/{name}", style, static=True)


def _scans(recording: rr.RecordingStream, seen: Review, part: slice, ray: int) -> None:
    """Send a block of scans, poses and the series of one ray."""
    stamps = seen.run.stamps[seen.shown[part]]
    time = [rr.TimeColumn("time", duration=stamps), rr.TimeColumn("scan", sequence=seen.shown[part])]
    lasers = seen.lasers[part]
    size = max(0.35, 0.03 * (_extent(seen)[2] - _extent(seen)[0]))
    arrows = size * np.stack([np.cos(lasers[:, 2]), np.sin(lasers[:, 2])], axis=1)
    recording.send_columns("plan/robot", time, rr.Arrows2D.columns(origins=lasers[:, :2], vectors=arrows))
    for name, ranges, colour in _layers(seen):
        points = seen.points(ranges, part)
        if part.start == 0:
            radius = -1.5 if name == "predicted" else -2.2
            recording.log(f"plan/{name}", rr.Points2D.from_fields(colors=colour, radii=radius), static=True)
        columns = rr.Points2D.columns(positions=np.concatenate(points)).partition([len(p) for p in points])
        recording.send_columns(f"plan/{name}", time, columns)
    for name, values in (("measured", seen.measured), ("predicted", seen.predicted)):
        if values is not None:
            series = np.where(np.isfinite(values[part, ray]), values[part, ray], np.nan)
            recording.send_columns(f"ray/{name}", time, rr.Scalars.columns(scalars=series))
    if part.start == 0:
        recording.log("plan/robot", rr.Arrows2D.from_fields(colors=GREEN, radii=-2.0), static=True)


def _layers(seen: Review) -> Iterator[tuple[str, Floats, tuple[int, int, int]]]:
    """Yield name, ranges (n_shown, n_rays) and colour of the points: measured ones by verdict, then predicted."""
    from sensorgraph.show.review import RIGHT, UNANSWERED, UNSCORED, WRONG

    verdicts = seen.verdicts
    yield "measured", np.where(verdicts == UNSCORED, seen.measured, np.nan), WHITE
    if seen.predicted is not None:
        for name, verdict in (("right", RIGHT), ("not_answered", UNANSWERED), ("wrong", WRONG)):
            yield name, np.where(verdicts == verdict, seen.measured, np.nan), VERDICT[name]
        yield "predicted", seen.predicted, ORANGE


def _layout(seen: Review, ray: int) -> rrb.Blueprint:
    """Two rows of three: scan on arena, maps, cells; one ray, error per ray, report."""
    x0, y0, x1, y1 = _extent(seen)
    bounds = rrb.VisualBounds2D(x_range=[x0, x1], y_range=[-y1, -y0])
    back = (18, 18, 22)
    scan = rrb.Spatial2DView(
        name="measured: teal right, pink wrong, violet not answered; orange predicted"
        if seen.predicted is not None
        else "measured",
        origin="/",
        contents=[
            f"/plan/{name}"
            for name in ("arena", "planned", "path", *(name for name, _, _ in _layers(seen)), "robot")
        ],
        visual_bounds=bounds,
        background=back,
    )
    tabs = rrb.Tabs(
        *[
            rrb.Spatial2DView(
                name=label,
                origin="/",
                contents=[f"/plan/{name}/**", "/plan/arena"],
                visual_bounds=bounds,
                background=back,
            )
            for name, label in view_maps.tabs(seen.cells).items()
        ],
        name="maps",
        active_tab=0,
    )
    coloured = "right, wrong, not answered" if seen.cells.tally is not None else "scans, 0 to 10"
    nx, ny, _ = seen.cells.counts.shape
    width, depth = nx * seen.cells.cell, ny * seen.cells.cell
    x, y = seen.cells.origin
    centre = [x + width / 2, y + depth / 2, 0.2 * max(width, depth)]
    away = 1.25 * max(width, depth)
    space = rrb.Spatial3DView(
        name=f"(x, y, phi) cells: {coloured}",
        origin="/space",
        background=back,
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(
            position=[centre[0] - 0.55 * away, centre[1] - 0.95 * away, centre[2] + 0.8 * away],
            look_target=centre,
            eye_up=[0, 0, 1],
        ),
    )
    seen_by_ray = seen.measured[:, ray][np.isfinite(seen.measured[:, ray])]
    far = float(np.quantile(seen_by_ray, 0.98)) if len(seen_by_ray) else seen.run.sensor.range_max
    degrees = np.degrees(seen.run.sensor.bearings[ray])
    series = rrb.TimeSeriesView(
        name=f"ray {ray} at {degrees:.0f} degrees [m]",
        origin="/ray",
        axis_y=rrb.ScalarAxis(range=(0.0, 1.15 * far)),
        plot_legend=rrb.Corner2D.LeftTop,
    )
    bars = rrb.BarChartView(
        name="RMSE per ray [cm] over bearing [degrees]",
        origin="/error_per_ray",
        plot_legend=rrb.PlotLegend(visible=False),
    )
    words = rrb.TextDocumentView(name="report", origin="/report")
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(scan, tabs, space),
            rrb.Horizontal(series, bars, words),
            row_shares=[3, 2],
        ),
        rrb.TimePanel(state="collapsed", timeline="time"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )


def _extent(seen: Review) -> tuple[float, float, float, float]:
    if seen.arena is not None:
        x0, y0, x1, y1 = seen.arena.bounds
    else:
        points = np.concatenate(seen.points(np.where(seen.measured < 20, seen.measured, np.nan)))
        (x0, y0), (x1, y1) = np.quantile(points, 0.002, axis=0), np.quantile(points, 0.998, axis=0)
    margin = 0.04 * max(x1 - x0, y1 - y0)
    return float(x0 - margin), float(y0 - margin), float(x1 + margin), float(y1 + margin)
