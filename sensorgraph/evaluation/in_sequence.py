"""Predictions of consecutive scans by models with memory: one step ahead, in free run, and persistence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from logs.run import Pairing, Run
from logs.sensor import median_step
from sensorgraph.evaluation.metrics import Metrics, MetricSums
from sensorgraph.graph import Sensorgraph
from sensorgraph.models.base import Point, Prediction
from sensorgraph.models.narmax.model import RayNarmax
from sensorgraph.models.narmax.sequences import ScanSequence, held, stretches
from sensorgraph.types import Bools, Floats, Ints

ONE_STEP, FREE_RUN, PERSISTENCE = "one_step", "free_run", "persistence"


def sequence_predictions(
    graph: Sensorgraph, run: Run, pairing: Pairing, poses: Floats, rays: Ints
) -> dict[str, Prediction]:
    """Predict every paired scan of a run from the preceding scans; empty for a model without memory.

    A stretch ends at a scan without a pose and at a gap in time; no lag crosses its ends. Lagged readings are the
    measured ones in `one_step` and the predicted ones in `free_run`. `persistence` repeats the last reading of a ray.

    Parameters
    ----------
    poses : (n_scans, 3) Poses in the graph's frame; nan where not paired.
    rays : (n_rays,) Index of the graph's ray for each ray of the run.

    Returns
    -------
    name -> Prediction (n_paired, n_rays), in the order of the run
    """
    model = graph.model
    if not isinstance(model, RayNarmax):
        return {}
    paired = pairing.paired
    period = median_step(run.stamps, np.inf)
    motion = ScanSequence(
        poses=poses[paired], stamps=run.stamps[paired], sequence=stretches(run.stamps, paired, period)
    )
    measured = np.empty((len(motion.poses), graph.sensor.n_rays))
    measured[:, rays] = run.ranges[paired]
    one_step = model.predict_sequence(motion, rays, measured)
    return {
        ONE_STEP: one_step,
        FREE_RUN: model.predict_sequence(motion, rays),
        PERSISTENCE: _persistence(measured[:, rays], motion.position, one_step),
    }


def _persistence(measured: Floats, position: Ints, like: Prediction) -> Prediction:
    """Return the last reading of each ray; `like` where the stretch has no earlier reading."""
    last = np.vstack([np.full((1, measured.shape[1]), np.nan), held(measured, position)[:-1]])
    lost = np.vstack([np.zeros((1, measured.shape[1])), np.isposinf(measured[:-1])]).astype(np.float64)
    value = np.where(np.isfinite(last) & (position > 0)[:, None], last, like.mode)
    return replace(
        like, ranges=np.where(lost > 0, np.inf, value), median=value, mode=value, mean=value, p_no_return=lost
    )


def sequence_metrics(
    predictions: Mapping[str, Prediction], rows: Ints, measured: Floats, scored: Bools, *, point: Point | None,
    bearings: Floats, sigma: float,
) -> dict[str, Metrics]:  # fmt: skip
    """Return the metrics of each prediction by name.

    Parameters
    ----------
    rows : (n_scans,) Rows of the predictions that are compared with `measured` (n_scans, n_rays) [m].
    scored : (n_scans, n_rays) Rays that count.
    """
    out = {}
    for name, whole in predictions.items():
        part, sums = whole.take(rows), MetricSums(bearings=bearings, point=point, sigma=sigma)
        sums.add(measured, part, scored, ~np.isnan(measured))
        out[name] = sums.metrics(np.abs(measured - part.point(point or "mode"))[scored])
    return out
