"""The command line of the drive.py in an exported world."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from sensorgraph.termination import TERMINATED, Terminated, install

if TYPE_CHECKING:
    from sensorgraph.exporting.twin import Simulator


def run_script(folder: Path, make: Callable[[], Simulator], world: str) -> None:
    """Drive a plan in an exported world and write the run; an error prints one line and exits with code 2.

    Parameters
    ----------
    world : Name of the world file in the folder, which `make` opens.
    """
    from logs.errors import LogError
    from planners.errors import PlanError
    from sensorgraph.cli.inputs import check_output
    from sensorgraph.cli.progress import progress
    from sensorgraph.errors import SensorgraphError
    from sensorgraph.exporting.twin import record_twin

    parser = argparse.ArgumentParser(description="Drive a plan in this world and record it.")
    parser.add_argument("plan", type=Path, help="folder of a plan, or its trajectory.csv")
    parser.add_argument(
        "-o", "--out", type=Path, default=Path("run.mcap"), help="run to write, *.mcap; default: run.mcap"
    )
    parser.add_argument("--seed", type=int, default=0, help="random seed of all noise; default: 0")
    options = parser.parse_args()
    install("terminated")
    try:
        missing = [name for name in (world, "arena.geojson", "robot.yaml") if not (folder / name).is_file()]
        if missing:
            raise SensorgraphError(f"{folder / missing[0]} is missing; export the world again")
        check_output(options.out)
        run = record_twin(folder, make(), options.plan, options.out, seed=options.seed, progress=progress)
    except (SensorgraphError, LogError, PlanError, OSError) as exc:
        sys.stderr.write(f"error: {exc}\n")
        raise SystemExit(2) from exc
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        raise SystemExit(130) from None
    except Terminated:
        sys.stderr.write("terminated\n")
        raise SystemExit(TERMINATED) from None
    sys.stdout.write(
        f"{run.n_scans:,} scans of {run.sensor.n_rays} rays in {run.stamps[-1]:,.0f} s, "
        f"at most {100 * float(run.meta['off_plan_m']):.1f} cm off the plan\nwrote {options.out}\n"
    )
