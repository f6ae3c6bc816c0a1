"""`sensorgraph design`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sensorgraph.cli.options import GraphFile

if TYPE_CHECKING:
    from sensorgraph.identification.design import ControllerDesign
    from sensorgraph.identification.design_task import DriveQuantities

RequestedWallDistance = Annotated[
    float, typer.Option(help="Target distance from the robot's centre to the nearest wall (m).")
]
RequestedSpeed = Annotated[float, typer.Option(help="Driving speed (m/s).")]
RequestedSmoothness = Annotated[
    float, typer.Option(help="Maximum root mean square change of the turn rate (rad/s^2).")
]
DesignInputs = Annotated[
    str,
    typer.Option(help="Controller inputs: mean range over rays between two angles from the robot's right."),
]
DesignDegree = Annotated[int, typer.Option(min=1, max=4, help="Degree of the polynomial.")]
DesignDuration = Annotated[float, typer.Option(help="Duration of the predicted drives (s).")]
DesignArena = Annotated[
    str | None,
    typer.Option(
        help="Arena to drive the controller in, for comparison: GeoJSON file, map_server yaml or shipped."
    ),
]
DesignRobot = Annotated[
    Path | None, typer.Option(help="robot.yaml; default: the shipped robot, with the laser of the graph.")
]
DesignSeed = Annotated[int, typer.Option(min=0, help="Random seed of all noise; same seed, same bytes.")]
DesignOut = Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Folder for the results.")]
LABELS = {
    "wall_distance_m": ("wall distance, mean", "m"),
    "wall_distance_5_m": ("– 5th percentile", "m"),
    "wall_distance_95_m": ("– 95th percentile", "m"),
    "speed_m_s": ("speed", "m/s"),
    "turn_change_rad_s2": ("change of turn rate, rms", "rad/s²"),
    "contacts": ("contacts", ""),
    "lap_s": ("lap", "s"),
}


def design(
    graph: GraphFile,
    wall_distance: RequestedWallDistance,
    out: DesignOut,
    speed: RequestedSpeed = 0.2,
    smoothness: RequestedSmoothness = 1.0,
    inputs: DesignInputs = "L0-30,L30-60,L75-105",
    degree: DesignDegree = 2,
    duration: DesignDuration = 90.0,
    arena: DesignArena = None,
    robot: DesignRobot = None,
    seed: DesignSeed = 0,
) -> None:
    """Design a polynomial controller in an identified world and predict its drives with 95 % intervals.

    Writes controller.json (for `record --controller`), design.json and
    design.png.

    Examples:

      sensorgraph design lab.sensorgraph --wall-distance 0.5 -o runs/design

      sensorgraph design lab.sensorgraph --wall-distance 0.5 --speed 0.3 --degree 1 --arena lab.geojson -o runs/design
    """
    from sensorgraph.cli.inputs import check_folder, write_json
    from sensorgraph.cli.progress import progress
    from sensorgraph.graph import Sensorgraph
    from sensorgraph.identification.design import design as design_controller
    from sensorgraph.identification.design import drive_design
    from sensorgraph.identification.design_task import DesignTask
    from sensorgraph.loading import load_arena, robot_in_graph
    from sensorgraph.show.figures.design import design_picture

    files = [out / name for name in ("controller.json", "design.json", "design.png")]
    check_folder(out)
    model = Sensorgraph.load(graph)
    machine = robot_in_graph(model, robot)
    walls = None if arena is None else load_arena(arena)
    task = DesignTask(wall_distance=wall_distance, speed=speed, smoothness=smoothness, duration=duration)
    names = tuple(name.strip() for name in inputs.split(","))
    with progress("designing", "rounds") as tick:
        found = design_controller(model, task, machine, inputs=names, degree=degree, seed=seed, progress=tick)
    driven = None if walls is None else drive_design(found, walls, machine, seed=seed)
    out.mkdir(parents=True, exist_ok=True)
    found.save(files[0])
    data = found.to_dict()
    if driven is not None:
        data["driven"] = {k: None if v != v else v for k, v in vars(driven[1]).items()}
        data["held"] = {k: i.holds(getattr(driven[1], k)) for k, i in found.prediction.items()}
    write_json(files[1], data)
    design_picture(found, files[2], None if driven is None else driven[0], walls)
    typer.echo(f"{found.model.equation()}   [rad/s; L in m; at {speed:g} m/s]")
    for line in _table(found, None if driven is None else driven[1]):
        typer.echo(line)
    if found.n_failed:
        typer.echo(
            f"warning: in {found.n_failed} of {len(found.tracks)} predicted drives the robot touches a wall, or does not "
            "keep it on its right; try another --seed, --wall-distance, --speed or --inputs",
            err=True,
        )
    typer.echo(f"wrote {', '.join(map(str, files))}")
    x, y, heading = found.start
    typer.echo(
        f"drive: sensorgraph record PLAN --controller {files[0]} --start {x:.2f},{y:.2f},{round(heading, 3) + 0.0:g} -o drive.mcap"
    )


def _table(found: ControllerDesign, driven: DriveQuantities | None) -> list[str]:
    """Return the prediction of every quantity, next to the value of the drive."""
    from sensorgraph.identification.design_task import shown

    head = f"{'':<26}{'predicted':>14}{'95 % interval':>26}"
    lines = [head + ("" if driven is None else f"{'driven':>15}")]
    for name, (label, unit) in LABELS.items():
        interval = found.prediction[name]
        span = f"{shown(interval.low)} to {shown(interval.high)} {unit}"
        cells = f"{label:<26}{f'{shown(interval.mean)} {unit}':>14}{span:>26}"
        if interval.mean != interval.mean:
            cells = f"{label:<26}{'none':>14}{'':>26}"
        if driven is not None:
            value = getattr(driven, name)
            driven_text = "none" if value != value else f"{shown(value)} {unit}"
            cells += f"{driven_text:>15}" + ("" if interval.holds(value) else "  outside")
        lines.append(cells.rstrip())
    return lines
