"""Write the folder of an exported world: files of the target, arena, robot, effects, a script and a README."""

from __future__ import annotations

import difflib
import json
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

import shapely

from logs.run import Run
from planners.maps import geojson
from sensorgraph.effects import effects_file
from sensorgraph.effects.actuator_lag import ACTUATOR_LAG
from sensorgraph.effects.people import PEOPLE
from sensorgraph.effects.range_bias import RANGE_BIAS
from sensorgraph.effects.speed_saturation import SPEED_SATURATION
from sensorgraph.errors import SensorgraphError
from sensorgraph.exporting import gazebo, irsim, mujoco, nav2
from sensorgraph.exporting.world import ExportedWorld
from sensorgraph.files import atomic_folder
from sensorgraph.version import __version__

TARGETS = ("mujoco", "irsim", "gazebo", "nav2")
SCRIPTED = {"mujoco": "drive_mujoco.py", "irsim": "drive_irsim.py"}
"""Target -> script that drives a plan there and records it."""
OWN_FILES = (
    "arena.geojson", "robot.yaml", "effects.yaml", "drive.py", "scene.xml", "world.yaml", "world.sdf", "bridge.launch.py",
    "map.yaml", "map.pgm", "keepout.yaml", "keepout.pgm", "amcl.yaml",
)  # fmt: skip
"""Files that an export may write; those of an older export in the same folder are removed."""
BUILT_IN = ("geometry", "mount")
"""Stages of effects that every target applies in its world; nav2 keeps the original map."""
NATIVE = {"gazebo": (RANGE_BIAS, SPEED_SATURATION), "mujoco": (ACTUATOR_LAG,)}
"""Additional effects in the files of a target."""
FIRST_STEPS = {
    "mujoco": "python -m mujoco.viewer --mjcf=scene.xml   # look at it\npython drive.py PLAN -o run.mcap          # drive a plan and record it",
    "irsim": "python -c \"import irsim; env = irsim.make('world.yaml'); env.show()\"   # look at it\n"
    "python drive.py PLAN -o run.mcap                                          # drive a plan and record it",
    "gazebo": "gz sim -r world.sdf               # alone\nros2 launch ./bridge.launch.py    # with ROS 2",
    "nav2": "ros2 run nav2_map_server map_server --ros-args -p yaml_filename:=$PWD/map.yaml\n"
    "ros2 run nav2_amcl amcl --ros-args --params-file amcl.yaml    # in a second terminal; then, in a third:\n"
    "for node in map_server amcl; do ros2 lifecycle set /$node configure; ros2 lifecycle set /$node activate; done",
}


def check_target(target: str) -> None:
    """Reject an unknown target.

    Raises
    ------
    SensorgraphError : The target is unknown; the message lists the known ones.
    """
    if target not in TARGETS:
        near = difflib.get_close_matches(target, TARGETS, n=1)
        hint = f"; did you mean {near[0]}?" if near else ""
        raise SensorgraphError(f"unknown target {target!r}; known are {', '.join(TARGETS)}{hint}")


def export(
    world: ExportedWorld,
    target: str,
    folder: Path,
    *,
    no_go: Sequence[shapely.Polygon] = (),
    run: Run | None = None,
) -> list[str]:
    """Write a world for a target; return what the target leaves out, one line each.

    Parameters
    ----------
    target : One of TARGETS.
    folder : Folder, created if missing. Either all files are written or none; files of an older export are
        removed.
    no_go, run : See `nav2.write`.

    Raises
    ------
    SensorgraphError : The target is unknown.
    """
    check_target(target)
    with atomic_folder(folder) as part:
        (part / "arena.geojson").write_text(geojson.dumps(world.arena), encoding="utf-8")
        (part / "robot.yaml").write_text(world.robot.text or f"name: {world.robot.name}\n", encoding="utf-8")
        if world.effects:
            effects_file.write(world.effects, part / "effects.yaml")
        if target == "nav2":
            left_out = nav2.write(world, part, no_go=no_go, run=run)
        else:
            write = {"mujoco": mujoco.write, "irsim": irsim.write, "gazebo": gazebo.write}[target]
            left_out = write(world, part)
        left_out = [*left_out, *_effects_left_out(world, target)]
        if target in SCRIPTED:
            script = (files("sensorgraph.data") / "export" / SCRIPTED[target]).read_text(encoding="utf-8")
            (part / "drive.py").write_text(script, encoding="utf-8")
        (part / "README.md").write_text(_readme(world, target, left_out), encoding="utf-8")
        settings = {"version": __version__, "target": target, "arena": world.name, "robot": world.robot.name}
        (part / "export.json").write_text(
            json.dumps(
                {**settings, "effects": [a.name for a in world.effects], "left_out": left_out}, indent=1
            )
            + "\n",
            encoding="utf-8",
        )
        if (folder / "export.json").is_file():
            for name in OWN_FILES:
                if not (part / name).exists():
                    (folder / name).unlink(missing_ok=True)
    return left_out


def _effects_left_out(world: ExportedWorld, target: str) -> list[str]:
    """Return the effects that are missing from the files of the world, one line each."""
    lines = []
    for a in world.effects:
        in_world = target != "nav2" and a.stage in BUILT_IN and a.effect is not PEOPLE
        is_native = a.effect in NATIVE.get(target, ()) and (target != "mujoco" or world.robot.drive == "diff")
        if in_world or is_native:
            continue
        by_script = ", added by drive.py" if target in SCRIPTED else ""
        lines.append(f"{a.effect.title} ({a.name}){by_script}")
    return lines


def _readme(world: ExportedWorld, target: str, left_out: Sequence[str]) -> str:
    """Return the README: content of the folder, first steps, and what the target leaves out."""
    robot, sensor = world.robot, world.robot.sensor
    effects = "".join(f"- {a.effect.title}: {a.effect.physics}\n" for a in world.effects) or "- none\n"
    missing = "".join(f"- {line}\n" for line in left_out) or "- nothing\n"
    compare = "" if target == "nav2" else (
        " Compare a run recorded here with a run of the robot:\n\n"
        "```bash\nsensorgraph diagnose real.mcap --simulation run.mcap -o compared\n```"
    )  # fmt: skip
    return (
        f"# {world.name} for {target}\n\n"
        f"Written by `sensorgraph export` {__version__}: {len(world.boxes)} walls"
        f"{f', {len(world.discs)} round obstacles' if len(world.discs) else ''}, the robot {robot.name} "
        f"(radius {robot.footprint_radius:g} m), and its laser with {sensor.n_rays} rays up to {sensor.range_max:g} m.\n\n"
        f"```bash\n{FIRST_STEPS[target]}\n```\n\n"
        f"The sources are `arena.geojson`, `robot.yaml`{', `effects.yaml`' if world.effects else ''}.{compare}\n\n"
        f"## Effects\n\n{effects}\n## Not in this world\n\n{missing}"
    )
