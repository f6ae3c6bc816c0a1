"""Families of columns for differences between odometry and reference poses that no effect explains.

Rows are of three kinds: distance along the heading, turn, and distance across the heading, which the wheels do not
measure. A column is what a cause adds to each of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from scipy.special import gammaln

from sensorgraph.diagnosis.motion.increments import WheelIncrements
from sensorgraph.diagnosis.motion.structure_test import StructureFamily, above_quarters, pieces
from sensorgraph.diagnosis.motion.wheel_rows import AVERAGING_TIME, OdometryRows
from sensorgraph.diagnosis.motion.whitening import by_kind
from sensorgraph.robust import robust_sigma
from sensorgraph.types import Bools, Floats
from sensorgraph.world.robot import Wheels

ODOMETRY_FAMILIES = {
    "steady change": ("wheels_steady_change", "wheels that change steadily, as a tyre that loses air"),
    "at rest": ("turn_at_rest", "a turn that continues at rest, as from a gyro bias"),
    "jump": ("wheels_jump", "wheel scales that change once"),
    "speed": ("wheels_by_speed", "wheel scales that depend on speed or turn rate"),
    "direction": ("wheels_by_direction", "wheel scales that differ between directions of motion"),
    "curvature": ("wheels_in_tight_turns", "wheel scales that differ in tight turns"),
    "heading": ("motion_by_heading", "a motion or a turn scale that depends on the heading"),
    "clock": ("clock_over_time", "a clock offset that changes over time"),
    "turns of a wheel": ("wheel_out_of_round", "an error that repeats with every turn of a wheel"),
    "reference yaw": ("reference_yaw_by_place", "a heading error of the reference that depends on the place"),
    "reference place": ("reference_by_place", "a position error of the reference that depends on the place"),
    "reference jumps": ("reference_jumps", "jumps of the reference at single moments"),
    "sideways curve": ("sliding_in_curves", "sideways sliding in curves"),
    "askew": ("askew", "a direction of travel at an angle to the heading"),
}
"""Kind -> name in the ledger, and noun phrase."""

Part = Literal["distance", "turn", "left wheel", "right wheel"]
PARTS: tuple[Part, ...] = ("left wheel", "right wheel", "turn")
"""Quantities that may change separately: each wheel, and the distance between them."""
Scale = tuple[Part, Bools | Floats]
"""Scaled quantity, and (n_increments,) the share of each increment that is scaled."""
N_JUMPS = 90
"""Number of moments that are tried for a single change."""
TIGHT_TURNS = (0.3, 1.0, 3.0)
"""Distance from the middle of the axle to the centre of rotation, in half wheelbases, below which a turn
is tight."""
MAX_RADIUS_ERROR, N_RADII = 0.03, 7
"""Maximum relative error of the wheel radius in robot.yaml, and number of radii for the count of turns; 1 % of 60 m is one
turn."""
HIGHEST_WAVE = 5
"""Exclusive upper limit of the half waves of a distorted yaw along each axis."""
HIGHEST_POWER = 4
"""Exclusive upper limit of the powers of a distorted position, along each axis and of both together."""
N_REFERENCE_JUMPS = 5
"""How many numbers of jumps of the reference are tried: 1, 2, 4, ... jumps, each within a tenth of a second."""


def odometry_families(rows: OdometryRows, wheels: WheelIncrements, size: Wheels) -> list[StructureFamily]:
    """Return the families of differences that no effect explains, with columns (3 n, k).

    Parameters
    ----------
    size : Radius and distance of the wheels.
    """
    rates = _rates(wheels)
    passed = (wheels.middle - wheels.start[0]) / np.ptp(wheels.middle)
    by_direction: list[Scale] = [("distance", rates[:, 0] < 0), ("turn", rates[:, 1] < 0)]
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
    ]
    v, at_rim = np.abs(rates[:, 0]), size.base / 2 * np.abs(rates[:, 1])
    tight: list[Scale] = [("turn", v < c * at_rim) for c in TIGHT_TURNS]
    scales.append(("curvature", "a scale that differs in tight turns: the tyres scrub", tight))
    families = [_scales(rows, wheels, size.base, *one) for one in scales]
    families += [_at_rest(rows, wheels), *scale_jumps(rows, wheels, size.base)]
    families += [
        _clock_pieces(rows),
        *_turns_of_a_wheel(rows, wheels, size),
        _by_heading(rows, wheels),
        _sliding(rows, wheels),
        *distorted_reference(rows, rows.D_along @ wheels.distance),
    ]
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
        kind=kind, columns=np.stack(columns, axis=1), statement=statement, choice_price=choice_price
    )


def _scaled(
    rows: OdometryRows, wheels: WheelIncrements, base: float, part: Part, share: Bools | Floats
) -> Floats:
    """Return the motion of the wheels (3 n,) in one quantity, weighted by shares (n_increments,)."""
    nothing = np.zeros(len(wheels.start))
    left, right = wheels.sides(base)
    if part == "left wheel":
        return rows.of_sides(left * share, nothing, base)
    if part == "right wheel":
        return rows.of_sides(nothing, right * share, base)
    distance = wheels.distance * share if part == "distance" else nothing
    return rows.of_wheels(distance, wheels.turn * share if part == "turn" else nothing)


def _at_rest(rows: OdometryRows, wheels: WheelIncrements) -> StructureFamily:
    """Return the family of a turn rate that persists at rest, and may change over time."""
    time, first = wheels.end - wheels.start, wheels.start[0]
    parts = pieces(wheels.middle - first, wheels.end[-1] - first)
    turns = np.stack([time, *(time * part for part in parts)], axis=1)
    return StructureFamily(
        kind="at rest",
        columns=rows.of_wheels(np.zeros_like(turns), turns),
        statement="a turn that continues at rest: a gyro bias in the odometry, or a reference whose heading drifts",
    )


def scale_jumps(rows: OdometryRows, wheels: WheelIncrements, base: float) -> list[StructureFamily]:
    """Return one family for each of several moments, spread over the run, at which scales may change once."""
    first, span, price = wheels.start[0], float(np.ptp(wheels.middle)), float(np.log(N_JUMPS))
    moments = first + span * np.arange(1, N_JUMPS + 1) / (N_JUMPS + 1)
    out = list[StructureFamily]()
    for moment in moments.tolist():
        scales: list[Scale] = [(part, wheels.middle > moment) for part in PARTS]
        statement = f"a scale that changes once, after {moment:.0f} s"
        out.append(_scales(rows, wheels, base, "jump", statement, scales, price))
    return out


def _rates(wheels: WheelIncrements) -> Floats:
    """Return rates (n, 2) [m/s, rad/s] over the duration of a row, since a single tick in 10 ms is not a speed."""
    k = max(round(AVERAGING_TIME / float(np.median(wheels.end - wheels.start))), 1)
    window = np.ones(k)
    time = np.convolve(wheels.end - wheels.start, window, mode="same")
    moved = [np.convolve(part, window, mode="same") for part in (wheels.distance, wheels.turn)]
    return np.stack(moved, axis=1) / time[:, None]


def _speeds(rates: Floats) -> list[Scale]:
    fast, turning = (above_quarters(rate) for rate in rates.T)
    parts: tuple[Part, ...] = ("distance", "turn")  # a fast car turns less than its wheels are steered
    out: list[Scale] = [(part, above) for part in parts for above in fast]
    return out + [("turn", above) for above in turning]


def _clock_pieces(rows: OdometryRows) -> StructureFamily:
    """Return the family of clock offsets that change over time."""
    parts = pieces((rows.stamps - rows.stamps[0]) / np.ptp(rows.stamps))
    columns = [rows.of_kinds(*(part[:, None] * rows.slopes).T) for part in parts]
    return StructureFamily(
        kind="clock",
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
    for error in np.linspace(-MAX_RADIUS_ERROR, MAX_RADIUS_ERROR, N_RADII).tolist():
        radius = (1 + error) * size.radius
        columns = [rows.of_sides(lost, nothing, size.base) for lost in _by_angle(left, radius)]
        columns += [rows.of_sides(nothing, lost, size.base) for lost in _by_angle(right, radius)]
        out.append(
            StructureFamily(
                kind="turns of a wheel",
                columns=np.stack(columns, axis=1),
                statement="an error that repeats with every turn of a wheel: it is out of round, or its encoder is misaligned",
                choice_price=float(np.log(N_RADII)),
            )
        )
    return out


def _by_angle(way: Floats, radius: float) -> tuple[Floats, Floats]:
    """Return the distance (n,) [m] of a wheel, multiplied by cosine and sine of its angle."""
    angle = (np.cumsum(way) - way / 2) / radius
    return way * np.cos(angle), way * np.sin(angle)


def _by_heading(rows: OdometryRows, wheels: WheelIncrements) -> StructureFamily:
    """Return the family of a floor that carries the body to one side of the room, or of a compass near iron.

    Iron deviates a compass by the sine of the heading (Bowditch, American Practical Navigator).
    """
    phi, nothing = rows.poses[:, 2], np.zeros(rows.n)
    way, turn = np.abs(rows.D_along @ wheels.distance), rows.D_yaw @ wheels.turn
    c, s = np.cos(phi), np.sin(phi)
    columns = [rows.of_kinds(way * u, nothing) for u in (c, s)]
    columns += [rows.of_kinds(nothing, turn * u) for u in (c, s)]
    columns += [rows.of_kinds(nothing, nothing, way * u) for u in (c, s)]
    return StructureFamily(
        kind="heading",
        columns=np.stack(columns, axis=1),
        statement="a motion that depends on the heading: a slope, the pile of a carpet, or a compass near iron",
    )


def _sliding(rows: OdometryRows, wheels: WheelIncrements) -> StructureFamily:
    """Return the family of a body that slides outward in curves."""
    nothing = np.zeros(rows.n)
    return StructureFamily(
        kind="sideways curve",
        columns=rows.of_kinds(nothing, nothing, in_curves(rows, wheels))[:, None],
        statement="sideways sliding in curves, or positions that are older than the headings",
    )


def in_curves(rows: OdometryRows, wheels: WheelIncrements) -> Floats:
    """Return distance times turn rate (n,) [m rad/s] of each row: how far headings change while the body moves."""
    return np.asarray(
        (rows.D_along @ wheels.distance) * (rows.D_yaw @ wheels.turn) / np.gradient(rows.stamps)
    )


# reference -----------------------------------------------------------------------------------------------------------


def distorted_reference(rows: OdometryRows, distance: Floats) -> list[StructureFamily]:
    """Return families of a reference that is distorted over the place.

        yaw:       cos(pi a u) cos(pi b v)
        position:  (u - 1/2)^a (v - 1/2)^b

    u and v are the position in units of the extent of the run. A column is the change over each row.

    Parameters
    ----------
    distance : (n,) [m] Of the wheels. Steps of the reference itself would bring its noise into the columns.
    """
    xy = (rows.averages[1:, :2] + rows.averages[:-1, :2]) / 2
    low, size = xy.min(axis=0), float(np.ptp(xy, axis=0).max())
    u, v = ((xy - low) / size).T
    c, s = np.cos(rows.poses[:, 2]), np.sin(rows.poses[:, 2])
    du, dv = distance * c / size, distance * s / size
    # change over a row of the waves cos(π a u) cos(π b v), and of the powers u^a v^b about the middle
    pairs = [
        (a, b) for a in range(HIGHEST_WAVE) for b in range(HIGHEST_WAVE) if 0 < a + b < 2 * HIGHEST_WAVE - 3
    ]
    headings = [np.cos(np.pi * a * u) * np.cos(np.pi * b * v) for a, b in pairs]
    waves = [
        -np.pi * a * np.sin(np.pi * a * u) * np.cos(np.pi * b * v) * du
        - np.pi * b * np.cos(np.pi * a * u) * np.sin(np.pi * b * v) * dv
        for a, b in pairs
    ]
    u, v = u - 0.5, v - 0.5
    powers = [
        a * u ** max(a - 1, 0) * v**b * du + b * u**a * v ** max(b - 1, 0) * dv
        for a in range(HIGHEST_POWER)
        for b in range(HIGHEST_POWER)
        if 0 < a + b < HIGHEST_POWER
    ]
    nothing = np.zeros(rows.n)
    turned = [
        rows.of_kinds(nothing, wave, -distance * off) for wave, off in zip(waves, headings, strict=True)
    ]
    position = [rows.of_kinds(c * p, nothing, -s * p) for p in powers]
    position += [rows.of_kinds(s * p, nothing, c * p) for p in powers]
    yaw = StructureFamily(
        kind="reference yaw",
        columns=np.stack(turned, axis=1),
        statement="a yaw error of the reference that depends on the place",
        is_of_reference=True,
    )
    statement = "a position error of the reference that depends on the place"
    return [
        yaw,
        replace(
            yaw,
            kind="reference place",
            columns=np.stack(position, axis=1),
            statement=statement,
        ),
    ]


def reference_jumps(rows: OdometryRows, residual: Floats) -> list[StructureFamily]:
    """Return families of a reference that jumps at 1, 2, 4, ... moments: those with the largest residual.

    A camera that takes over from another has a constant offset before and after. The loss on a slippery patch
    lasts as long as the patch.

    Parameters
    ----------
    residual : (3 n,) Residual of a model without patches.
    """
    size = np.zeros(rows.n)
    for part in by_kind(residual, rows.n)[:2]:
        size += (part / (robust_sigma(part[rows.valid]) + 1e-12)) ** 2
    largest = np.argsort(-np.where(rows.valid, size, 0.0))
    out = list[StructureFamily]()
    for k in (2**i for i in range(N_REFERENCE_JUMPS)):
        columns = np.zeros((3 * rows.n, 2 * k))
        columns[largest[:k], np.arange(k)] = columns[rows.n + largest[:k], k + np.arange(k)] = 1.0
        out.append(
            StructureFamily(
                kind="reference jumps",
                columns=columns,
                statement="jumps of the reference at single moments, or wheel counts that were lost then",
                is_of_reference=True,
                choice_price=float(gammaln(rows.n + 1) - gammaln(k + 1) - gammaln(rows.n - k + 1)),
            )
        )
    return out
