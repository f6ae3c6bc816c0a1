"""Families of columns for differences between odometry and reference poses that no effect explains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import Literal

import numpy as np

from sensorgraph.diagnosis.motion.increments import WheelIncrements
from sensorgraph.diagnosis.motion.settings import EVIDENCE
from sensorgraph.diagnosis.motion.structure_test import StructureFamily
from sensorgraph.diagnosis.motion.wheels.reference_structure import distorted_reference
from sensorgraph.diagnosis.motion.wheels.rows import AVERAGING_TIME, OdometryRows
from sensorgraph.types import Bools, Floats
from sensorgraph.world.robot import Wheels

Part = Literal["distance", "turn", "distance and turn", "left wheel", "right wheel"]
PARTS: tuple[Part, ...] = ("left wheel", "right wheel", "turn")
"""Quantities that may change separately: each wheel, and the distance between them."""
Scale = tuple[Part, Bools | Floats]
"""Scaled quantity, and (n_increments,) the share of each increment that is scaled."""
JUMP = "jump"
"""Kind of the families of a scale that changes once."""
CLOCK = "clock"
"""Kind of the families of a clock offset that changes over time."""
SMOOTHED = 5
"""Minimum number of increments over which a speed is averaged before its acceleration is computed."""
RAMP = 0.25
"""[s] minimum duration of that average: motors take that long, and ticks are not an acceleration."""
N_WHILE = 9
"""Number of moments between which a temporary change may lie."""
N_CLOCK_PIECES = (5, 20)
"""Numbers of pieces of the run with separate clock offsets; tried one after the other."""
TIGHT_TURNS = (0.3, 1.0, 3.0)
"""Distance from the middle of the axle to the centre of rotation, in half wheelbases, below which a turn
is tight."""
ACCELERATION_QUANTILE = 0.85
"""Quantile of the accelerations of a run, above which the robot accelerates."""
SPINNING_QUANTILES = (0.5, 0.7, 0.8, 0.9, 0.95)
"""Quantiles of the accelerations of the wheels, above which they may spin."""
MIN_CELL_TRAVEL = 0.3
"""[m] minimum path in a cell."""
MIN_EXTENT = 1.5
"""[m] minimum extent of a run for a reference that is distorted over the place; a camera is not distorted
within less."""
N_NEARER_JUMPS = 5
"""Number of moments on each side of the best one that are tried next, and again around the best of these."""
SPEED_CUTS = (0.12, 0.22, 0.32)
"""[m/s] limits between speeds, for a robot at 0.4 m/s; proportional for a faster one."""
RATE_CUTS = (0.25, 0.5, 0.75)
"""[rad/s] limits between turn rates, for a robot at 1 rad/s; proportional for a faster one."""
CELL = 1.0
"""[m] cell size of the raster of places."""
MAX_CELLS = 24
"""Maximum number of cells: those with the longest path."""
RADIUS_FACTORS = (0.97, 0.98, 0.99, 1.0, 1.01, 1.02, 1.03)
"""Factors of the wheel radius in robot.yaml, for the count of turns; 1 % of 60 m is one turn."""


def odometry_families(
    rows: OdometryRows, wheels: WheelIncrements, size: Wheels, *, is_reference_straight: bool = False
) -> list[StructureFamily]:
    """Return the families of differences that no effect explains, with columns (2 n, k).

    Parameters
    ----------
    size : Radius and distance of the wheels.
    is_reference_straight : Omit a reference that is distorted over the place.
    """
    base = size.base
    rates, phi = _rates(wheels), rows.increment_poses[:, 2]
    ahead, passed = np.sign(wheels.distance), (wheels.middle - wheels.start[0]) / np.ptp(wheels.middle)
    by_direction: list[Scale] = [("distance", rates[:, 0] < 0), ("turn", rates[:, 1] < 0)]
    by_heading: list[Scale] = [("distance", ahead * np.cos(phi)), ("distance", ahead * np.sin(phi))]
    by_compass: list[Scale] = [("turn", np.cos(phi)), ("turn", np.sin(phi))]
    scales: list[tuple[str, str, Sequence[Scale]]] = [
        (
            "steady change",
            "a steady change of the wheels during the run: a tyre that loses air, a load that shifts",
            [(part, passed - 0.5) for part in PARTS],
        ),
        ("speed", "a scale that depends on speed or turn rate", _speeds(rates)),
        (
            "direction",
            "a scale that differs forward and backward, or to the left and to the right",
            by_direction,
        ),
        ("curvature", "a scale that differs in tight turns: the tyres scrub", _tight_turns(rates, base)),
        ("acceleration", "a scale that depends on the acceleration", _accelerations(wheels, rates)),
        ("place", "a scale that depends on the place", _cells(rows, wheels)),
        # a slope, or the pile of a carpet
        ("heading", "a scale that depends on the heading", by_heading),
        # iron deviates a compass by the sine of the heading (Bowditch, American Practical Navigator)
        (
            "compass",
            "a turn scale that depends on the heading: a compass near iron, in odometry or reference",
            by_compass,
        ),
    ]
    families = [_scales(rows, wheels, base, *one) for one in scales if one[2]]
    families += [_at_rest(rows, wheels), *_jumps(rows, wheels, base), *_for_a_while(rows, wheels, base)]
    families += [_clock_pieces(rows, n) for n in N_CLOCK_PIECES]
    families += [_spinning(rows, wheels, base), *_turns_of_a_wheel(rows, wheels, size)]
    is_wide = np.ptp(rows.averages[:, :2], axis=0).max() >= MIN_EXTENT
    if is_wide and not is_reference_straight:
        families += distorted_reference(rows, rows.D_along @ wheels.distance)
    return families


def _scales(
    rows: OdometryRows,
    wheels: WheelIncrements,
    base: float,
    kind: str,
    statement: str,
    scales: Sequence[Scale],
    choice_price: float = 0.0,
) -> StructureFamily:
    """Return the family of columns that scale shares of the motion of the wheels."""
    columns = [_scaled(rows, wheels, base, part, share) for part, share in scales]
    return StructureFamily(
        kind=kind,
        columns=np.stack(columns, axis=1),
        statement=statement,
        choice_price=choice_price,
    )


def _scaled(
    rows: OdometryRows, wheels: WheelIncrements, base: float, part: Part, share: Bools | Floats
) -> Floats:
    """Return the motion of the wheels (2 n,) in one quantity, weighted by shares (n_increments,)."""
    nothing = np.zeros(len(wheels.start))
    left, right = wheels.sides(base)
    if part == "left wheel":
        return rows.of_sides(left * share, nothing, base)
    if part == "right wheel":
        return rows.of_sides(nothing, right * share, base)
    distance = wheels.distance * share if part != "turn" else nothing
    return rows.of_wheels(distance, wheels.turn * share if part != "distance" else nothing)


def _at_rest(rows: OdometryRows, wheels: WheelIncrements) -> StructureFamily:
    """Return the family of a turn rate that persists at rest, and may change over time."""
    time = wheels.end - wheels.start
    n, passed = EVIDENCE.n_pieces, wheels.middle - wheels.start[0]
    piece = np.clip((n * passed / (wheels.end[-1] - wheels.start[0])).astype(np.intp), 0, n - 1)
    turns = np.stack([time, *(time * (piece == k) for k in range(n))], axis=1)
    return StructureFamily(
        kind="at rest",
        columns=rows.of_wheels(np.zeros_like(turns), turns),
        statement="a turn that continues at rest: a gyro bias in the odometry, or a reference whose heading drifts",
    )


def _jumps(rows: OdometryRows, wheels: WheelIncrements, base: float) -> list[StructureFamily]:
    """Return one family for each of several moments, spread over the run, at which scales may change once."""
    n = EVIDENCE.n_jumps
    share = np.arange(1, n + 1) / (n + 1)
    return _changes_at(rows, wheels, base, wheels.start[0] + share * np.ptp(wheels.middle), n)


def nearer_jumps(
    rows: OdometryRows, wheels: WheelIncrements, base: float, moment: float, reach: float
) -> list[StructureFamily]:
    """Return families for moments within `reach` [s] of a moment, including it."""
    n = 2 * N_NEARER_JUMPS + 1
    moments = moment + reach * np.linspace(-1, 1, n)
    inside = (moments > wheels.start[0]) & (moments < wheels.middle[-1])
    return _changes_at(rows, wheels, base, moments[inside], EVIDENCE.n_jumps * n)


def _for_a_while(rows: OdometryRows, wheels: WheelIncrements, base: float) -> list[StructureFamily]:
    """Return one family for each pair of moments between which scales may differ: a load, a wet floor."""
    n = N_WHILE
    moments = wheels.start[0] + np.arange(1, n + 1) / (n + 1) * np.ptp(wheels.middle)
    pairs = list(combinations(moments.tolist(), 2))
    out = []
    for begin, end in pairs:
        span = f"from {begin:.0f} s to {end:.0f} s"
        meanwhile = (wheels.middle > begin) & (wheels.middle < end)
        scales: list[Scale] = [(part, meanwhile) for part in PARTS]
        price = float(np.log(len(pairs)))
        out.append(
            _scales(rows, wheels, base, "while", f"a temporary change of scale, {span}", scales, price)
        )
    return out


def jump_spacing(wheels: WheelIncrements) -> float:
    """Return the time [s] between the moments that are tried first."""
    return float(np.ptp(wheels.middle)) / (EVIDENCE.n_jumps + 1)


def _changes_at(
    rows: OdometryRows, wheels: WheelIncrements, base: float, moments: Floats, n_tried: int
) -> list[StructureFamily]:
    out = []
    for moment in moments.tolist():
        begin = f"after {moment:.0f} s"
        later = wheels.middle > moment
        family = _scales(
            rows,
            wheels,
            base,
            JUMP,
            f"a scale that changes once, {begin}",
            [(part, later) for part in PARTS],
            choice_price=float(np.log(n_tried)),
        )
        out.append(replace(family, moment=moment))
    return out


def _rates(wheels: WheelIncrements) -> Floats:
    """Return rates (n, 2) [m/s, rad/s] over the duration of a row, since a single tick in 10 ms is not a speed."""
    k = max(round(AVERAGING_TIME / float(np.median(wheels.end - wheels.start))), 1)
    window = np.ones(k)
    time = np.convolve(wheels.end - wheels.start, window, mode="same")
    moved = [np.convolve(part, window, mode="same") for part in (wheels.distance, wheels.turn)]
    return np.stack(moved, axis=1) / time[:, None]


def _speeds(rates: Floats) -> list[Scale]:
    v, omega = np.abs(rates).T
    fastest = float(np.quantile(v, 0.98)) / EVIDENCE.reference_speed
    cuts = np.array(SPEED_CUTS) * max(1.0, fastest)
    rate_cuts = np.array(RATE_CUTS) * max(1.0, float(np.quantile(omega, 0.98)))
    parts: tuple[Part, ...] = ("distance", "turn")  # a fast car turns less than its wheels are steered
    out: list[Scale] = [(part, v > c) for part in parts for c in cuts]
    return out + [("turn", omega > c) for c in rate_cuts]


def _tight_turns(rates: Floats, base: float) -> list[Scale]:
    """Return turns about a centre within some half wheelbases: in place, about a wheel, in curves."""
    v, at_rim = np.abs(rates[:, 0]), base / 2 * np.abs(rates[:, 1])
    return [("turn", v < c * at_rim) for c in TIGHT_TURNS]


def _accelerations(wheels: WheelIncrements, rates: Floats) -> list[Scale]:
    smooth = np.stack([_smoothed(x, wheels) for x in rates.T], axis=1)
    acceleration = np.abs(np.gradient(smooth, wheels.middle, axis=0))
    a, alpha = np.quantile(acceleration, ACCELERATION_QUANTILE, axis=0)
    return [("distance", acceleration[:, 0] > a), ("turn", acceleration[:, 1] > alpha)]


def _cells(rows: OdometryRows, wheels: WheelIncrements) -> list[Scale]:
    """Return the cells of the raster with the longest path of the robot."""
    cells = np.floor(rows.increment_poses[:, :2] / CELL).astype(np.intp)
    _, cell = np.unique(cells, axis=0, return_inverse=True)
    travel = np.bincount(cell.ravel(), weights=np.abs(wheels.distance))
    large = np.argsort(-travel)[:MAX_CELLS]
    large = large[travel[large] > MIN_CELL_TRAVEL]
    return [("distance and turn", cell.ravel() == k) for k in large]


def _clock_pieces(rows: OdometryRows, n: int) -> StructureFamily:
    """Return the family of clock offsets that change over time, in n pieces of the run."""
    share = (rows.stamps - rows.stamps[0]) / np.ptp(rows.stamps)
    piece = np.clip((n * share).astype(np.intp), 0, n - 1)
    columns = [rows.masked(((piece == k)[:, None] * rows.slopes).T.ravel()) for k in range(n)]
    return StructureFamily(
        kind=CLOCK,
        columns=np.stack(columns, axis=1),
        statement="a clock offset that changes over time",
    )


def _turns_of_a_wheel(rows: OdometryRows, wheels: WheelIncrements, size: Wheels) -> list[StructureFamily]:
    """Return families of wheels that are out of round or misaligned: an error that repeats with every turn.

    The turns of a wheel are counted by its own distance. Over a long run, this requires a more accurate
    radius than robot.yaml specifies, so that several radii are tried.
    """
    left, right = wheels.sides(size.base)
    nothing, out = np.zeros(len(left)), list[StructureFamily]()
    for factor in RADIUS_FACTORS:
        radius = factor * size.radius
        columns = [rows.of_sides(lost, nothing, size.base) for lost in _by_angle(left, radius)]
        columns += [rows.of_sides(nothing, lost, size.base) for lost in _by_angle(right, radius)]
        out.append(
            StructureFamily(
                kind="turns of a wheel",
                columns=np.stack(columns, axis=1),
                statement="an error that repeats with every turn of a wheel: it is out of round, or its encoder is misaligned",
                choice_price=float(np.log(len(RADIUS_FACTORS))),
            )
        )
    return out


def _by_angle(way: Floats, radius: float) -> tuple[Floats, Floats]:
    """Return the distance (n,) [m] of a wheel, multiplied by cosine and sine of its angle."""
    angle = (np.cumsum(way) - way / 2) / radius
    return way * np.cos(angle), way * np.sin(angle)


def _spinning(rows: OdometryRows, wheels: WheelIncrements, base: float) -> StructureFamily:
    """Return the family of wheels that lose a share of their distance while they speed up, each separately.

    Parameters
    ----------
    base : [m] Wheelbase.
    """
    period, ways = wheels.end - wheels.start, wheels.sides(base)
    speeds = [_smoothed(way / period, wheels) for way in ways]
    gained = [np.gradient(speed, wheels.middle) * np.sign(speed) for speed in speeds]
    columns = []
    for level in np.quantile(np.concatenate(gained), SPINNING_QUANTILES):
        left, right = (way * (gain > max(level, 0.0)) for way, gain in zip(ways, gained, strict=True))
        columns.append(rows.of_sides(left, right, base))
    return StructureFamily(
        kind="spinning",
        columns=np.stack(columns, axis=1),
        statement="a loss of motion while wheels speed up: they spin",
    )


def _smoothed(x: Floats, wheels: WheelIncrements) -> Floats:
    """Return a series (n,) averaged over several increments; their number is odd, so that there is no shift."""
    count = max(SMOOTHED, round(RAMP / float(np.median(wheels.end - wheels.start))))
    count |= 1
    return np.convolve(np.pad(x, count // 2, mode="edge"), np.ones(count) / count, mode="valid")
