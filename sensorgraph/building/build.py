"""Build a sensorgraph from runs: pair scans with poses, hold some out, fit a model of MODELS."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from inspect import signature
from pathlib import PurePath
from typing import Any, get_type_hints

import numpy as np

from logs.run import Run, pair
from logs.stream import LogStream, WholeRun
from logs.usability import MIN_SCANS
from planners.arena import Arena
from sensorgraph.building.residuals import with_memory
from sensorgraph.building.split import held_out
from sensorgraph.building.training_data import TrainingData, all_scans, begin_digest, ranges_bytes
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.intake import check_rays
from sensorgraph.models import MODELS
from sensorgraph.models.base import Model, check_options
from sensorgraph.models.cells.model import CellModel
from sensorgraph.models.faces.model import Faces
from sensorgraph.models.faces.reduction import MapBlocks
from sensorgraph.types import Bools, ProgressBars, no_progress
from sensorgraph.version import __version__
from sensorgraph.world.ray_order import bearings_text, ray_order, with_rays_like


def build(
    runs: Sequence[Run | LogStream], *, arena: Arena | None = None, model: str = "faces",
    split: str | None = None, names: Sequence[str] | None = None, map_blocks: MapBlocks = map,
    update: Sensorgraph | None = None, force: bool = True, memory: bool = False,
    progress: ProgressBars = no_progress, **options: Any,
) -> Sensorgraph:  # fmt: skip
    """Fit a model to every scan that has a pose and is not held out.

    Parameters
    ----------
    runs : Recordings of one sensor, with poses of one frame. A `LogStream` is read piece by piece.
    arena : Its bounds set the scale of x and y, so that graphs of several runs share it.
    model : A name in MODELS.
    names : Name of each run in messages and in the graph. None: the name of its file.
    split : `every10` or `block` hold out scans of each run. The graph records the split.
    map_blocks : Function that reduces blocks of scans; `map` runs here. See `sensorgraph.dask_client.cluster_map`.
    update : A graph of faces or cells to which the runs are added; its own runs are not needed.
    force : Accept a run whose poses jump. False: refuse it, as the commands do.
    memory : Also identify how residuals depend on the previous scan and on neighbouring rays, for drawing
        (`record --graph`). With `update` it is identified on the new runs; otherwise an existing one is kept.
    progress : Opens a progress bar for each stage.
    options : Options of the model. The polynomial takes `degree`, `harmonics` and `n_terms`, a number or `auto` each.

    Raises
    ------
    SensorgraphError : The model or one of its options is unknown, too few scans have a pose, or the runs differ in their sensor.
    """
    if model not in MODELS:
        raise SensorgraphError(f"model is {model!r}, expected one of {', '.join(MODELS)}")
    if update is None:
        check_options(MODELS[model], options, MODELS.values())
    names = [_name(run, i) for i, run in enumerate(runs)] if names is None else names
    sources = [WholeRun(head=run) if isinstance(run, Run) else run for run in runs]
    _check_alike([source.head for source in sources], names)
    for applies, what, remedy in (
        (model == "cells" or options.get("cells"), "cells take", "set `model` faces or polynomial"),
        (options.get("calibrate"), "a calibration takes", "leave `calibrate` out"),
    ):
        if applies:
            for source, name in zip(sources, names, strict=True):
                check_rays(
                    source.head.sensor, name, takes=what, one_place=False,
                    remedy=f"{remedy}, or choose one laser with `topics` scan=NAME",
                )  # fmt: skip
    bounds = None if arena is None else arena.bounds
    feed_again = partial(TrainingData, sources, names, split=split, bounds=bounds, force=force)
    feed = feed_again()
    if update is not None:
        graph = _updated(update, feed, feed_again, map_blocks, progress, options)
        return _add_memory(graph, feed_again(), progress) if memory else graph
    fitted = _fit(feed, MODELS[model], map_blocks, progress, options)
    origin = {
        "software": __version__,
        "inputs": feed.entries,
        "split": split,
        "options": {name: options[name] for name in sorted(options)},
        "arena_bounds": None if arena is None else list(arena.bounds),
    }
    graph = Sensorgraph(model=fitted, sensor=feed.sensor, pose_frame=feed.pose_frame, origin=origin)
    return _add_memory(graph, feed_again(), progress) if memory else graph


@cache
def option_types() -> Mapping[str, Any]:
    """Return the names of all options of `build` and of the models, with their types."""
    hints = get_type_hints(build)
    own = [one.name for one in signature(build).parameters.values() if one.kind is one.KEYWORD_ONLY]
    of_models = {name: kind for model in MODELS.values() for name, kind in model.OPTIONS.items()}
    return {**{name: hints[name] for name in own}, **of_models}


def _add_memory(graph: Sensorgraph, feed: TrainingData, progress: ProgressBars) -> Sensorgraph:
    scans = all_scans(feed)
    assert scans is not None
    with progress("identifying memory", "scans") as tick:
        return with_memory(graph, scans, tick)


def _fit(
    feed: TrainingData,
    model: type[Model],
    map_blocks: MapBlocks,
    progress: ProgressBars,
    options: dict[str, Any],
) -> Model:
    """Fit a model block by block if it supports that, otherwise to all scans together."""
    if issubclass(model, Faces) and not options.keys() - set(model.OPTIONS):
        mount = np.zeros(3) if feed.pose_frame == "laser" else feed.sensor.mount
        own = dict(options)
        wanted = own.pop("cells", None)
        try:
            fitted = model.fit_blocks(
                feed, feed.sensor, mount, n_scans=feed.n_scans, map_blocks=map_blocks,
                can_mount=feed.pose_frame != "laser", progress=progress, **own,
            )  # fmt: skip
        finally:
            _check_enough(feed)
        if not (fitted.is_cluttered if wanted is None else wanted):
            return fitted
        scans = all_scans(
            TrainingData(feed.logs, feed.names, split=feed.split, bounds=feed.bounds, force=feed.force)
        )
        assert scans is not None
        with progress("fitting cells", "steps") as tick:
            return fitted.with_cells(scans, progress=tick)
    scans = all_scans(feed)
    _check_enough(feed)
    assert scans is not None
    with progress(f"fitting {model.name}", "steps") as tick:
        return model.fit(scans, progress=tick, **options)


def can_update(graph: Sensorgraph) -> bool:
    """Tell whether runs can be added to a graph."""
    model = graph.model
    return isinstance(model, CellModel) or (isinstance(model, Faces) and model.statistics is not None)


def _updated(
    graph: Sensorgraph,
    feed: TrainingData,
    feed_again: Callable[[], TrainingData],
    map_blocks: MapBlocks,
    progress: ProgressBars,
    options: dict[str, Any],
) -> Sensorgraph:
    """Add the runs of a feed to a graph."""
    model = graph.model
    if not isinstance(model, Faces | CellModel) or options:
        reason = f", and option {', '.join(sorted(options))} applies to a new fit only" if options else ""
        raise SensorgraphError(
            f"`update` adds runs to a graph of faces or cells; this one is of {model.name}{reason}"
        )
    of_log = feed.logs[0].head.sensor
    sensor = with_rays_like(of_log, graph.sensor.bearings)
    if sensor is None:
        raise SensorgraphError(
            f"{feed.names[0]} has {of_log.n_rays} rays at other bearings than the {graph.sensor.n_rays} of the graph "
            f"({bearings_text(of_log.bearings, graph.sensor.bearings)}); build one graph for each sensor"
        )
    feed.sensor = sensor
    if feed.pose_frame != graph.pose_frame:
        raise SensorgraphError(
            f"{feed.names[0]} has poses of {feed.pose_frame}, the graph of {graph.pose_frame}; expected the same frame"
        )
    if feed.split != graph.origin["split"]:
        raise SensorgraphError(
            f"the graph was built with split {graph.origin['split']}; update it with the same split"
        )
    fitted: Faces | CellModel = model
    if isinstance(model, Faces):
        fitted = model.updated(feed, n_scans=feed.n_scans, map_blocks=map_blocks, progress=progress)
    cells = fitted if isinstance(fitted, CellModel) else fitted.cells
    if cells is not None:
        again = feed_again() if isinstance(model, Faces) else feed
        again.sensor = sensor
        scans = all_scans(again)
        if scans is None:
            raise SensorgraphError(_too_few(0, again.entries))
        with progress("fitting cells", "steps") as tick:
            cells = cells.updated(scans, progress=tick)
        fitted = cells if isinstance(fitted, CellModel) else replace(fitted, cells=cells)
    _check_enough(feed)
    known = {entry["sha256"] for entry in graph.origin["inputs"]}
    for entry in feed.entries:
        if entry["sha256"] in known:
            raise SensorgraphError(f"{entry['name']} is part of the graph already; add only new runs")
    origin = {**graph.origin, "inputs": [*graph.origin["inputs"], *feed.entries]}
    return replace(graph, model=fitted, origin=origin)


def _check_enough(feed: TrainingData) -> None:
    """Refuse a fit with too few scans, once all logs have been read."""
    n_trained = sum(entry["trained"] for entry in feed.entries)
    if len(feed.entries) == len(feed.logs) and n_trained < MIN_SCANS:
        raise SensorgraphError(_too_few(n_trained, feed.entries))


def digest(run: Run) -> str:
    """Return the sha256 of a run's bearings and ranges; it does not depend on the file's layout or the poses."""
    total = begin_digest(run.sensor)
    total.update(ranges_bytes(run.ranges))
    return total.hexdigest()


def training_scans(graph: Sensorgraph, run: Run) -> Bools | None:
    """Return a mask (n_scans,) of the scans of a run that the graph was fitted to; None for an unknown run."""
    mine = digest(run)
    for entry in graph.origin["inputs"]:
        if entry["sha256"] == mine:
            return pair(run).paired & ~held_out(run, graph.origin["split"])
    return None


def _check_alike(runs: Sequence[Run], names: Sequence[str]) -> None:
    if not runs:
        raise SensorgraphError("no run to build from; give one recording or more")
    first = runs[0]
    for name, run in zip(names[1:], runs[1:], strict=True):
        if ray_order(run.sensor.bearings, first.sensor.bearings) is None:
            raise SensorgraphError(
                f"{name} has {run.sensor.n_rays} rays at other bearings than the {first.sensor.n_rays} of {names[0]} "
                f"({bearings_text(run.sensor.bearings, first.sensor.bearings)}); build one graph for each sensor"
            )
        if run.pose_frame != first.pose_frame:
            raise SensorgraphError(
                f"{name} has poses of {run.pose_frame}, {names[0]} of {first.pose_frame}; "
                "expected runs with poses in one frame"
            )


def _name(run: Run | LogStream, i: int) -> str:
    """Return the file's name without its folder, so that the graph does not depend on the folder."""
    run = run if isinstance(run, Run) else run.head
    return PurePath(run.meta["source"]).name if "source" in run.meta else f"run {i}"


def _too_few(n: int, inputs: Sequence[dict[str, Any]]) -> str:
    reasons = "; ".join(
        f"{entry['name']}: {entry['paired']} of {entry['n_scans']} scans have a pose"
        + (f", {entry['empty']} of them without a valid range" if entry["empty"] else "")
        + (f", {entry['held_out']} held out" if entry["held_out"] else "")
        + "".join(f", {count} {why}" for why, count in entry["dropped"].items())
        for entry in inputs
    )
    return (
        f"{n} scans to fit, expected {MIN_SCANS} or more ({reasons}); "
        "record poses with the scans, or select their topic with `topics` pose=NAME"
    )
