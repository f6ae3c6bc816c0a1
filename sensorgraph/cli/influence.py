"""`sensorgraph influence`."""

from __future__ import annotations

from math import isfinite
from pathlib import Path
from typing import Annotated, Any

import typer

from sensorgraph.cli.options import GraphFile

ControllerFile = Annotated[
    Path, typer.Argument(metavar="CONTROLLER", help="controller.json of `design`, a model of the turn rate.")
]
InfluenceStart = Annotated[str, typer.Option(help="Start pose X,Y,PHI (m, m, rad) of every drive.")]
InfluenceVary = Annotated[
    list[str] | None,
    typer.Option(
        "--vary", metavar="NAME=LOW:HIGH", help="Factor to vary, with its range; repeatable; default: all."
    ),
]
InfluenceRows = Annotated[
    int,
    typer.Option(help="Rows of the sample, a power of 2; the number of drives is rows × (factors + 2)."),
]
InfluenceDuration = Annotated[float, typer.Option(help="Duration of a drive (s).")]
InfluenceRobot = Annotated[
    Path | None, typer.Option(help="robot.yaml; default: the shipped robot, with the laser of the graph.")
]
InfluenceSeed = Annotated[int, typer.Option(min=0, help="Random seed of all noise; same seed, same bytes.")]
InfluenceOut = Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Folder for the results.")]


def influence(
    graph: GraphFile,
    controller: ControllerFile,
    start: InfluenceStart,
    out: InfluenceOut,
    vary: InfluenceVary = None,
    rows: InfluenceRows = 64,
    duration: InfluenceDuration = 90.0,
    robot: InfluenceRobot = None,
    seed: InfluenceSeed = 0,
) -> None:
    """Estimate how much the robot, the sensor and the environment each influence a behaviour.

    One controller drives many times in the identified world while factors
    vary. Writes influence.json and influence.png with Sobol indices and
    their 95 % intervals.

    Factors: noise (m), scale, yaw (rad), wheels (assumed over true base),
    tau (s), delay (s), obstacle (m that a disc protrudes from the wall).

    Examples:

      sensorgraph influence lab.sensorgraph runs/design/controller.json --start 1,0.5,0 -o runs/influence

      sensorgraph influence lab.sensorgraph c.json --start 1,0.5,0 --vary noise=0:0.05 --vary delay=0:0.3 -o runs/i
    """
    from sensorgraph.cli.inputs import check_folder, parse_pose, write_json
    from sensorgraph.cli.progress import progress
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.graph import Sensorgraph
    from sensorgraph.identification.influence import influence as find_influence
    from sensorgraph.identification.influence import table
    from sensorgraph.loading import robot_in_graph
    from sensorgraph.recording.controllers import PolynomialController
    from sensorgraph.show.figures.influence import influence_picture

    check_folder(out)
    place = parse_pose(start).tolist()
    factors = dict(map(_factor, vary)) if vary else None
    if not controller.is_file():
        raise SensorgraphError(f"{controller} does not exist; write one with `sensorgraph design`")
    model = Sensorgraph.load(graph)
    machine = robot_in_graph(model, robot)
    steer = PolynomialController.load(controller, machine)
    settings: dict[str, Any] = {"factors": factors, "rows": rows, "duration": duration, "seed": seed}
    with progress("driving", "scans") as tick:
        found = find_influence(model, steer, machine, place, **settings, progress=tick)
    files = [out / "influence.json", out / "influence.png"]
    out.mkdir(parents=True, exist_ok=True)
    made = {
        "graph": graph.name,
        "controller": controller.name,
        "robot": machine.name,
        "seed": seed,
        "rows": rows,
    }
    write_json(files[0], {**found.to_dict(), **made})
    influence_picture(found, files[1])
    typer.echo(f"{found.n_drives:,} drives of {duration:g} s")
    for line in table(found):
        typer.echo(line)
    typer.echo(f"wrote {', '.join(map(str, files))}")


def _factor(text: str) -> tuple[str, tuple[float, float]]:
    from sensorgraph.errors import SensorgraphError

    name, _, span = text.partition("=")
    try:
        low, high = map(float, span.split(":"))
        if isfinite(low) and isfinite(high):
            return name.strip(), (low, high)
    except ValueError:
        pass
    raise SensorgraphError(f"--vary is {text}, expected NAME=LOW:HIGH, such as noise=0:0.05")
