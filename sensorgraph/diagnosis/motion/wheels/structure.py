"""Structure in the difference of odometry and reference that no effect makes, as families of columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Literal

import numpy as np
from scipy.special import gammaln

from sensorgraph.diagnosis.motion.increments import WheelIncrements
from sensorgraph.diagnosis.motion.settings import ODOMETRY
from sensorgraph.diagnosis.motion.structure_test import StructureFamily
from sensorgraph.diagnosis.motion.wheels.rows import OdometryRows
from sensorgraph.diagnosis.motion.whitening import MAD_TO_SIGMA
from sensorgraph.types import Bools, Floats
from sensorgraph.world.robot import Wheels

Part = Literal["way", "turn", "way and turn"]
PARTS: tuple[Part, Part] = ("way", "turn")
Scale = tuple[str, Part, Bools]
"""Label, what is scaled, and (n_increments,) which increments."""
JUMP = "jump"
"""Kind of the families of a scale that changes once."""
SMOOTHED = 5
"""Increments that a wheel's speed is averaged over before its acceleration is taken."""
HIGHEST_WAVE = 5
"""Half waves of a distorted yaw along each axis, 0 to 4."""
HIGHEST_WAVES = 7
"""Half waves of both axes together, 1 to 6."""
HIGHEST_POWER = 4
"""Powers of a distorted position along each axis and of both together, up to 3."""


def odometry_families(rows: OdometryRows, wheels: WheelIncrements, size: Wheels) -> list[StructureFamily]:
    """Return differences that no library effect makes, with columns (2 n, k).

    Parameters
    ----------
    size : radius and distance of the wheels
    """
    base = size.base
    rates = _rates(wheels)
    families = [
        _scales(rows, wheels, "time", "by a scale that changes in time", _pieces(wheels)),
        *_jumps(rows, wheels),
        _scales(rows, wheels, "speed", "by a scale that depends on speed or turn rate", _speeds(rates)),
        _scales(
            rows,
            wheels,
            "direction",
            "differently forward and backward, or to the left and to the right",
            [
                ("backward", "way", rates[:, 0] < 0),
                ("to the right", "turn", rates[:, 1] < 0),
            ],
        ),
        _scales(rows, wheels, "acceleration", "when the robot accelerates", _accelerations(wheels, rates)),
    ]
    if cells := _cells(rows, wheels):
        families.append(_scales(rows, wheels, "place", "by a scale that depends on the place", cells))
    families += [_clock_pieces(rows, wheels), _reversals(rows, wheels, rates, base), _headings(rows, wheels)]
    families.append(_spinning(rows, wheels, base))
    families += _turns_of_a_wheel(rows, wheels, size)
    if np.ptp(rows.averages[:, :2], axis=0).max() >= ODOMETRY.structure.min_extent:
        families += _distorted_reference(rows, rows.D_along @ wheels.distance)
    return families


def _scales(
    rows: OdometryRows,
    wheels: WheelIncrements,
    kind: str,
    statement: str,
    scales: Sequence[Scale],
    choice_price: float = 0.0,
) -> StructureFamily:
    """Return the family of columns that scale what the wheels say in some increments."""
    columns, nothing = [], np.zeros(len(wheels.start))
    for _, part, mask in scales:
        distance = wheels.distance * mask if part != "turn" else nothing
        turn = wheels.turn * mask if part != "way" else nothing
        columns.append(rows.of_wheels(distance, turn))
    return StructureFamily(
        kind=kind,
        columns=np.stack(columns, axis=1),
        labels=[f"{label}, {part}" for label, part, _ in scales],
        sigma=ODOMETRY.structure.scale_sigma,
        statement=statement,
        choice_price=choice_price,
    )


def _pieces(wheels: WheelIncrements) -> list[Scale]:
    n = ODOMETRY.structure.n_pieces
    span = wheels.end[-1] - wheels.start[0]
    piece = np.clip((n * (wheels.middle - wheels.start[0]) / span).astype(np.intp), 0, n - 1)
    labels = _spans(wheels, n)
    return [(labels[k], part, piece == k) for k in range(n) for part in PARTS]


def _jumps(rows: OdometryRows, wheels: WheelIncrements) -> list[StructureFamily]:
    """Return one family for each of some moments, spread over the run, at which scales may change once."""
    n = ODOMETRY.structure.n_jumps
    share = np.arange(1, n + 1) / (n + 1)
    return _changes_at(rows, wheels, wheels.start[0] + share * np.ptp(wheels.middle), n)


def nearer_jumps(
    rows: OdometryRows, wheels: WheelIncrements, moment: float, reach: float
) -> list[StructureFamily]:
    """Return families of moments within `reach` [s] of one, itself among them."""
    n = 2 * ODOMETRY.structure.n_nearer_jumps + 1
    moments = moment + reach * np.linspace(-1, 1, n)
    inside = (moments > wheels.start[0]) & (moments < wheels.middle[-1])
    return _changes_at(rows, wheels, moments[inside], ODOMETRY.structure.n_jumps * n)


def jump_spacing(wheels: WheelIncrements) -> float:
    """Return the time [s] between the moments that are tried first."""
    return float(np.ptp(wheels.middle)) / (ODOMETRY.structure.n_jumps + 1)


def _changes_at(
    rows: OdometryRows, wheels: WheelIncrements, moments: Floats, n_tried: int
) -> list[StructureFamily]:
    out = []
    for moment in moments.tolist():
        begin = f"from {moment:.0f} s on"
        later = wheels.middle > moment
        family = _scales(
            rows,
            wheels,
            JUMP,
            f"by a scale that changes once, {begin}",
            [(begin, part, later) for part in PARTS],
            choice_price=float(np.log(n_tried)),
        )
        out.append(replace(family, moment=moment))
    return out


def _rates(wheels: WheelIncrements) -> Floats:
    """Return rates (n, 2) [m/s, rad/s] over the time of a row: a tick in 10 ms makes no speed."""
    k = max(round(ODOMETRY.rows.averaging_time / float(np.median(wheels.end - wheels.start))), 1)
    window = np.ones(k)
    time = np.convolve(wheels.end - wheels.start, window, mode="same")
    moved = [np.convolve(part, window, mode="same") for part in (wheels.distance, wheels.turn)]
    return np.stack(moved, axis=1) / time[:, None]


def _speeds(rates: Floats) -> list[Scale]:
    v, omega = np.abs(rates).T
    fastest = float(np.quantile(v, 0.98)) / ODOMETRY.structure.reference_speed
    cuts = np.array(ODOMETRY.structure.speed_cuts) * max(1.0, fastest)
    rate_cuts = np.array(ODOMETRY.structure.rate_cuts) * max(1.0, float(np.quantile(omega, 0.98)))
    out: list[Scale] = [(f"|v| above {c:.2f} m/s", "way", v > c) for c in cuts]
    return out + [(f"|omega| above {c:.2f} rad/s", "turn", omega > c) for c in rate_cuts]


def _accelerations(wheels: WheelIncrements, rates: Floats) -> list[Scale]:
    smooth = np.stack([_smoothed(x) for x in rates.T], axis=1)
    acceleration = np.abs(np.gradient(smooth, wheels.middle, axis=0))
    a, alpha = np.quantile(acceleration, ODOMETRY.structure.acceleration_quantile, axis=0)
    return [
        (f"above {a:.2f} m/s²", "way", acceleration[:, 0] > a),
        (f"above {alpha:.2f} rad/s²", "turn", acceleration[:, 1] > alpha),
    ]


def _smoothed(x: Floats) -> Floats:
    """Return a series averaged over some increments."""
    kernel = np.ones(SMOOTHED) / SMOOTHED
    return np.convolve(np.pad(x, SMOOTHED // 2, mode="edge"), kernel, mode="valid")


def _cells(rows: OdometryRows, wheels: WheelIncrements) -> list[Scale]:
    """Return the cells of the raster that the robot drove through most."""
    cells = np.floor(rows.increment_poses[:, :2] / ODOMETRY.structure.cell).astype(np.intp)
    keys, cell = np.unique(cells, axis=0, return_inverse=True)
    travel = np.bincount(cell.ravel(), weights=np.abs(wheels.distance))
    large = np.argsort(-travel)[: ODOMETRY.structure.max_cells]
    large = large[travel[large] > ODOMETRY.structure.min_cell_travel]
    centres = (keys + 0.5) * ODOMETRY.structure.cell
    return [
        (f"round ({centres[k][0]:.1f}, {centres[k][1]:.1f})", "way and turn", cell.ravel() == k)
        for k in large
    ]


def _clock_pieces(rows: OdometryRows, wheels: WheelIncrements) -> StructureFamily:
    """Return the family of clock offsets that change in time."""
    n = ODOMETRY.structure.n_clock_pieces
    share = (rows.stamps - rows.stamps[0]) / np.ptp(rows.stamps)
    piece = np.clip((n * share).astype(np.intp), 0, n - 1)
    columns = [rows.masked(((piece == k)[:, None] * rows.slopes).T.ravel()) for k in range(n)]
    return StructureFamily(
        kind="clock",
        columns=np.stack(columns, axis=1),
        labels=[f"{span}, clock" for span in _spans(wheels, n)],
        sigma=ODOMETRY.structure.scale_sigma,
        statement="by a clock offset that changes in time",
    )


def _reversals(rows: OdometryRows, wheels: WheelIncrements, rates: Floats, base: float) -> StructureFamily:
    """Return the family of wheels that move the body only some millimetres after they have turned back: play in a gear.

    Parameters
    ----------
    rates : (n, 2) [m/s, rad/s] of the wheels' increments
    base : [m] between the wheels
    """
    lost = []
    for side in (-1.0, 1.0):
        speed = rates[:, 0] + side * base / 2 * rates[:, 1]
        way = np.abs(wheels.distance + side * base / 2 * wheels.turn)
        sign = np.where(np.abs(speed) > ODOMETRY.structure.least_turning, np.sign(speed), 0.0)
        moving = np.flatnonzero(sign)
        turned_back = moving[1:][np.diff(sign[moving]) != 0]
        travelled = np.cumsum(way)
        since = np.searchsorted(turned_back, np.arange(len(way)), side="right") - 1
        begin = np.append(travelled[turned_back] - way[turned_back], -np.inf)[
            since
        ]  # before the first: long ago
        inside = np.clip(
            (begin + ODOMETRY.structure.play - (travelled - way)) / np.maximum(way, 1e-9), 0.0, 1.0
        )
        lost.append((wheels.distance + side * base / 2 * wheels.turn) * inside)
    left, right = lost
    column = rows.of_wheels((left + right) / 2, (right - left) / base)
    return StructureFamily(
        kind="reversal",
        columns=column[:, None],
        labels=["after a wheel has turned back"],
        sigma=1.0,
        statement="by what is lost after a wheel has turned back: play",
    )


def _spinning(rows: OdometryRows, wheels: WheelIncrements, base: float) -> StructureFamily:
    """Return the family of wheels that lose a share of their way while they gain speed, each by itself.

    Parameters
    ----------
    base : [m] between the wheels
    """
    period = wheels.end - wheels.start
    gained, ways = [], []
    for side in (-1.0, 1.0):
        way = wheels.distance + side * base / 2 * wheels.turn
        speed = _smoothed(way / period)
        gained.append(np.gradient(speed, wheels.middle) * np.sign(speed))
        ways.append(way)
    columns = []
    for level in np.quantile(np.concatenate(gained), ODOMETRY.structure.spinning_quantiles):
        left, right = (way * (gain > max(level, 0.0)) for way, gain in zip(ways, gained, strict=True))
        columns.append(rows.of_wheels((left + right) / 2, (right - left) / base))
    return StructureFamily(
        kind="spinning",
        columns=np.stack(columns, axis=1),
        labels=[f"the {1 - q:.0%} that gain most" for q in ODOMETRY.structure.spinning_quantiles],
        sigma=ODOMETRY.structure.scale_sigma,
        statement="by what wheels lose while they gain speed: they spin",
    )


def _turns_of_a_wheel(rows: OdometryRows, wheels: WheelIncrements, size: Wheels) -> list[StructureFamily]:
    """Return families of wheels that are out of round or sit askew: they move the body more and less once a turn.

    A wheel's turns are counted by its own way. Over a long run that needs its radius better than robot.yaml has it, so
    that some are tried.
    """
    ways = [wheels.distance + side * size.base / 2 * wheels.turn for side in (-1.0, 1.0)]
    out = []
    for factor in ODOMETRY.structure.radius_factors:
        columns = []
        for side, way in zip((-1.0, 1.0), ways, strict=True):
            angle = (np.cumsum(way) - way / 2) / (factor * size.radius)
            for wave in (np.cos(angle), np.sin(angle)):
                columns.append(rows.of_wheels(way * wave / 2, side * way * wave / size.base))
        out.append(
            StructureFamily(
                kind="turns of a wheel",
                columns=np.stack(columns, axis=1),
                labels=[f"{wheel} wheel, once a turn" for wheel in ("left", "left", "right", "right")],
                sigma=ODOMETRY.structure.scale_sigma,
                statement="once in every turn of a wheel: it is out of round, or its encoder sits askew",
                choice_price=float(np.log(len(ODOMETRY.structure.radius_factors))),
            )
        )
    return out


def _headings(rows: OdometryRows, wheels: WheelIncrements) -> StructureFamily:
    """Return the family of a way that is longer in one direction of the map: a slope, the pile of a carpet."""
    phi, nothing = rows.increment_poses[:, 2], np.zeros(len(wheels.start))
    along = [np.abs(wheels.distance) * axis for axis in (np.cos(phi), np.sin(phi))]
    return StructureFamily(
        kind="heading",
        columns=np.stack([rows.of_wheels(one, nothing) for one in along], axis=1),
        labels=["along x of the map, way", "along y of the map, way"],
        sigma=ODOMETRY.structure.scale_sigma,
        statement="by a scale that depends on the heading",
    )


def _distorted_reference(rows: OdometryRows, distance: Floats) -> list[StructureFamily]:
    """Return families of a reference that is distorted over the place.

    Parameters
    ----------
    distance : (n,) [m] of the wheels; steps of the reference itself would bring its noise into the columns
    """
    xy = (rows.averages[1:, :2] + rows.averages[:-1, :2]) / 2
    low, size = xy.min(axis=0), float(np.ptp(xy, axis=0).max())
    u, v = ((xy - low) / size).T
    c, s = np.cos(rows.poses[:, 2]), np.sin(rows.poses[:, 2])
    du, dv = distance * c / size, distance * s / size
    # change over a row of the waves cos(π a u) cos(π b v), and of the powers u^a v^b about the middle
    waves = [
        -np.pi * a * np.sin(np.pi * a * u) * np.cos(np.pi * b * v) * du
        - np.pi * b * np.cos(np.pi * a * u) * np.sin(np.pi * b * v) * dv
        for a in range(HIGHEST_WAVE)
        for b in range(HIGHEST_WAVE)
        if 0 < a + b < HIGHEST_WAVES
    ]
    u, v = u - 0.5, v - 0.5
    powers = [
        a * u ** max(a - 1, 0) * v**b * du + b * u**a * v ** max(b - 1, 0) * dv
        for a in range(HIGHEST_POWER)
        for b in range(HIGHEST_POWER)
        if 0 < a + b < HIGHEST_POWER
    ]
    nothing = np.zeros(rows.n)
    yaw = [rows.masked(np.concatenate([nothing, wave])) for wave in waves]
    position = [rows.masked(np.concatenate([axis * p, nothing])) for p in powers for axis in (c, s)]
    return [
        StructureFamily(
            kind="reference yaw",
            columns=np.stack(yaw, axis=1),
            labels=["yaw of the reference by place"] * len(yaw),
            sigma=ODOMETRY.structure.yaw_sigma,
            statement="by a yaw of the reference that depends on the place",
            is_of_reference=True,
        ),
        StructureFamily(
            kind="reference place",
            columns=np.stack(position, axis=1),
            labels=["position of the reference by place"] * len(position),
            sigma=ODOMETRY.structure.position_sigma,
            statement="by a position of the reference that is distorted over the place",
            is_of_reference=True,
        ),
    ]


def reference_jumps(rows: OdometryRows, residual: Floats) -> list[StructureFamily]:
    """Return families of a reference that jumps at one moment, at two, at four and so on: where most is left.

    A camera that takes over from another is off by a constant before and after; what a wheel loses on a slippery patch
    takes as long as the patch.

    Parameters
    ----------
    residual : (2 n,) what a model without patches leaves
    """
    parts = [residual[: rows.n], residual[rows.n :]]
    spreads = [MAD_TO_SIGMA * float(np.median(np.abs(part[rows.valid]))) + 1e-12 for part in parts]
    size = sum((part / spread) ** 2 for part, spread in zip(parts, spreads, strict=True))
    largest = np.argsort(-np.where(rows.valid, size, 0.0))
    out = []
    for k in ODOMETRY.structure.n_reference_jumps:
        columns = np.zeros((2 * rows.n, 2 * k))
        columns[largest[:k], np.arange(k)] = columns[rows.n + largest[:k], k + np.arange(k)] = 1.0
        out.append(
            StructureFamily(
                kind="reference jumps",
                columns=columns,
                labels=[],
                sigma=ODOMETRY.structure.jump_sigma,
                statement="by jumps of the reference at single moments",
                is_of_reference=True,
                choice_price=float(gammaln(rows.n + 1) - gammaln(k + 1) - gammaln(rows.n - k + 1)),
            )
        )
    return out


def _spans(wheels: WheelIncrements, n: int) -> list[str]:
    """Return labels of n equal pieces of the run."""
    edges = np.linspace(wheels.start[0], wheels.end[-1], n + 1)
    return [f"{a:.0f} to {b:.0f} s" for a, b in pairwise(edges)]
