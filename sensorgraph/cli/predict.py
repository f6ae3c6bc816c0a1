"""`sensorgraph predict`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sensorgraph.cli.options import GraphFile

PredictPoses = Annotated[Path, typer.Option(help="CSV with columns x,y,phi (m, m, rad, or with units).")]
PredictOutput = Annotated[Path, typer.Option("-o", "--out", metavar="NPZ", help="File to write, *.npz.")]
PredictPoint = Annotated[str, typer.Option(help="Point value in `ranges`: mode, median or mean.")]


def predict(
    graph: GraphFile,
    poses: PredictPoses,
    output: PredictOutput,
    point: PredictPoint = "mode",
) -> None:
    """Predict every ray at given poses: range, sigma, probability of no return, answered or not.

    Writes the arrays ranges, median, mode, mean, sigma, p_no_return and
    answered, each (n_poses, n_rays).

    Examples:

      sensorgraph predict square.sensorgraph --poses poses.csv -o predicted.npz
    """
    from typing import cast

    from sensorgraph.cli.inputs import check_output
    from sensorgraph.cli.progress import progress
    from sensorgraph.graph import Sensorgraph
    from sensorgraph.loading import read_poses
    from sensorgraph.models.base import Point

    check_output(output, graph, poses, suffix=".npz")
    model = Sensorgraph.load(graph)
    where = read_poses(poses)
    with progress("predicting", "poses") as tick:
        result = model.predict(where, point=cast(Point, point), progress=tick)
    result.save(output)
    typer.echo(
        f"wrote {output}: {len(where):,} poses of {model.pose_frame} x {model.sensor.n_rays} rays, "
        f"{100 * float(result.answered.mean()):.1f} % answered"
    )
