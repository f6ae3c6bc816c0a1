"""`sensorgraph predict`."""

from __future__ import annotations

import typer

from sensorgraph.cli.options import GraphFile, PredictOutput, PredictPoint, PredictPoses

ARRAYS = ("ranges", "median", "mode", "mean", "sigma", "p_no_return", "answered")


def predict(
    graph: GraphFile,
    poses: PredictPoses,
    output: PredictOutput,
    point: PredictPoint = "mode",
) -> None:
    """Predict every ray at given poses.

    Writes arrays ranges, median, mode, mean, sigma, p_no_return and answered, all (n_poses, n_rays).

    Examples:

      sensorgraph predict square.sensorgraph --poses poses.csv -o predicted.npz
    """
    from typing import cast

    import numpy as np

    from sensorgraph.cli.inputs import check_output, read_poses
    from sensorgraph.files import whole
    from sensorgraph.graph import Sensorgraph
    from sensorgraph.models.base import Point

    check_output(output, graph, poses)
    model = Sensorgraph.load(graph)
    where = read_poses(poses)
    result = model.predict(where, point=cast(Point, point))
    with whole(output) as part, part.open("wb") as file:
        np.savez_compressed(file, **{name: getattr(result, name) for name in ARRAYS})
    typer.echo(
        f"wrote {output}: {len(where)} poses of {model.pose_frame} x {model.sensor.n_rays} rays, "
        f"{100 * float(result.answered.mean()):.1f} % answered"
    )
