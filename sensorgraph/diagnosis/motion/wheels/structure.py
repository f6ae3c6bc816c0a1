"""Structure in the difference of odometry and reference that no effect makes, as families of columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations, pairwise
from typing import Literal

import numpy as np

from sensorgraph.diagnosis.motion.increments import WheelIncrements
from sensorgraph.diagnosis.motion.settings import ODOMETRY
from sensorgraph.diagnosis.motion.structure_test import StructureFamily
from sensorgraph.diagnosis.motion.wheels.each_wheel import (
    reversals,
    smoothed,
    spinning,
    turns_of_a_wheel,
)
from sensorgraph.diagnosis.motion.wheels.reference_structure import distorted_reference
from sensorgraph.diagnosis.motion.wheels.rows import OdometryRows
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.robot import Wheels

Part = Literal["way", "turn", "way and turn", "left wheel", "right wheel"]
PARTS: tuple[Part, ...] = ("left wheel", "right wheel", "turn")
"""What may change by itself: each wheel, and the distance between them."""
Scale = tuple[str, Part, Bools]
"""Label, what is scaled, and (n_increments,) which increments."""
JUMP = "jump"
"""Kind of the families of a scale that changes once."""
CLOCK = "clock"
"""Kind of the families of a clock offset that changes in time."""


def odometry_families(
    rows: OdometryRows, wheels: WheelIncrements, size: Wheels, *, is_reference_straight: bool = False
) -> list[StructureFamily]:
    """Return differences that no library effect makes, with columns (2 n, k).

    Parameters
    ----------
    size : radius and distance of the wheels
    is_reference_straight : leave out a reference that is bent over the place
    """
    base = size.base
    rates = _rates(wheels)
    families = [
        _scales(rows, wheels, base, "time", "by a scale that changes in time", _pieces(wheels)),
        _steadily(rows, wheels, base),
        _at_rest(rows, wheels),
        *_jumps(rows, wheels, base),
        *_for_a_while(rows, wheels, base),
        _scales(rows, wheels, base, "speed", "by a scale that depends on speed or turn rate", _speeds(rates)),
        _scales(
            rows,
            wheels,
            base,
            "direction",
            "differently forward and backward, or to the left and to the right",
            [
                ("backward", "way", rates[:, 0] < 0),
                ("to the right", "turn", rates[:, 1] < 0),
            ],
        ),
        _scales(
            rows, wheels, base, "curvature", "in tight turns, by tyres that scrub", _tight_turns(rates, base)
        ),
        _scales(
            rows, wheels, base, "acceleration", "when the robot accelerates", _accelerations(wheels, rates)
        ),
    ]
    if cells := _cells(rows, wheels):
        families.append(_scales(rows, wheels, base, "place", "by a scale that depends on the place", cells))
    families += [_clock_pieces(rows, wheels, n) for n in ODOMETRY.structure.n_clock_pieces]
    families += [reversals(rows, wheels, rates, base), _headings(rows, wheels), _compass(rows, wheels)]
    families.append(spinning(rows, wheels, base))
    families += turns_of_a_wheel(rows, wheels, size)
    is_wide = np.ptp(rows.averages[:, :2], axis=0).max() >= ODOMETRY.structure.min_extent
    if is_wide and not is_reference_straight:
        families += distorted_reference(rows, rows.D_along @ wheels.distance)
    return families


def evidence_needed(dispersion: float, rows: OdometryRows) -> float:
    """Return the evidence that structure needs [nats].

    Parameters
    ----------
    dispersion : of what is left, over white noise (`StructureTest.dispersion`)
    """
    return max(ODOMETRY.structure.threshold * dispersion, ODOMETRY.structure.min_gain_per_row * rows.n)


def _scales(
    rows: OdometryRows,
    wheels: WheelIncrements,
    base: float,
    kind: str,
    statement: str,
    scales: Sequence[Scale],
    choice_price: float = 0.0,
) -> StructureFamily:
    """Return the family of columns that scale what the wheels say in some increments."""
    columns = [_scaled(rows, wheels, base, part, mask.astype(np.float64)) for _, part, mask in scales]
    return StructureFamily(
        kind=kind,
        columns=np.stack(columns, axis=1),
        labels=[f"{label}, {part}" for label, part, _ in scales],
        sigma=ODOMETRY.structure.scale_sigma,
        statement=statement,
        choice_price=choice_price,
    )


def _scaled(rows: OdometryRows, wheels: WheelIncrements, base: float, part: Part, share: Floats) -> Floats:
    """Return what the wheels say (2 n,) in a part, by shares (n_increments,)."""
    nothing = np.zeros(len(wheels.start))
    left, right = wheels.sides(base)
    if part == "left wheel":
        return rows.of_sides(left * share, nothing, base)
    if part == "right wheel":
        return rows.of_sides(nothing, right * share, base)
    distance = wheels.distance * share if part != "turn" else nothing
    return rows.of_wheels(distance, wheels.turn * share if part != "way" else nothing)


def _steadily(rows: OdometryRows, wheels: WheelIncrements, base: float) -> StructureFamily:
    """Return the family of wheels, and of a base, that change all the time at one rate."""
    share = (wheels.middle - wheels.start[0]) / np.ptp(wheels.middle) - 0.5
    return StructureFamily(
        kind="steady change",
        columns=np.stack([_scaled(rows, wheels, base, part, share) for part in PARTS], axis=1),
        labels=[f"{part}, from begin to end" for part in PARTS],
        sigma=ODOMETRY.structure.scale_sigma,
        statement="by wheels that change steadily during the run: a tyre that loses air, a load that shifts",
    )


def _at_rest(rows: OdometryRows, wheels: WheelIncrements) -> StructureFamily:
    """Return the family of a turn that goes on whether the robot moves or not, at a rate that may change in time."""
    time = wheels.end - wheels.start
    piece = _piece(wheels)
    n = ODOMETRY.structure.n_pieces
    turns = np.stack([time, *(time * (piece == k) for k in range(n))], axis=1)
    return StructureFamily(
        kind="at rest",
        columns=rows.of_wheels(np.zeros_like(turns), turns),
        labels=["turn", *(f"turn, {span}" for span in _spans(wheels, n))],
        sigma=ODOMETRY.structure.rest_sigma,
        statement="by a turn that goes on at rest: the bias of a gyro in the odometry, or a reference that turns away",
    )


def _piece(wheels: WheelIncrements) -> Ints:
    """Return in which of `n_pieces` equal pieces of the run each increment lies (n,)."""
    n = ODOMETRY.structure.n_pieces
    span = wheels.end[-1] - wheels.start[0]
    return np.asarray(np.clip((n * (wheels.middle - wheels.start[0]) / span).astype(np.intp), 0, n - 1))


def _pieces(wheels: WheelIncrements) -> list[Scale]:
    piece = _piece(wheels)
    labels = _spans(wheels, ODOMETRY.structure.n_pieces)
    return [(label, part, piece == k) for k, label in enumerate(labels) for part in PARTS]


def _jumps(rows: OdometryRows, wheels: WheelIncrements, base: float) -> list[StructureFamily]:
    """Return one family for each of some moments, spread over the run, at which scales may change once."""
    n = ODOMETRY.structure.n_jumps
    share = np.arange(1, n + 1) / (n + 1)
    return _changes_at(rows, wheels, base, wheels.start[0] + share * np.ptp(wheels.middle), n)


def nearer_jumps(
    rows: OdometryRows, wheels: WheelIncrements, base: float, moment: float, reach: float
) -> list[StructureFamily]:
    """Return families of moments within `reach` [s] of one, itself among them."""
    n = 2 * ODOMETRY.structure.n_nearer_jumps + 1
    moments = moment + reach * np.linspace(-1, 1, n)
    inside = (moments > wheels.start[0]) & (moments < wheels.middle[-1])
    return _changes_at(rows, wheels, base, moments[inside], ODOMETRY.structure.n_jumps * n)


def _for_a_while(rows: OdometryRows, wheels: WheelIncrements, base: float) -> list[StructureFamily]:
    """Return one family for each two of some moments, between which scales may be others: a load, a wet floor."""
    n = ODOMETRY.structure.n_while
    moments = wheels.start[0] + np.arange(1, n + 1) / (n + 1) * np.ptp(wheels.middle)
    pairs = list(combinations(moments.tolist(), 2))
    out = []
    for begin, end in pairs:
        span = f"from {begin:.0f} s to {end:.0f} s"
        meanwhile = (wheels.middle > begin) & (wheels.middle < end)
        scales: list[Scale] = [(span, part, meanwhile) for part in PARTS]
        price = float(np.log(len(pairs)))
        out.append(
            _scales(rows, wheels, base, "while", f"by another scale for a while, {span}", scales, price)
        )
    return out


def jump_spacing(wheels: WheelIncrements) -> float:
    """Return the time [s] between the moments that are tried first."""
    return float(np.ptp(wheels.middle)) / (ODOMETRY.structure.n_jumps + 1)


def _changes_at(
    rows: OdometryRows, wheels: WheelIncrements, base: float, moments: Floats, n_tried: int
) -> list[StructureFamily]:
    out = []
    for moment in moments.tolist():
        begin = f"from {moment:.0f} s on"
        later = wheels.middle > moment
        family = _scales(
            rows,
            wheels,
            base,
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
    parts: tuple[Part, ...] = ("way", "turn")  # a car that goes fast turns less than its wheels are steered
    out: list[Scale] = [(f"|v| above {c:.2f} m/s", part, v > c) for part in parts for c in cuts]
    return out + [(f"|omega| above {c:.2f} rad/s", "turn", omega > c) for c in rate_cuts]


def _tight_turns(rates: Floats, base: float) -> list[Scale]:
    """Return turns about a point less than so many half bases away: in place, beside a wheel, in curves."""
    v, at_rim = np.abs(rates[:, 0]), base / 2 * np.abs(rates[:, 1])
    return [(f"within {c:g} half bases", "turn", v < c * at_rim) for c in ODOMETRY.structure.tight_turns]


def _accelerations(wheels: WheelIncrements, rates: Floats) -> list[Scale]:
    smooth = np.stack([smoothed(x, wheels) for x in rates.T], axis=1)
    acceleration = np.abs(np.gradient(smooth, wheels.middle, axis=0))
    a, alpha = np.quantile(acceleration, ODOMETRY.structure.acceleration_quantile, axis=0)
    return [
        (f"above {a:.2f} m/s²", "way", acceleration[:, 0] > a),
        (f"above {alpha:.2f} rad/s²", "turn", acceleration[:, 1] > alpha),
    ]


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


def _clock_pieces(rows: OdometryRows, wheels: WheelIncrements, n: int) -> StructureFamily:
    """Return the family of clock offsets that change in time, in n pieces of the run."""
    share = (rows.stamps - rows.stamps[0]) / np.ptp(rows.stamps)
    piece = np.clip((n * share).astype(np.intp), 0, n - 1)
    columns = [rows.masked(((piece == k)[:, None] * rows.slopes).T.ravel()) for k in range(n)]
    return StructureFamily(
        kind=CLOCK,
        columns=np.stack(columns, axis=1),
        labels=[f"{span}, clock" for span in _spans(wheels, n)],
        sigma=ODOMETRY.structure.scale_sigma,
        statement="by a clock offset that changes in time",
    )


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


def _compass(rows: OdometryRows, wheels: WheelIncrements) -> StructureFamily:
    """Return the family of turns that are more at some headings and less at the opposite ones.

    Iron beside a compass deviates it by the sine of the heading (Bowditch, American Practical Navigator, on semicircular deviation).
    """
    phi, nothing = rows.increment_poses[:, 2], np.zeros(len(wheels.start))
    turns = [wheels.turn * axis for axis in (np.cos(phi), np.sin(phi))]
    return StructureFamily(
        kind="compass",
        columns=np.stack([rows.of_wheels(nothing, one) for one in turns], axis=1),
        labels=["towards x of the map, turn", "towards y of the map, turn"],
        sigma=ODOMETRY.structure.scale_sigma,
        statement="by turns whose scale depends on the heading: a compass beside iron, in odometry or reference",
    )


def _spans(wheels: WheelIncrements, n: int) -> list[str]:
    """Return labels of n equal pieces of the run."""
    edges = np.linspace(wheels.start[0], wheels.end[-1], n + 1)
    return [f"{a:.0f} to {b:.0f} s" for a, b in pairwise(edges)]
