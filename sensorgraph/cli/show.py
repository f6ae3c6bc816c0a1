"""`sensorgraph show`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def show(
    graph: Annotated[Path, typer.Argument(metavar="GRAPH", help="A *.sensorgraph file.")],
    ray: Annotated[int | None, typer.Option(help="Print the equation of this ray, given by index.")] = None,
) -> None:
    """Say what a sensorgraph is, or print the equation of one ray.

    Examples:

      sensorgraph show square.sensorgraph

      sensorgraph show square.sensorgraph --ray 67
    """
    from math import degrees

    from sensorgraph.graph import Sensorgraph

    model = Sensorgraph.load(graph)
    if ray is not None:
        typer.echo(model.equation(ray))
        low, high = model.sensor.range_min, model.sensor.range_max
        typer.echo(f"predictions are held between {low:g} and {high:g} m, the limits of the sensor")
        return
    sensor, origin = model.sensor, model.origin
    first, last = degrees(sensor.bearings[0]), degrees(sensor.bearings[-1])
    options = (
        ", ".join(f"{name} {value}" for name, value in origin["options"].items())
        or "all chosen automatically"
    )
    lines = [
        ("model", model.model.name),
        (
            "sensor",
            f"{sensor.n_rays} rays from {first:.1f} to {last:.1f} deg, "
            f"{sensor.range_min:g} to {sensor.range_max:g} m, sigma {sensor.sigma:g} m",
        ),
        ("poses", f"of {model.pose_frame} in map"),
        *model.model.summary().items(),
        ("options", options),
        ("split", f"{origin['split']} held out" if origin["split"] else "none: all scans were fitted"),
    ]
    for entry in origin["inputs"]:
        dropped = "".join(f", {count} {why}" for why, count in entry["dropped"].items())
        lines.append(
            (
                "run",
                f"{entry['name']}: {entry['paired']} of {entry['n_scans']} scans paired{dropped}, "
                f"{entry['held_out']} held out, {entry['trained']} fitted; sha256 {entry['sha256'][:12]}",
            )
        )
    lines.append(("made by", f"sensorgraph {origin['software']}"))
    for label, text in lines:
        typer.echo(f"{label:<10} {text}")
