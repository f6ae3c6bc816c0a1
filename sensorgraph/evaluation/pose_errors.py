"""Errors of the poses of a run, estimated by its readings from the faces of a graph.

A reading from a pose that is 2 mm and 0.1° off differs from the prediction for that pose, and at an edge it shows another
surface. What a graph states about readings of a log has to contain these errors.
"""

from __future__ import annotations

import numpy as np

from logs.transforms import compose
from sensorgraph.models.base import Model, TrainingScans
from sensorgraph.models.calibration.matching import match_readings, readings_of
from sensorgraph.models.calibration.pose_refinement import exceeds_max_noise, refine_poses
from sensorgraph.models.calibration.settings import CALIBRATION
from sensorgraph.models.cones.settings import measures_cones
from sensorgraph.models.faces.model import Faces
from sensorgraph.models.faces.reduction import Block, reduce_block
from sensorgraph.models.faces.thin_rays import noise_of_poses

PASSES = 2
"""Number of estimates; the second one takes the errors of the first into account where it assigns readings to faces."""


def pose_errors_of(model: Model, scans: TrainingScans) -> tuple[float, float]:
    """Return the standard deviations of x and y [m] and of phi [rad] of the poses of scans; 0 without evidence of errors.

    They are 0, too, if the spread of the model contains the pose errors of its own logs (cells, cones, polynomials), and if
    model and scans do not belong together.

    Parameters
    ----------
    scans : Scans with poses and rays as the model has them.
    """
    if not isinstance(model, Faces) or model.cells is not None or measures_cones(model.sensor):
        return 0.0, 0.0
    sample = reduce_block(Block(first=0, scans=scans), mount=model.mount, share=1.0).sample
    readings, poses = readings_of(sample, model.sensor)
    lasers = compose(poses, model.mount)
    shifts = np.zeros((int(readings.scan.max(initial=-1)) + 1, 3))
    noise, terms = noise_of_poses(model, None, None), model.calibration.terms
    for _ in range(PASSES):
        matches = match_readings(readings, lasers, terms, model.faces, noise, 0.0)
        found = refine_poses(readings, lasers, matches, model.faces, shifts, noise)
        if found.log_evidence < CALIBRATION.min_gain or exceeds_max_noise(found.sigma_xy, found.sigma_yaw):
            return 0.0, 0.0
        noise = noise_of_poses(model, found.sigma_xy, found.sigma_yaw)
    return found.sigma_xy, found.sigma_yaw
