"""An uncalibrated laser in random offices: how near do the faces come to its true readings?

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.uncalibrated_laser [--case laser|laser-poses|poses]

The laser is mounted 50 mm / 20 mm / 0.5° off what is stated; each ray has a bias (sd 15 mm), a scale (0.4 ± 0.2 %)
and a bias by incidence, 20 mm sin³(inc) (1 - exp(-r / 1.5 m)), which is in the span of no identified term. Beside
the faces stands what a generic simulator does at its best: ray casting the true map with the true mount. Case
`laser-poses` adds noise of 5 mm / 0.2° to the training poses; case `poses` has a laser as stated, and poses with noise
of 1 cm / 0.4°. Test poses are fresh and exact; a reading is the true one plus range noise.
Nothing here is shared with the calibration.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import shapely

from benchmarks.arguments import half_interval, heads, parser_of, timed
from benchmarks.places import arena_named
from logs.run import RangeSensor
from planners.arena import Arena
from planners.types import Bools, Floats
from sensorgraph.models.base import TrainingScans
from sensorgraph.models.faces.model import Faces
from sensorgraph.world.raycast import cast

LASER_SIGMA = 0.01  # [m]
STATED = np.array([0.10, 0.0, 0.0])  # [m, m, rad] mount as the robot file says
OFFSET = np.array([0.050, 0.020, np.radians(0.5)])
POSE_NOISE = {  # [m, rad]
    "laser": (0.0, 0.0),
    "laser-poses": (0.005, np.radians(0.2)),
    "poses": (0.01, np.radians(0.4)),
}
N_SCANS = 3000
OFFICES = (101, 102, 103, 104, 105)
BEARINGS = np.linspace(-np.pi / 2, np.pi / 2, 181)
LASER_COLUMNS = ("within 3σ %", "median mm", "mean mm", "within 10 cm %", "wrong >5cm %")


@dataclass(frozen=True, kw_only=True, eq=False)
class Laser:
    """What the laser does to true ranges."""

    mount: Floats
    bias: Floats
    """(n_rays,) [m]"""
    scale: Floats
    """(n_rays,) metres a metre"""
    incidence: float
    """[m] bias at grazing incidence, far away"""

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Laser:
        """Draw a laser."""
        n = len(BEARINGS)
        bias, scale = rng.normal(0, 0.015, n), rng.normal(0.004, 0.002, n)
        return cls(mount=STATED + OFFSET, bias=bias, scale=scale, incidence=0.020)

    @classmethod
    def as_stated(cls) -> Laser:
        """Return a laser without errors."""
        n = len(BEARINGS)
        return cls(mount=STATED, bias=np.zeros(n), scale=np.zeros(n), incidence=0.0)

    def sensor(self) -> RangeSensor:
        """Return the sensor that casts its true ranges."""
        return RangeSensor(
            bearings=BEARINGS, range_min=0.02, range_max=30.0, mount=self.mount, sigma=LASER_SIGMA
        )

    def readings(self, arena: Arena, poses: Floats) -> Floats:
        """Return readings without noise (n_scans, n_rays)."""
        hits = cast(arena, poses, self.sensor())
        with np.errstate(invalid="ignore"):
            grazing = np.sin(np.nan_to_num(hits.incidence)) ** 3 * (1 - np.exp(-hits.ranges / 1.5))
            return hits.ranges * (1 + self.scale) + self.bias + self.incidence * grazing


def free_poses(arena: Arena, n: int, rng: np.random.Generator) -> Floats:
    """Draw poses uniformly, 20 cm or more from all walls."""
    free = arena.free.buffer(-0.2)
    shapely.prepare(free)
    x0, y0, x1, y1 = arena.bounds
    found = np.zeros((0, 2))
    while len(found) < n:
        p = np.column_stack([rng.uniform(x0, x1, 4 * n), rng.uniform(y0, y1, 4 * n)])
        found = np.concatenate([found, p[shapely.contains_xy(free, p[:, 0], p[:, 1])]])
    return np.column_stack([found[:n], rng.uniform(-np.pi, np.pi, n)])


def score(predicted: Floats, truth: Floats, noise: Floats, use: Bools | None = None) -> Floats:
    """Return the columns of the table for readings (n_scans, n_rays)."""
    use = np.isfinite(truth) if use is None else use & np.isfinite(truth)
    error = np.abs(np.where(np.isfinite(predicted), predicted, 30.0) - truth)[use]
    noisy = np.abs(np.where(np.isfinite(predicted), predicted, 30.0) - truth - noise)[use]
    shares = [100 * each.mean() for each in (noisy < 3 * LASER_SIGMA, error < 0.10, error > 0.05)]
    return np.array([shares[0], 1e3 * np.median(error), 1e3 * error.mean(), *shares[1:]])


def trial(which: str, case: str) -> dict[str, Floats]:
    """Fit faces to one log and score fresh poses; prints what was found."""
    rng = np.random.default_rng([0, 40])
    arena = arena_named(which)
    laser = Laser.as_stated() if case == "poses" else Laser.drawn(rng)
    poses, fresh = free_poses(arena, N_SCANS, rng), free_poses(arena, N_SCANS, rng)
    ranges = laser.readings(arena, poses) + rng.normal(0, LASER_SIGMA, (N_SCANS, len(BEARINGS)))
    xy, yaw = POSE_NOISE[case]
    poses = poses + rng.normal(0, 1, poses.shape) * [xy, xy, yaw]
    stated = replace(laser.sensor(), mount=STATED)
    scans = TrainingScans(sensor=stated, poses=poses, ranges=ranges, run=np.zeros(N_SCANS, dtype=np.intp))
    with timed() as took:
        model = Faces.fit(scans)
    truth = laser.readings(arena, fresh)
    noise = rng.normal(0, LASER_SIGMA, truth.shape)
    seen = model.predict(fresh, np.arange(len(BEARINGS)), "mode")
    best_map = cast(arena, fresh, laser.sensor()).ranges
    print(f"office {which}: {took.cpu:.1f} s; " + "; ".join(f"{a}: {b}" for a, b in model.summary().items()))
    return {
        "faces": score(seen.mode, truth, noise),
        f"faces, answered ({100 * seen.answered.mean():.1f} %)": score(
            seen.mode, truth, noise, seen.answered
        ),
        "true map, true mount": score(best_map, truth, noise),
    }


def main() -> None:
    """Run the trials and print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--case", default="laser", choices=list(POSE_NOISE))
    args = parser.parse_args()
    rows: dict[str, list[Floats]] = {}
    for office in OFFICES:
        for name, values in trial(str(office), args.case).items():
            rows.setdefault(name.split(" (")[0], []).append(values)
            print(
                f"  {name}: " + ", ".join(f"{c} {v:.3f}" for c, v in zip(LASER_COLUMNS, values, strict=True))
            )
    print(f"case {args.case}, {N_SCANS} scans, mean ± 95 % over {len(OFFICES)} offices")
    print(heads("", *LASER_COLUMNS))
    for name, found in rows.items():
        cells = zip(np.mean(found, axis=0), half_interval(np.array(found)), strict=True)
        print(f"| {name} | " + " | ".join(f"{mean:.3f} ± {half:.3f}" for mean, half in cells) + " |")


if __name__ == "__main__":
    main()
