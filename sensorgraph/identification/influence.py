"""Estimate the influence of robot, sensor and environment on the behaviour of one controller in the identified world.

    First-order Sobol index of factor x_i on quantity Y: S_i = Var(E[Y | x_i]) / Var(Y).
    Total Sobol index, with all interactions: ST_i = 1 - Var(E[Y | x_(not i)]) / Var(Y).

Behaviour depends on robot, task and environment together (Nehmzow, Scientific Methods in Mobile Robotics, 2006). Here
the task is constant: the same polynomial drives with the same noise while factors vary.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from planners.arena import Arena
from robotmodic_ident.analysis.sampled_sobol import SampledSobol, saltelli_points, sampled_sobol
from robotmodic_ident.errors import IdentError
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.identification.varied_drive import Varied, VariedDrives, VariedPopulation, WallObstacle
from sensorgraph.models.faces.model import Faces
from sensorgraph.recording.controllers import PolynomialController
from sensorgraph.recording.identified_world import IdentifiedWorld
from sensorgraph.types import Floats, Progress
from sensorgraph.world.identified_arena import arena_of
from sensorgraph.world.robot import Robot
from sensorgraph.world.wall_distance import WallDistance

OBSTACLE_AT = 0.4
"""Share of the nominal drive at which it passes the obstacle, which protrudes from the nearest wall."""
MAX_DRIVES = 20_000
MAX_WIDTH = 1.0
"""Maximum width of the interval of a total index; if wider, a few drives dominate the variance."""


@dataclass(frozen=True, kw_only=True)
class VariedFactor:
    """A factor that varies uniformly between two values."""

    part: Literal["robot", "sensor", "environment"]
    low: float
    high: float
    rest: float
    """Nominal value, which has no influence."""
    least: float
    """Smallest valid value."""
    unit: str
    meaning: str


FACTORS: dict[str, VariedFactor] = {
    "noise": VariedFactor(
        part="sensor", low=0.0, high=0.03, rest=0.0, least=0.0, unit="m", meaning="noise of a range"
    ),
    "scale": VariedFactor(
        part="sensor", low=0.98, high=1.02, rest=1.0, least=0.1, unit="", meaning="scale of ranges"
    ),
    "yaw": VariedFactor(
        part="sensor", low=-0.035, high=0.035, rest=0.0, least=-3.2, unit="rad", meaning="laser turned"
    ),
    "wheels": VariedFactor(
        part="robot", low=0.97, high=1.03, rest=1.0, least=0.1, unit="", meaning="base, assumed/true"
    ),
    "tau": VariedFactor(
        part="robot", low=0.05, high=0.3, rest=0.1, least=0.0, unit="s", meaning="lag of the motors"
    ),
    "delay": VariedFactor(
        part="robot", low=0.0, high=0.1, rest=0.0, least=0.0, unit="s", meaning="latency of commands"
    ),
    "obstacle": VariedFactor(
        part="environment", low=0.0, high=0.2, rest=0.0, least=0.0, unit="m", meaning="out from the wall"
    ),
}
"""Name -> factor with its default range."""
QUANTITIES: dict[str, tuple[str, str]] = {
    "wall_distance_m": ("wall distance, mean", "m"),
    "wall_distance_sd_m": ("wall distance, s.d.", "m"),
    "lap_s": ("lap", "s"),
    "turn_rate_rms_rad_s": ("turn rate, rms", "rad/s"),
    "contacts": ("contacts", ""),
}
"""Quantity of behaviour -> its label and unit."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Influence:
    """Sobol indices of each factor for each quantity of behaviour."""

    factors: Mapping[str, tuple[float, float]]
    """Name of a factor -> its range."""
    shares: SampledSobol
    """Sobol indices of (factors, `QUANTITIES`)."""
    undisturbed: Mapping[str, float]
    """Quantity -> value of the nominal drive."""
    n_drives: int
    duration: float
    """[s] Duration of a drive."""
    start: Floats
    """(3,) [m, m, rad] Start pose of all drives."""
    tracks: Floats = field(repr=False)
    """(n_scans, n, 3) [m, m, rad] Poses of some of the drives."""
    track: Floats = field(repr=False)
    """(n_scans, 3) [m, m, rad] Poses of the nominal drive."""
    walls: Arena
    """Walls of the graph."""

    def to_dict(self) -> dict[str, Any]:
        """Return the indices as plain data; an undefined value is None."""

        def plain(value: float) -> float | None:
            return None if np.isnan(value) else float(value)

        s = self.shares
        return {
            "factors": {name: list(span) for name, span in self.factors.items()},
            "start": self.start.tolist(),
            "duration_s": self.duration,
            "n_drives": self.n_drives,
            "quantities": {
                quantity: {
                    "undisturbed": plain(self.undisturbed[quantity]),
                    "mean": plain(s.mean[j]),
                    "sigma": plain(s.sigma[j]),
                    "known": plain(s.known[j]),
                    "shares": {
                        name: {
                            "first": plain(s.first[i, j]),
                            "first_95": [plain(v) for v in s.first_interval[i, j]],
                            "total": plain(s.total[i, j]),
                            "total_95": [plain(v) for v in s.total_interval[i, j]],
                        }
                        for i, name in enumerate(self.factors)
                    },
                }
                for j, quantity in enumerate(QUANTITIES)
            },
        }


def influence(
    graph: Sensorgraph, controller: PolynomialController, robot: Robot, start: Sequence[float], *,
    factors: Mapping[str, tuple[float, float]] | None = None, rows: int = 64, duration: float = 90.0,
    seed: int = 0, progress: Progress | None = None,
) -> Influence:  # fmt: skip
    """Drive one controller `rows` * (factors + 2) times in an identified world, and estimate Sobol indices.

    Parameters
    ----------
    graph : Graph of faces.
    controller : Polynomial of the turn rate in the current readings.
    start : (3,) [m, m, rad] Start pose of base_link.
    factors : Name -> (lowest, highest) value. None: all `FACTORS` in their default ranges.
    rows : Rows of the sample, a power of 2.
    duration : [s] Duration of a drive.

    Raises
    ------
    SensorgraphError : A factor or number is out of range, the graph has no faces, or the controller has lags.
    """
    spans = {name: (f.low, f.high) for name, f in FACTORS.items()} if factors is None else dict(factors)
    _check(graph, controller, spans, rows, duration)
    assert isinstance(graph.model, Faces)
    walls = arena_of(graph)
    clearance, place = WallDistance(walls), np.asarray(start, dtype=np.float64)
    if place.shape != (3,) or not clearance(*place[:2]) > robot.footprint_radius:
        raise SensorgraphError(
            f"start {', '.join(f'{v:g}' for v in place)} is not in free space; give x, y, phi at least "
            f"{robot.footprint_radius:g} m from the walls of the graph"
        )
    mount = robot.sensor.mount if graph.pose_frame == "laser" else np.zeros(3)
    world = IdentifiedWorld(graph, robot, seed)
    rays = {name: world.rays[own] for name, own in controller.rays.items()}
    population = VariedPopulation(graph.model, robot, clearance, rays, seed, mount)
    middle = np.array(walls.free.centroid.coords[0])

    def driven(
        values: Mapping[str, Floats], n: int, obstacle: WallObstacle | None, progress: Progress | None = None
    ) -> VariedDrives:
        rest = {name: np.full(n, factor.rest) for name, factor in FACTORS.items()}
        rest["tau"] = np.full(n, robot.actuators.tau)
        rest["delay"] = np.full(n, robot.actuators.delay)
        varied = Varied(**{**rest, **values})
        return population.drive_varied(
            controller.model, controller.held, place, varied, obstacle, middle, duration, progress
        )

    nominal = driven({}, 1, None)
    obstacle = _wall_obstacle(nominal.tracks[:, 0], clearance) if "obstacle" in spans else None
    points = saltelli_points(rows, len(spans), np.random.default_rng([seed, 10]))
    flat = points.reshape(-1, len(spans))
    values = {name: low + (high - low) * flat[:, i] for i, (name, (low, high)) in enumerate(spans.items())}
    drives = driven(values, len(flat), obstacle, progress)
    found = np.stack([drives.quantities[name] for name in QUANTITIES], axis=-1)
    shares = sampled_sobol(found.reshape(rows, len(spans) + 2, -1), np.random.default_rng([seed, 11]))
    return Influence(
        factors=spans, shares=shares, undisturbed={k: float(v[0]) for k, v in nominal.quantities.items()},
        n_drives=len(flat), duration=duration, start=place, tracks=drives.tracks[:, :: len(spans) + 2],
        track=nominal.tracks[:, 0], walls=walls,
    )  # fmt: skip


def _check(
    graph: Sensorgraph,
    controller: PolynomialController,
    spans: Mapping[str, tuple[float, float]],
    rows: int,
    duration: float,
) -> None:
    if not isinstance(graph.model, Faces):
        raise SensorgraphError(
            f"the graph has the model {graph.model.name}, expected faces; build it with `sensorgraph build`"
        )
    model = controller.model
    lagged = model.terms.max_lag or model.output in model.terms.variables or len(model.noise_terms)
    is_sum = not len(model.denominator) and not model.is_magnitude
    if not controller.is_turn or lagged or not is_sum or controller.every != 1 or not controller.rays:
        raise SensorgraphError(
            f"{controller.name}: expected a turn rate as a function of the current readings, without lags, as `design` writes"
        )
    if not spans:
        raise SensorgraphError("no factor varies; give at least one")
    for name, (low, high) in spans.items():
        if name not in FACTORS:
            raise SensorgraphError(f"factor is {name!r}, expected one of {', '.join(FACTORS)}")
        if not FACTORS[name].least <= low < high < np.inf:
            unit = f" {FACTORS[name].unit}".rstrip()
            raise SensorgraphError(
                f"{name} from {low:g} to {high:g}{unit}: expected an increasing range of at least {FACTORS[name].least:g}"
            )
    if not 1.0 <= duration <= 3600.0:
        raise SensorgraphError(f"duration is {duration:g} s, expected 1 to 3600 s")
    try:
        points = saltelli_points(rows, len(spans), np.random.default_rng(0))
    except IdentError as exc:
        raise SensorgraphError(f"rows: {exc}") from exc
    if (n := points.shape[0] * points.shape[1]) > MAX_DRIVES:
        raise SensorgraphError(
            f"{rows} rows need {n:,} drives, expected at most {MAX_DRIVES:,}; give fewer rows"
        )


def _wall_obstacle(track: Floats, clearance: WallDistance) -> WallObstacle:
    """Return the place of the obstacle: the wall point nearest to the pose at OBSTACLE_AT, and the normal into the room."""
    x, y, _ = track[int(OBSTACLE_AT * len(track))]
    h = clearance.cell
    slope = np.array(
        [clearance(x + h, y) - clearance(x - h, y), clearance(x, y + h) - clearance(x, y - h)],
        dtype=np.float64,
    )
    outward = slope / max(float(np.hypot(*slope)), 1e-9)
    return WallObstacle(wall=np.array([x, y]) - clearance(x, y) * outward, outward=outward)


def is_determined(found: Influence, quantity: int) -> bool:
    """Return whether the drives determine the indices of a quantity, given by its index in `QUANTITIES`."""
    widths = np.ptp(found.shares.total_interval[:, quantity], axis=-1)
    return bool(np.isfinite(widths).any() and np.nanmax(widths) <= MAX_WIDTH)


def table(found: Influence) -> list[str]:
    """Return a Markdown table: first-order and total index of each factor for each quantity, with 95 % intervals."""
    s, names = found.shares, list(found.factors)
    lines = [
        "| Sobol index: first order / total | " + " | ".join(names) + " |",
        "|---|" + "---|" * len(names),
    ]
    for j, (label, unit) in enumerate(QUANTITIES.values()):
        known = "" if s.known[j] == 1 else f", {100 * s.known[j]:.0f} % of the rows"
        head = f"{label}: {s.mean[j]:.3g} ± {s.sigma[j]:.2g} {unit}".rstrip() + known
        if not np.isfinite(s.first[:, j]).any():
            value = (
                "no value in most drives"
                if np.isnan(s.mean[j])
                else f"always {s.mean[j]:.3g} {unit}".rstrip()
            )
            lines.append(f"| {label}: {value} |" + " – |" * len(names))
            continue
        if not is_determined(found, j):
            lines.append(f"| {head}; dominated by a few drives: give more rows |" + " – |" * len(names))
            continue
        cells = [
            f"{s.first[i, j]:.2f} ({s.first_interval[i, j, 0]:.2f} to {s.first_interval[i, j, 1]:.2f}) / "
            f"{s.total[i, j]:.2f} ({s.total_interval[i, j, 0]:.2f} to {s.total_interval[i, j, 1]:.2f})"
            for i in range(len(names))
        ]
        lines.append(f"| {head} | " + " | ".join(cells) + " |")
    return lines
