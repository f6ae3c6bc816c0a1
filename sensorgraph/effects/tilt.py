"""Tilted scan plane."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Parameter
from sensorgraph.effects.exposures import UNEXPECTED
from sensorgraph.effects.interfaces import Exposure, Proposal, Residuals
from sensorgraph.effects.proposals import LOSS_LEFTOVERS, PROPOSAL
from sensorgraph.types import Floats
from sensorgraph.world.ray_order import is_full_turn
from sensorgraph.world.scene import Scene

FARTHER = 1.5
"""Minimum ratio of a reading of the floor to the height of the sensor."""
N_PAIRS = 120
"""Number of pairs of readings that define a plane."""
DIPS = (0.003, 0.5)
"""[rad] Limits of a tilt."""
MIN_SHARE = 0.2
"""Minimum share of the short readings on one plane."""
NATS = 8.0
"""[nats] Approximate gain of one reading of the floor."""


def transform(scene: Scene, a: Amendment) -> None:
    """Tilt the plane of the laser."""
    scene.dip = (a["beta"], a["theta0"])


def propose(residuals: Residuals) -> list[Proposal]:
    """Search for readings of the floor, where h / z = sin(beta) cos(theta - theta0), linear in cos and sin theta."""
    h = residuals.sensor.height
    some = residuals.short & (residuals.z > FARTHER * h)
    if h <= 0 or some.sum() < 2 * PROPOSAL.min_rays:
        return []
    bearings = np.broadcast_to(residuals.sensor.bearings, residuals.z.shape)[some]
    z = residuals.z[some]
    sine = h / z  # of the angle below the horizontal
    rows = np.column_stack([np.cos(bearings), np.sin(bearings)])
    width = np.maximum(3 * residuals.sigma[some] * h / z**2, 1e-4)  # of the sine, three sigma
    rng = np.random.default_rng(0)
    best: Floats = np.zeros(2)
    most = 0
    for _ in range(N_PAIRS):
        pair = rng.choice(len(z), 2, replace=False)
        system = rows[pair]
        if abs(np.linalg.det(system)) < 0.05:
            continue
        x = np.linalg.solve(system, sine[pair])
        count = int((np.abs(rows @ x - sine) < width).sum())
        if count > most:
            best, most = x, count
    for _ in range(3):
        inlier = np.abs(rows @ best - sine) < width
        if inlier.sum() < 2 * PROPOSAL.min_rays:
            return []
        w = 1 / width[inlier]
        best = np.asarray(
            np.linalg.lstsq(rows[inlier] * w[:, None], sine[inlier] * w, rcond=None)[0], dtype=np.float64
        )
    beta, theta0 = float(np.arcsin(min(np.hypot(*best), 1.0))), float(np.arctan2(best[1], best[0]))
    if not DIPS[0] < beta < DIPS[1] or most < MIN_SHARE * some.sum():
        return []
    return [Proposal(values={"beta": beta, "theta0": theta0}, gain=NATS * most)]


def unobservable(exposure: Exposure, typical: Mapping[str, float], need: float) -> str:
    """Count the rays that would hit the floor if the plane dips ahead."""
    beta, sensor = typical["beta"], exposure.sensor
    floor = sensor.height / np.sin(beta)
    ahead = 0.0 if is_full_turn(sensor.bearings) else sensor.bearings.mean()
    middle = np.cos(sensor.bearings - ahead)
    with np.errstate(divide="ignore"):
        meets = np.where(middle > 0, floor / np.maximum(middle, 1e-12), np.inf)
    some = exposure.seen & (exposure.reading > meets)
    if UNEXPECTED * some.sum() >= need:
        return ""
    return (
        f"few rays ahead exceed {floor:.1f} m, where a plane tilted by "
        f"{np.degrees(beta):.0f} degrees hits the floor"
    )


TILT = Effect(
    name="tilt",
    title="tilted scan plane",
    channel="scan",
    stage="mount",
    physics="The plane dips by beta towards theta_0. A ray at psi below the horizontal, sin psi = sin(beta) cos(theta - theta_0), hits the floor at h / sin psi. Other rays are longer by 1 / cos psi, and their bearings, seen from above, spread around theta_0.",
    equation="z = min(r(θ′) / cos ψ, h / sin ψ), sin ψ = sin β cos(θ − θ₀), tan(θ′ − θ₀) = tan(θ − θ₀) / cos β",
    source="geometry of a plane at height h; Kohlbrecher et al. (2011), Hector SLAM, section III",
    varies="bearing, for ranges beyond the floor",
    rivals={
        "max_range": "a tilted sensor returns from the floor",
        "unmapped_obstacle": "spin in place with a long open view, because a tilt moves with the robot",
    },
    parameters=(
        Parameter(
            name="beta",
            unit="rad",
            doc="dip angle",
            low=0.0,
            high=0.5,
            step=1e-5,
            search_step=0.003,
            jump=5e3,
            typical=float(np.radians(3.0)),
            hidden=lambda _: 1e-5,
        ),
        Parameter(
            name="theta0",
            unit="rad",
            doc="bearing of the deepest dip, laser frame",
            neutral=0.0,
            step=1e-5,
            search_step=0.05,
            jump=5e3,
            hidden=lambda _: 5e-4,
        ),
    ),
    transform=transform,
    diagnostics=Diagnostics(unobservable=unobservable, propose=propose, leftovers=LOSS_LEFTOVERS),
)
