"""Build a sensorgraph from runs: pair scans with poses, hold some out, fit a model of MODELS."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Sequence
from pathlib import PurePath
from typing import Any

import numpy as np

from logs.run import Run, pair
from planners.arena import Arena
from sensorgraph import __version__
from sensorgraph.errors import GapError
from sensorgraph.graph import Sensorgraph
from sensorgraph.models import MODELS
from sensorgraph.models.base import Bools, Floats, Progress, Scans
from sensorgraph.split import held_out

logger = logging.getLogger(__name__)

MIN_SCANS = 10


def build(
    runs: Sequence[Run],
    *,
    arena: Arena | None = None,
    model: str = "faces",
    split: str | None = None,
    names: Sequence[str] | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> Sensorgraph:
    """Fit a model to every scan that has a pose and is not held out.

    Parameters
    ----------
    runs : recordings of one sensor, with poses of one frame
    arena : its bounds give the scale of x and y, so that graphs of several runs share it
    model : a name in MODELS
    names : what to call each run in messages and in the graph; None: the file it says it came from
    split : `every10` or `block` hold scans out of each run; the graph remembers it
    options : for the model; the polynomial takes `degree`, `harmonics`, `n_terms`, each a number or `auto`
    """
    if model not in MODELS:
        raise GapError(f"model is {model!r}, expected one of {', '.join(MODELS)}")
    names = [_name(run, i) for i, run in enumerate(runs)] if names is None else names
    _check_alike(runs, names)
    inputs: list[dict[str, Any]] = []
    poses, ranges, owner = [], [], []
    for i, (run, name) in enumerate(zip(runs, names, strict=True)):
        pairing = pair(run)
        held = held_out(run, split)
        empty = np.isnan(run.ranges).all(axis=1)
        use = pairing.paired & ~held & ~empty
        inputs.append(
            {
                "name": name,
                "sha256": digest(run),
                "n_scans": run.n_scans,
                "paired": int(pairing.paired.sum()),
                "dropped": dict(pairing.dropped),
                "held_out": int((held & pairing.paired).sum()),
                "empty": int((empty & pairing.paired & ~held).sum()),
                "trained": int(use.sum()),
            }
        )
        logger.info("%s: %s", name, pairing)
        poses.append(pairing.poses[use])
        ranges.append(run.ranges[use])
        owner.append(np.full(int(use.sum()), i, dtype=np.intp))
    n_trained = sum(entry["trained"] for entry in inputs)
    if n_trained < MIN_SCANS:
        raise GapError(_too_few(n_trained, inputs))
    scans = Scans(
        sensor=runs[0].sensor,
        poses=np.concatenate(poses),
        ranges=np.concatenate(ranges) if len(ranges) > 1 else ranges[0],
        run=np.concatenate(owner),
        bounds=None if arena is None else arena.bounds,
        pose_frame=runs[0].pose_frame,
    )
    fitted = MODELS[model].fit(scans, progress=progress, **options)
    origin = {
        "software": __version__,
        "inputs": inputs,
        "split": split,
        "options": {name: options[name] for name in sorted(options)},
        "arena_bounds": None if arena is None else list(arena.bounds),
    }
    return Sensorgraph(model=fitted, sensor=runs[0].sensor, pose_frame=runs[0].pose_frame, origin=origin)


def digest(run: Run) -> str:
    """Return the sha256 of what a run measured: scans, reference poses and bearings, not its file's layout."""
    total = hashlib.sha256()
    for array in (run.stamps, run.ranges, run.pose_stamps, run.poses, run.sensor.bearings):
        total.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
    return total.hexdigest()


def is_same_sensor(a: Floats, b: Floats) -> bool:
    """Tell whether two sensors have the same bearings (n_rays,) to a thousandth of a radian."""
    return len(a) == len(b) and bool(np.allclose(a, b, rtol=0, atol=1e-3))


def training_scans(graph: Sensorgraph, run: Run) -> Bools | None:
    """Tell which scans (n_scans,) of a run the graph was fitted to; None if it has not seen this run."""
    mine = digest(run)
    for entry in graph.origin["inputs"]:
        if entry["sha256"] == mine:
            return pair(run).paired & ~held_out(run, graph.origin["split"])
    return None


def _check_alike(runs: Sequence[Run], names: Sequence[str]) -> None:
    if not runs:
        raise GapError("no run to build from; give at least one recording")
    first = runs[0]
    for name, run in zip(names[1:], runs[1:], strict=True):
        if not is_same_sensor(run.sensor.bearings, first.sensor.bearings):
            raise GapError(
                f"{name} has {run.sensor.n_rays} rays at other bearings than the {first.sensor.n_rays} of "
                f"{names[0]}; build one graph for each sensor"
            )
        if run.pose_frame != first.pose_frame:
            raise GapError(
                f"{name} has poses of {run.pose_frame}, {names[0]} of {first.pose_frame}; "
                "build from runs whose poses are of one frame"
            )


def _name(run: Run, i: int) -> str:
    """Return the file's name without its folder, so that a graph does not depend on where the log lay."""
    return PurePath(run.meta["source"]).name if "source" in run.meta else f"run {i}"


def _too_few(n: int, inputs: Sequence[dict[str, Any]]) -> str:
    reasons = "; ".join(
        f"{entry['name']}: {entry['paired']} of {entry['n_scans']} scans have a pose"
        + (f", {entry['empty']} of them no valid range" if entry["empty"] else "")
        + (f", {entry['held_out']} held out" if entry["held_out"] else "")
        + "".join(f", {count} {why}" for why, count in entry["dropped"].items())
        for entry in inputs
    )
    return (
        f"{n} scans to fit, expected {MIN_SCANS} or more ({reasons}); "
        "record poses with the scans, or name their topic with --topic pose=NAME"
    )
