"""What robot, sensor and environment have to do with the behaviour of one controller in the shipped square.

    python -m benchmarks.influence [-o influence.png] [--rows 64] [--duration 90]

A graph of faces is built from a coverage run, a controller is designed in it (wall distance 0.5 m, 0.2 m/s), and seven
factors are varied at once. Prints the table of Sobol shares with bootstrap intervals.
"""

from __future__ import annotations

from pathlib import Path

from benchmarks.arguments import parser_of
from benchmarks.drives import covered
from sensorgraph.building.build import build
from sensorgraph.identification.design import design
from sensorgraph.identification.design_task import DesignTask
from sensorgraph.identification.influence import influence, table
from sensorgraph.loading import load_arena
from sensorgraph.recording.controllers import PolynomialController
from sensorgraph.show.figures.influence import influence_picture
from sensorgraph.world.robot import default_robot

SEED = 6  # of the reported figures


def main() -> None:
    """Read the command line and print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("-o", "--out", type=Path, help="picture")
    parser.add_argument("--rows", type=int, default=64)
    parser.add_argument("--duration", type=float, default=90.0)
    arguments = parser.parse_args()
    robot = default_robot()
    graph = build([covered(load_arena("square"), robot, SEED)])
    designed = design(graph, DesignTask(wall_distance=0.5, speed=0.2), robot, seed=SEED)
    steer = PolynomialController(designed.model, designed.facts, robot, name="the design")
    found = influence(
        graph, steer, robot, designed.start, rows=arguments.rows, duration=arguments.duration, seed=SEED
    )
    print(f"{designed.model.equation()}\n\n{found.n_drives:,} drives of {found.duration:g} s\n")
    print("\n".join(table(found)))
    if arguments.out:
        influence_picture(found, arguments.out)


if __name__ == "__main__":
    main()
