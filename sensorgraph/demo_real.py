"""Run the loop on a real log: poses from scans and wheels, graph, held-out evaluation, wheel parameters, review."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np

import logs
from logs.files import atomic_file
from logs.run import Run
from logs.transforms import compose, distances_along, invert
from sensorgraph.building.build import build
from sensorgraph.evaluation.evaluate import Evaluation, evaluate
from sensorgraph.graph import Sensorgraph
from sensorgraph.localization.locate import LocatedRun, locate, located_run, poses_csv
from sensorgraph.localization.odometry import odometry_at_scans, odometry_of
from sensorgraph.localization.wheels import corrected_steps
from sensorgraph.show.figures.localization import localization_picture
from sensorgraph.show.review.review import review
from sensorgraph.types import Floats, ProgressBars

LOG = "fr079.clf.bz2"
"""The shipped log; `fr079.ATTRIBUTION.md` next to it gives its origin."""
SPLIT = "block"
EVERY = 3
"""Use every third scan in the graph and the review, so that the demo takes two minutes; all scans are located."""
DRIFT_DISTANCE = 10.0
"""[m] Distance over which the drift of the odometry is reported."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RealDemo:
    """Results on the log."""

    found: LocatedRun
    graph: Sensorgraph
    held_out: Evaluation
    """Evaluation on the held-out parts of the log."""
    drift: tuple[float, float]
    """[m] Median error of the odometry after `DRIFT_DISTANCE`, as logged and with the estimated wheel parameters."""

    def to_dict(self) -> dict[str, Any]:
        """Return the results as plain data."""
        return {
            "log": LOG,
            "locate": {k: v for k, v in self.found.to_dict().items() if k not in ("closures", "stretches")},
            "closures": {"kept": len(self.found.kept), "refused": len(self.found.refused)},
            "odometry_error_after_10_m": {"as_logged_m": self.drift[0], "corrected_m": self.drift[1]},
            "evaluation": self.held_out.to_dict(),
        }


def demo_real(folder: Path, *, progress: ProgressBars) -> RealDemo:
    """Run the loop on the shipped log; write log, run, poses, graph, review and picture to `folder`."""
    log = folder / LOG
    with as_file(files("sensorgraph.data") / LOG) as shipped, atomic_file(log) as part:
        part.write_bytes(shipped.read_bytes())
    with as_file(files("sensorgraph.data") / "fr079.ATTRIBUTION.md") as attribution:
        (folder / attribution.name).write_bytes(attribution.read_bytes())
    with progress("reading", "lines") as tick:
        raw = logs.read(log, progress=tick)
    found = LocatedRun.of(raw, locate(raw, progress=progress))
    run = located_run(raw, found)
    logs.write(run, folder / "located.mcap")
    (folder / "poses.csv").write_text(poses_csv(found), encoding="utf-8")
    localization_picture(raw, found, folder / "map.png")
    some = every_nth(run, EVERY)
    graph = build([some], split=SPLIT, names=["located.mcap"], calibrate=False, progress=progress)
    graph.save(folder / "fr079.sensorgraph")
    with progress("evaluating", "scans") as tick:
        held_out = evaluate(graph, some, split=SPLIT, progress=tick)
    review(some, path=folder / "review.rrd", graph=graph, name="located.mcap")
    return RealDemo(found=found, graph=graph, held_out=held_out, drift=odometry_drift(found))


def every_nth(run: Run, n: int) -> Run:
    """Return the run with every n-th scan and all other signals."""
    return run.take_scans(slice(None, None, n))


def odometry_drift(found: LocatedRun) -> tuple[float, float]:
    """Return the median error [m] of the odometry after `DRIFT_DISTANCE`, as logged and corrected; nan without odometry."""
    motion = odometry_of(found.run)
    if motion is None or found.wheels is None:
        return float("nan"), float("nan")
    odometry = odometry_at_scans(found.run, motion)
    steps = compose(invert(odometry[:-1]), odometry[1:])
    wheels = found.wheels
    better_steps = corrected_steps(steps, wheels.way_scale, wheels.turn_scale, wheels.heading_bias)
    better = np.zeros_like(odometry)
    for k, step in enumerate(better_steps):
        better[k + 1] = compose(better[k], step)
    driven = distances_along(found.poses)
    first = np.arange(0, len(driven), 10)
    last = np.searchsorted(driven, driven[first] + DRIFT_DISTANCE)
    first, last = first[last < len(driven)], last[last < len(driven)]
    if len(first) == 0:
        return float("nan"), float("nan")
    true = compose(invert(found.poses[first]), found.poses[last])
    as_logged, corrected = (_median_error(poses, first, last, true) for poses in (odometry, better))
    return as_logged, corrected


def _median_error(poses: Floats, first: np.ndarray, last: np.ndarray, true: Floats) -> float:
    relative = compose(invert(poses[first]), poses[last])
    return float(np.median(np.hypot(*(relative - true)[:, :2].T)))
