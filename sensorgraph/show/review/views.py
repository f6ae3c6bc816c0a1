"""Write the .rrd file of a review: the logged entities and the layout of the viewer."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from logs.transforms import wrap
from sensorgraph.models.cones.settings import measures_cones
from sensorgraph.sensor_model_input import rays_of
from sensorgraph.show.figures.style import MAX_POINTS
from sensorgraph.show.rerun_file import BACKGROUND, DIM, ORANGE, WALL, WHITE, folded, recorded
from sensorgraph.show.review.contents import RayVerdict, Review
from sensorgraph.show.review.maps import VERDICT_COLOURS, colours, log_maps, log_voxels, map_labels
from sensorgraph.show.review.report import report
from sensorgraph.types import Floats, Progress

SCANS_PER_CHUNK = 500
CLOUD_REACH = 20.0
"""[m] Limit of the ranges in the point cloud that replaces the walls if there is no map."""
ROBOT, PLANNED, CLOUD = (90, 220, 140), (60, 75, 110), (95, 95, 110)
"""Colours. Negative radii below are in screen points, not in metres."""
DEVIATIONS = {"x [cm]": WHITE, "y [cm]": ORANGE, "phi [deg]": ROBOT}
"""Series of the standard deviations of the poses -> colour."""
INTENSITY_LABEL = "intensity: violet weak, yellow strong"
INTENSITY_SCALE = (0.01, 0.99)
"""Quantiles of the intensities at the ends of the colour scale, so that a few reflectors do not darken the rest."""


def write(review: Review, path: Path, *, ray: int | None = None, progress: Progress | None = None) -> None:
    """Write a review as `path` (.rrd) with the 2 x 3 layout as its default blueprint.

    Parameters
    ----------
    ray : Index of the ray whose time series is shown. None: the ray straight ahead.
    """
    sensor = review.run.sensor
    if ray is None:
        ray = int(np.abs(wrap(sensor.bearings + sensor.mount[2])).argmin())
    (ray,) = rays_of([ray], sensor.n_rays).tolist()
    with recorded(path, "review", _layout(review, ray)) as recording:
        _log_static(recording, review)
        for start in range(0, len(review.shown), SCANS_PER_CHUNK):
            if progress is not None:
                progress(start, len(review.shown))
            _send_scans(recording, review, slice(start, start + SCANS_PER_CHUNK), ray)


def _log_static(recording: rr.RecordingStream, review: Review) -> None:
    """Log the static entities: walls, paths, maps, cells, bars, report."""
    flip = rr.Transform3D(scale=[1, -1, 1])  # the 2-D view's y points down
    recording.log("plan", flip, static=True)
    if review.arena is not None:
        recording.log(
            "plan/arena", rr.LineStrips2D(list(review.arena.walls), colors=WALL, radii=-0.8), static=True
        )
        ends = np.concatenate([review.arena.walls, np.zeros((review.arena.n_walls, 2, 1))], axis=2)
        recording.log("space/arena", rr.LineStrips3D(list(ends), colors=WALL, radii=-0.5), static=True)
    else:
        cloud = np.concatenate(
            review.points(np.where(review.measured < CLOUD_REACH, review.measured, np.nan))
        )
        thin = cloud[:: max(1, len(cloud) // MAX_POINTS)]
        recording.log("plan/arena", rr.Points2D(thin, colors=CLOUD, radii=-0.7), static=True)
    if review.planned is not None:
        recording.log(
            "plan/planned", rr.LineStrips2D([review.planned], colors=PLANNED, radii=-0.4), static=True
        )
    path = review.pairing.poses[review.pairing.paired, :2]
    recording.log("plan/path", rr.LineStrips2D([path], colors=DIM, radii=-0.4), static=True)
    log_maps(recording, review.cells)
    log_voxels(recording, review.cells)
    _log_intensities(recording, review)
    recording.log("report", rr.TextDocument(report(review), media_type="text/markdown"), static=True)
    if review.evaluation is not None:
        rmse = np.nan_to_num(review.evaluation.rmse_per_ray) * 100
        bars = rr.BarChart(rmse, abscissa=np.degrees(review.run.sensor.bearings), color=ORANGE)
        recording.log("error_per_ray", bars, static=True)
    for name, colour in DEVIATIONS.items():
        if review.deviations is not None:
            style = rr.SeriesLines(colors=colour, names=name, widths=1.2)
            recording.log(f"deviation/{name.split()[0]}", style, static=True)
    for name, colour in (("measured", WHITE), ("predicted", ORANGE)):
        style = rr.SeriesLines(colors=colour, names=name, widths=1.2)
        recording.log(f"ray/{name}", style, static=True)


def _log_intensities(recording: rr.RecordingStream, review: Review) -> None:
    """Log the returns of evenly spaced scans as points, coloured by intensity."""
    points, values = intensity_points(review)
    if not len(points):
        return
    low, high = np.quantile(values, INTENSITY_SCALE)
    colour = colours((values - low) / max(high - low, 1e-12))
    recording.log("plan/intensity", rr.Points2D(points, colors=colour, radii=-1.2), static=True)


def intensity_points(review: Review) -> tuple[Floats, Floats]:
    """Return end points (n, 2) [m, map] of returns with an intensity, and these intensities (n,)."""
    if review.intensities is None:
        return np.zeros((0, 2)), np.zeros(0)
    known = np.isfinite(review.measured) & np.isfinite(review.intensities)
    every = slice(None, None, max(1, -(-int(known.sum()) // MAX_POINTS)))
    points = review.points(np.where(known, review.measured, np.nan), every)
    return np.concatenate(points), review.intensities[every][known[every]]


def _send_scans(recording: rr.RecordingStream, review: Review, part: slice, ray: int) -> None:
    """Send a block of scans, poses and the series of one ray."""
    stamps = review.run.stamps[review.shown[part]]
    time = [rr.TimeColumn("time", duration=stamps), rr.TimeColumn("scan", sequence=review.shown[part])]
    lasers, are_cones = review.robots[part], measures_cones(review.run.sensor)
    size = max(0.35, 0.03 * (_extent(review)[2] - _extent(review)[0]))
    arrows = size * np.stack([np.cos(lasers[:, 2]), np.sin(lasers[:, 2])], axis=1)
    recording.send_columns("plan/robot", time, rr.Arrows2D.columns(origins=lasers[:, :2], vectors=arrows))
    for name, ranges, colour in _layers(review):
        if part.start == 0:
            radius = -1.5 if name == "predicted" else -2.2
            style = rr.LineStrips2D if are_cones else rr.Points2D
            recording.log(f"plan/{name}", style.from_fields(colors=colour, radii=radius), static=True)
        shapes = review.arcs(ranges, part) if are_cones else review.points(ranges, part)
        every = np.concatenate(shapes)
        columns = (
            rr.LineStrips2D.columns(strips=list(every)) if are_cones else rr.Points2D.columns(positions=every)
        )
        recording.send_columns(f"plan/{name}", time, columns.partition([len(s) for s in shapes]))
    for name, values in (("measured", review.measured), ("predicted", review.predicted)):
        if values is not None:
            series = np.where(np.isfinite(values[part, ray]), values[part, ray], np.nan)
            recording.send_columns(f"ray/{name}", time, rr.Scalars.columns(scalars=series))
    if review.deviations is not None:
        for name, values in zip(
            DEVIATIONS, (review.deviations[part] * [100, 100, 180 / np.pi]).T, strict=True
        ):
            recording.send_columns(f"deviation/{name.split()[0]}", time, rr.Scalars.columns(scalars=values))
    if part.start == 0:
        recording.log("plan/robot", rr.Arrows2D.from_fields(colors=ROBOT, radii=-2.0), static=True)


def _layers(review: Review) -> Iterator[tuple[str, Floats, tuple[int, int, int]]]:
    """Yield name, ranges (n_shown, n_rays) and colour of each layer: measured points by verdict, then predicted points."""
    verdicts = review.verdicts
    yield "measured", np.where(verdicts == RayVerdict.UNSCORED, review.measured, np.nan), WHITE
    if review.predicted is not None:
        for name, verdict in (
            ("right", RayVerdict.RIGHT),
            ("not_answered", RayVerdict.UNANSWERED),
            ("wrong", RayVerdict.WRONG),
        ):
            yield name, np.where(verdicts == verdict, review.measured, np.nan), VERDICT_COLOURS[verdict]
        yield "predicted", review.predicted, ORANGE


def _layout(review: Review, ray: int) -> rrb.Blueprint:
    """Return the layout. Above: scan on arena, maps, cells. Below: one ray, error per ray or of the poses, report."""
    x0, y0, x1, y1 = _extent(review)
    bounds = rrb.VisualBounds2D(x_range=[x0, x1], y_range=[-y1, -y0])
    scan = rrb.Spatial2DView(
        name=_scan_name(review),
        origin="/",
        contents=[
            f"/plan/{name}"
            for name in ("arena", "planned", "path", *(name for name, _, _ in _layers(review)), "robot")
        ],
        visual_bounds=bounds,
        background=BACKGROUND,
    )
    tabs = rrb.Tabs(
        *[
            rrb.Spatial2DView(
                name=label,
                origin="/",
                contents=[f"/plan/{name}/**", "/plan/arena"],
                visual_bounds=bounds,
                background=BACKGROUND,
            )
            for name, label in _tab_labels(review).items()
        ],
        name="maps",
        active_tab=0,
    )
    coloured = "right, wrong, not answered" if review.cells.ray_counts is not None else "scans, 0 to 10"
    nx, ny, _ = review.cells.counts.shape
    width, depth = nx * review.cells.cell, ny * review.cells.cell
    x, y = review.cells.origin
    centre = [x + width / 2, y + depth / 2, 0.2 * max(width, depth)]
    away = 1.25 * max(width, depth)
    space = rrb.Spatial3DView(
        name=f"(x, y, phi) cells: {coloured}",
        origin="/space",
        background=BACKGROUND,
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(
            position=[centre[0] - 0.55 * away, centre[1] - 0.95 * away, centre[2] + 0.8 * away],
            look_target=centre,
            eye_up=[0, 0, 1],
        ),
    )
    returns = review.measured[:, ray][np.isfinite(review.measured[:, ray])]
    far = float(np.quantile(returns, 0.98)) if len(returns) else review.run.sensor.range_max
    degrees = np.degrees(review.run.sensor.bearings[ray])
    series = rrb.TimeSeriesView(
        name=f"range of ray {ray} at {degrees:.0f} degrees [m]",
        origin="/ray",
        axis_y=rrb.ScalarAxis(range=(0.0, 1.15 * far)),
        plot_legend=rrb.Corner2D.LeftTop,
    )
    words = rrb.TextDocumentView(name="report", origin="/report")
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(scan, tabs, space),
            rrb.Horizontal(series, *_middle(review), words),
            row_shares=[3, 2],
        ),
        *folded(),
        auto_views=False,
    )


def _tab_labels(review: Review) -> dict[str, str]:
    """Return the entities of the tabs with maps, name -> label."""
    labels = map_labels(review.cells)
    return labels if review.intensities is None else {**labels, "intensity": INTENSITY_LABEL}


def _middle(review: Review) -> list[rrb.View]:
    """Return the view of the error per ray or, without a graph, of the standard deviations of the poses if known."""
    if review.evaluation is not None:
        bars = rrb.BarChartView(
            name="RMSE of each ray [cm] over bearing [degrees]",
            origin="/error_per_ray",
            plot_legend=rrb.PlotLegend(visible=False),
        )
        return [bars]
    if review.deviations is None:
        return []
    top = float(np.quantile(review.deviations * [100, 100, 180 / np.pi], 0.999))
    series = rrb.TimeSeriesView(
        name="standard deviation of the pose: x, y [cm], phi [degrees]",
        origin="/deviation",
        axis_y=rrb.ScalarAxis(range=(0.0, 1.15 * top)),
        plot_legend=rrb.Corner2D.LeftTop,
    )
    return [series]


def _scan_name(review: Review) -> str:
    """Return the title of the scan view, which explains its colours."""
    what = "measured: nearest surface on each arc" if measures_cones(review.run.sensor) else "measured"
    if review.predicted is None:
        return what
    return f"{what}: teal right, pink wrong, violet not answered; orange predicted"


def _extent(review: Review) -> tuple[float, float, float, float]:
    if review.arena is not None:
        x0, y0, x1, y1 = review.arena.bounds
    else:
        points = np.concatenate(
            review.points(np.where(review.measured < CLOUD_REACH, review.measured, np.nan))
        )
        (x0, y0), (x1, y1) = np.quantile(points, 0.002, axis=0), np.quantile(points, 0.998, axis=0)
    margin = 0.04 * max(x1 - x0, y1 - y0)
    return float(x0 - margin), float(y0 - margin), float(x1 + margin), float(y1 + margin)
