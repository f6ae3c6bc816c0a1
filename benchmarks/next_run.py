"""The planned next run against random runs of the same length: evidence between rivals, measured on simulated data.

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.next_run [--seed 1] [--random 8] [--minutes 2] [--size 1]

For every pair the first model is true. A first random run is simulated and the wrong model fitted to it; from those
two fits the next run is planned. Two minutes of any drive tell most pairs of effects at twice their materiality
apart: `--minutes 0.3 --size 0.5` leaves something to win. It and fresh random runs (random places and
speeds, a spin now and then) are driven and scanned by the simulator, both models are fitted to each, and their difference in nats is
compared, per second of drive. The drives, their noise and the rooms come from seeds.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.arguments import parser_of, timed
from benchmarks.hidden_effects.worlds.own.world import make_room
from benchmarks.places import drive_and_log
from planners.arena import Arena
from planners.maps import geojson
from planners.trajectory import Trajectory
from sensorgraph.diagnosis.next_run.design import next_run
from sensorgraph.diagnosis.next_run.drives import DrivableSpace, random_drive
from sensorgraph.diagnosis.next_run.forecast import DECIDED_NATS
from sensorgraph.diagnosis.next_run.questions import between
from sensorgraph.diagnosis.scan.fit import Fitted, fit, start_state
from sensorgraph.diagnosis.scan.scan_data import ScanData, prepare_scans
from sensorgraph.diagnosis.scan.settings import NoiseBounds
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.world.robot import Robot, default_robot

N_SENSOR_RAYS = 91


def wall_of(arena: Arena) -> tuple[str, float]:
    """Return the longest wall and its length [m]."""
    lengths = np.hypot(*(arena.walls[:, 1] - arena.walls[:, 0]).T)
    k = int(lengths.argmax())
    return arena.names[k], float(lengths[k])


def pairs(arena: Arena) -> dict[str, tuple[Amendment, Amendment]]:
    """Return (true, wrong) effects, two to three times their materiality."""
    e = EFFECTS
    wall, length = wall_of(arena)
    part = {"a": 0.3 * length, "b": 0.7 * length}
    return {
        "latency|mount_xy": (e["latency"](tau=0.015), e["mount_xy"](dx=0.0, dy=0.0)),
        "latency|scan_skew": (e["latency"](tau=0.015), e["scan_skew"](T=0.03)),
        "mount_yaw|latency": (e["mount_yaw"](delta=0.005), e["latency"](tau=0.0)),
        "range_bias|range_scale": (e["range_bias"](b=0.015), e["range_scale"](s=0.004)),
        "range_scale|map_scale": (e["range_scale"](s=0.006), e["map_scale"](s=-0.005, dx=0.0, dy=0.0)),
        "moved_wall|range_bias": (e["moved_wall"](d=0.03).at(wall), e["range_bias"](b=0.005)),
        "glass|mirror": (
            e["glass"](alpha_ret=0.35, depth=1.5, **part).at(wall),
            e["mirror"](**part).at(wall),
        ),
        "black_surface|max_range": (e["black_surface"](r0=1.5, **part).at(wall), e["max_range"](R=4.5)),
        "incidence_dropout|black_surface": (
            e["incidence_dropout"](alpha_max=1.25),
            e["black_surface"](r0=2.5, a=0.0, b=length).at(wall),
        ),
        "sector_bias|mount_xy": (
            e["sector_bias"](theta1=-0.3, theta2=0.3, b=0.015),
            e["mount_xy"](dx=0.01, dy=0.0),
        ),
    }


def measured(trajectory: Trajectory, arena: Arena, robot: Robot, effect: Amendment, seed: int) -> ScanData:
    """Drive and scan with an effect."""
    return prepare_scans(drive_and_log(trajectory, arena, robot, seed, [effect]), arena, robot)[0]


def nats(data: ScanData, a: Amendment, b: Amendment) -> tuple[float, Amendment]:
    """Return J(A) - J(B) on measured data, both refitted; and B as fitted."""
    fits = [fitted(data, model) for model in (a, b)]
    return fits[0].j - fits[1].j, fits[1].model[0]


def fitted(data: ScanData, effect: Amendment) -> Fitted:
    """Fit an effect with all nuisances: its smooth parameters, and its rough ones by trying both sides."""
    noise_bounds = NoiseBounds()
    best = fit(data, (effect,), start_state(data, noise_bounds), noise_bounds)
    for scale in (4.0, 1.0):
        for name, step in effect.search_steps.items():
            for sign in (1.0, -1.0):
                value = best.model[0][name] + sign * scale * step
                moved = best.model[0].moved_to({name: value})
                got = fit(data, (moved,), best.state, noise_bounds)
                best = got if got.j > best.j else best
    return best


def main() -> None:
    """Read the command line, drive, print."""
    parser = parser_of(__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--random", type=int, default=8, help="random runs to compare with")
    parser.add_argument("--minutes", type=float, default=2.0)
    parser.add_argument("--size", type=float, default=1.0, help="times the size of the true effects")
    options = parser.parse_args()
    robot = default_robot()
    sensor = replace(robot.sensor, bearings=np.linspace(-np.pi / 2, np.pi / 2, N_SENSOR_RAYS))
    robot = replace(robot, sensor=sensor)
    print(
        f"{'true|wrong':34} {'next run':>9} {'median':>8} {'best':>8} {'ratio':>6}   expected {'':>4} ratio   CPU"
    )
    ratios: dict[str, float] = {}
    medians: dict[str, float] = {}
    for number, name in enumerate(pairs(geojson.loads(make_room(np.random.default_rng(0)).geojson()))):
        seed = 1000 * options.seed + number
        rng = np.random.default_rng(seed)
        arena = geojson.loads(make_room(rng).geojson())
        a, b = pairs(arena)[name]
        a = a.moved_to({key: options.size * a[key] for key in a.effect.sizes if key in a.parameters})
        space = DrivableSpace.of(arena, robot)
        seconds = 60 * options.minutes
        first = random_drive(space, rng, seconds).trajectory()
        _, b = nats(measured(first, arena, robot, a, seed), a, b)
        with timed() as took:
            chosen = next_run([between([a], [b])], arena, robot, seed=seed, minutes=options.minutes)
        got = []
        for k in range(options.random):
            other = random_drive(space, rng, seconds).trajectory()
            value = nats(measured(other, arena, robot, a, seed + 100 + k), a, b)[0]
            got.append(value * seconds / other.duration)
        best = nats(measured(chosen.trajectory, arena, robot, a, seed + 99), a, b)[0]
        best *= seconds / chosen.trajectory.duration
        median = float(np.median(got))
        ratios[name], medians[name] = best / max(median, 1.0), median
        print(
            f"{name:34} {best:9.0f} {median:8.0f} {max(got):8.0f} {ratios[name]:6.1f}   {chosen.evidence:8.0f} "
            f"{chosen.evidence / max(chosen.median_random_evidence, 1e-9):9.1f} {took.cpu:6.2f} s"
        )
        print(f"    {chosen.why}")
    kinds = {
        f"a median random run leaves open (below {DECIDED_NATS:g} nats)": [
            n for n in ratios if medians[n] < DECIDED_NATS
        ],
        "any run tells apart": [n for n in ratios if medians[n] >= DECIDED_NATS],
    }
    for words, names in kinds.items():
        if names:
            some = [ratios[n] for n in names]
            print(
                f"{len(names)} pairs that {words}: median ratio {np.median(some):.1f}, least {min(some):.1f}"
            )


if __name__ == "__main__":
    main()
