"""Picture of a sensorgraph: its faces or cells, and the residuals of a run."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from logs.motion import ray_poses
from logs.run import Run, pair
from sensorgraph.errors import SensorgraphError
from sensorgraph.evaluation.evaluate import evaluate, poses_for
from sensorgraph.graph import Sensorgraph
from sensorgraph.models.cells.model import CellModel
from sensorgraph.models.faces.model import Faces
from sensorgraph.show.figures.face_pieces import MAX_RESIDUAL
from sensorgraph.show.figures.model_figure import model_figure
from sensorgraph.show.figures.style import save_figure
from sensorgraph.types import Floats
from sensorgraph.world.raycast import laser_poses


def graph_picture(graph: Sensorgraph, path: Path, *, run: Run | None = None) -> None:
    """Draw a sensorgraph of faces or cells, and the residuals of a run, as PNG; see `model_figure`.

    Raises
    ------
    SensorgraphError : The model has no geometry or no surface, or no ray of the run is predicted.
    """
    model = graph.model
    if not isinstance(model, (Faces, CellModel)):
        raise SensorgraphError(
            f"the model {model.name} has neither faces nor cells to draw; build a model of faces, "
            "or use `sensorgraph review`"
        )
    residuals = None if run is None else predicted_ends(graph, run)
    if residuals is not None and len(residuals[0]) == 0:
        raise SensorgraphError(
            "no ray of the run agrees with the graph, so there is nothing to draw; give a run of the same place"
        )
    save_figure(model_figure(model, residuals), path)


def predicted_ends(graph: Sensorgraph, run: Run) -> tuple[Floats, Floats, Floats]:
    """Return predicted end points (n, 2), directions (n, 2) and residuals (n,) [m] of the answered rays of a run.

    Rays with a residual above MAX_RESIDUAL are left out, because they hit another surface.
    """
    evaluation = evaluate(graph, run, force=True)
    poses = ray_poses(run, pair(run), evaluation.scan_indices)  # (n, n_rays or 1, 3)
    poses = poses_for(graph, run.pose_frame, run.sensor.mount, poses)
    assert isinstance(graph.model, (Faces, CellModel))
    lasers = laser_poses(poses, graph.model.mount)
    bearing = lasers[..., 2] + graph.sensor.bearings
    directions = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    ends = lasers[..., :2] + evaluation.prediction.mode[..., None] * directions
    use = (
        np.abs(np.nan_to_num(evaluation.residual, nan=np.inf)) < MAX_RESIDUAL
    ) & evaluation.prediction.answered
    use &= evaluation.prediction.p_no_return < 0.5
    return ends[use], directions[use], evaluation.residual[use]
