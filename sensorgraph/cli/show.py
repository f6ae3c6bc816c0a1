"""`sensorgraph show`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sensorgraph.cli.options import Bearing, GraphFile, TopicsByExample

if TYPE_CHECKING:
    from sensorgraph.graph import Sensorgraph


ShowRay = Annotated[
    int | None, typer.Option(metavar="INDEX", help="Print the equation of the ray with this index.")
]
ShowAll = Annotated[
    bool,
    typer.Option(
        "--all", help="Print all faces of the ray, also those that stop it at less than 1 % of poses."
    ),
]
ShowFigure = Annotated[
    Path | None,
    typer.Option(
        "-o",
        "--out",
        metavar="PNG",
        help="Draw faces, visibility and unobserved space to this *.png file.",
    ),
]
ShowRun = Annotated[
    Path | None, typer.Option(help="With --out: run whose mean residuals are drawn on the faces.")
]


def show(
    graph: GraphFile,
    ray: ShowRay = None,
    bearing: Bearing = None,
    every: ShowAll = False,
    figure: ShowFigure = None,
    run: ShowRun = None,
    topic: TopicsByExample = None,
) -> None:
    """Show the content of a sensorgraph, print the equation of one ray, or draw its faces.

    Examples:

      sensorgraph show square.sensorgraph

      sensorgraph show square.sensorgraph --ray 67

      sensorgraph show square.sensorgraph --bearing 45 --all

      sensorgraph show square.sensorgraph --run run.mcap -o faces.png
    """
    from math import degrees

    from sensorgraph.cli.messages import with_flags
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.graph import Sensorgraph
    from sensorgraph.models.faces.model import Faces
    from sensorgraph.show.rays import chosen_ray

    if run is not None and figure is None:
        raise SensorgraphError("--run is for the picture; give the picture's name with -o faces.png")
    if every and ray is None and bearing is None:
        raise SensorgraphError("--all is for the equation of a ray; give --ray INDEX or --bearing DEG")
    model = Sensorgraph.load(graph)
    ray = chosen_ray(model.sensor, ray, bearing)
    if figure is not None:
        _draw(model, figure, graph, run, topic or [])
        if ray is None:
            return
    if ray is not None:
        text = model.equation(ray)
        if isinstance(model.model, Faces) and not every:
            text = model.model.equation(ray, every=False)
        typer.echo(with_flags(text))
        low, high = model.sensor.range_min, model.sensor.range_max
        typer.echo(f"predictions are limited to {low:g} ... {high:g} m, the range of the sensor")
        return
    sensor, origin = model.sensor, model.origin
    first, last = degrees(sensor.bearings[0]), degrees(sensor.bearings[-1])
    options = ", ".join(f"{name} {value}" for name, value in origin["options"].items()) or "all automatic"
    lines = [
        ("model", model.model.name),
        (
            "sensor",
            f"{sensor.n_rays} rays from {first:.1f} to {last:.1f} deg, "
            f"{sensor.range_min:g} to {sensor.range_max:g} m, sigma {sensor.sigma:g} m",
        ),
        ("poses", f"of {model.pose_frame} in map"),
        *model.facts().items(),
        ("options", options),
        (
            "split",
            f"{origin['split']} held out" if origin["split"] else "none: all scans are used for the fit",
        ),
    ]
    for entry in origin["inputs"]:
        dropped = "".join(f", {count:,} {why}" for why, count in entry["dropped"].items())
        lines.append(
            (
                "run",
                f"{entry['name']}: {entry['paired']:,} of {entry['n_scans']:,} scans paired{dropped}, "
                f"{entry['held_out']:,} held out, {entry['trained']:,} fitted; sha256 {entry['sha256'][:12]}",
            )
        )
    lines.append(("made by", f"sensorgraph {origin['software']}"))
    width = max(len(label) for label, _ in lines)
    for label, text in lines:
        typer.echo(f"{label:<{width}}  {text}")


def _draw(model: Sensorgraph, figure: Path, graph: Path, run: Path | None, topics: list[str]) -> None:
    """Draw a graph, with the residuals of a run if there is one."""
    from logs import parse_topics
    from sensorgraph.cli.inputs import check_output, read_run
    from sensorgraph.show.figures.sensorgraph import graph_picture

    check_output(figure, graph, run, suffix=".png")
    log = None if run is None else read_run(run, {"topics": parse_topics(topics)})
    graph_picture(model, figure, run=log)
    typer.echo(f"wrote {figure}")
