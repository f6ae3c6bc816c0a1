"""The ray caster as a baseline: its prediction of a run, with the arena as mapped and with amending effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import ndtr

from logs.motion import Motion, motion_of
from logs.run import RangeSensor, Run, pair
from planners.arena import Arena
from sensorgraph.effects import Amendment
from sensorgraph.errors import SensorgraphError
from sensorgraph.evaluation.evaluate import Evaluation
from sensorgraph.evaluation.metrics import POINT_OF, Metrics, MetricSums
from sensorgraph.models.base import OFF_DISTANCE, Point, Prediction
from sensorgraph.models.mixture import gaussian_prediction
from sensorgraph.types import Ints, Progress
from sensorgraph.work_counter import WorkCounter
from sensorgraph.world.ray_order import with_rays_like
from sensorgraph.world.scene import Scene, Transform, fade
from sensorgraph.world.simulate import SCANS_PER_STEP


def compare(
    result: Evaluation, run: Run, arena: Arena, sensor: RangeSensor, effects: Sequence[Amendment], *,
    point: Point | None = None, progress: Progress | None = None,
) -> dict[str, Metrics]:  # fmt: skip
    """Score the ray caster on the rays that a graph was scored on: `nominal` as mapped, and `amended` by effects.

    Parameters
    ----------
    sensor : Sensor of the run as specified in robot.yaml.
    effects : Only effects of the scan channel are used; those of odometry and drive are ignored.
    """
    described = with_rays_like(sensor, run.sensor.bearings)
    if described is None:
        raise SensorgraphError(
            "the robot kept in the run has another sensor than the run; effects cannot be evaluated"
        )
    scored, measured = np.isfinite(result.residual), run.ranges[result.scan_indices]
    out: dict[str, Metrics] = {}
    scan = [a for a in effects if a.effect.channel == "scan"]
    work = WorkCounter(progress, 2)
    for name, some in (("nominal", ()), ("amended", scan)):
        sums = MetricSums(bearings=run.sensor.bearings, point=point, sigma=result.settings["sigma_m"])
        prediction = predict(run, arena, described, result.scan_indices, some, progress=work.part(1))
        work.add(1)
        sums.add(measured, prediction, scored, ~np.isnan(measured))
        value = prediction.point(point or POINT_OF["median_m"])
        out[name] = sums.metrics(np.abs(value[scored] - measured[scored]))
    return out


def predict(
    run: Run, arena: Arena, sensor: RangeSensor, scans: Ints, effects: Sequence[Transform], *,
    progress: Progress | None = None,
) -> Prediction:  # fmt: skip
    """Predict some scans (n,) of a run from its reference poses; people are modelled as a probability of short readings."""
    motion = motion_of(run) if sensor.has_ray_delays else _motion_of_scans(run)
    if run.pose_frame == "laser":
        sensor = replace(sensor, mount=np.zeros(3))
    parts = []
    for start in range(0, len(scans), SCANS_PER_STEP):
        if progress is not None:
            progress(start, len(scans))
        scene = Scene(
            arena=arena,
            sensor=sensor,
            stamps=run.stamps[scans[start : start + SCANS_PER_STEP]],
            motion=motion.at,
            span=float(run.stamps[-1] - run.stamps[0]),
            begin=float(run.stamps[0]),
        )
        scene.run(effects)
        parts.append(_prediction_of(scene))
    return Prediction.concatenate(parts)


def _motion_of_scans(run: Run) -> Motion:
    """Return the motion through the reference poses at the stamps of the scans."""
    pairing = pair(run)
    poses = pairing.poses[pairing.paired]
    return Motion(
        stamps=run.stamps[pairing.paired], poses=np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])])
    )


def _prediction_of(scene: Scene) -> Prediction:
    """Convert what a scene expects to a prediction."""
    beams, sensor = scene.beams, scene.sensor
    shape = beams.reading.shape
    sigma = np.broadcast_to(np.maximum(beams.sigma, 1e-6), shape)
    beyond = np.where(np.isfinite(beams.reading), fade(beams.reading - sensor.range_max, sigma), 1.0)
    p_no_return = 1 - (1 - beyond) * beams.p_return
    value = np.minimum(beams.reading, sensor.range_max)
    p_outlier = 1 - (1 - scene.shorts) * (1 - scene.outliers)
    p_off = p_outlier + (1 - p_outlier) * 2 * ndtr(-OFF_DISTANCE / sigma)
    return gaussian_prediction(value, sigma, p_no_return, p_off, np.ones(shape, dtype=np.bool_))
