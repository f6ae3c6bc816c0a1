"""One anytime plan after 2, 10 and 40 minutes: its way, and what the laser has seen by then.

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.anytime_picture [--arena office] [-o docs/pages/pictures/anytime_plan.png]

The arena is named as in `benchmarks.error_by_minutes`: `1001` is a random office, `FILE@x,y` a file and where the robot starts.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from benchmarks.error_by_minutes import place_of
from planners import plan
from sensorgraph.planning.survey import survey_of
from sensorgraph.planning.views import MIN_RAYS, SPACE_CELL
from sensorgraph.show.figures.style import INK, draw_floor, map_height, new_figure, save_figure
from sensorgraph.world.robot import default_robot

MINUTES = (2, 10, 40)
LOOK_PERIOD = 0.5
"""[s] between scans that count as seen."""
SEEN, ROUTE = "#bfe3dc", "#d1345b"


def main() -> None:
    """Plan once and draw three prefixes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arena", default="office")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("-o", "--out", type=Path, default=Path("docs/pages/pictures/anytime_plan.png"))
    options = parser.parse_args()
    robot = default_robot()
    place = place_of(options.arena, robot, options.seed, 1)
    arena = place.arena
    made = plan(
        arena, robot, order="anytime", survey=survey_of(arena, robot.sensor), seed=options.seed, start=place.start,
        budget=60.0 * max(MINUTES),
    )  # fmt: skip
    figure = new_figure(12.0, map_height(3.9, arena.bounds, 2.0, 9.0) + 0.5)
    x0, y0, x1, y1 = arena.bounds
    survey, done = survey_of(arena, robot.sensor), 0.0
    for axes, minutes in zip(figure.subplots(1, len(MINUTES)), MINUTES, strict=True):
        until = min(60.0 * minutes, made.curve.duration)
        survey.mark(made.curve.sample(np.arange(done, until, LOOK_PERIOD))[0])
        done = until
        i, k = ((np.array([[x0, x1], [y0, y1]])[axis] - survey.low[axis]) / SPACE_CELL for axis in (0, 1))
        seen = survey.space[int(i[0]) : int(i[1]), int(k[0]) : int(k[1])] >= MIN_RAYS
        axes.contourf(
            x0 + SPACE_CELL * (np.arange(seen.shape[0]) + 0.5), y0 + SPACE_CELL * (np.arange(seen.shape[1]) + 0.5),
            seen.T.astype(float), levels=[0.5, 1.5], colors=[SEEN], zorder=1,
        )  # fmt: skip
        poses = made.curve.sample(np.arange(0.0, until, 0.2))[0]
        axes.plot(poses[:, 0], poses[:, 1], color=ROUTE, lw=0.9, zorder=3)
        axes.plot(*poses[0, :2], "o", color=INK, ms=4, zorder=4)
        draw_floor(axes, arena)
        driven = np.hypot(*np.diff(poses[:, :2], axis=0).T).sum()
        axes.set_title(f"{minutes} min, {driven:.0f} m", color=INK, fontsize=10, loc="left")
    save_figure(figure, options.out)
    print(f"wrote {options.out}")


if __name__ == "__main__":
    main()
