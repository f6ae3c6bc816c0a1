"""Nuisances: small errors of map, mount, clock and pose that a careful setup has, and the noise of a reading.

Every tolerance is a Gaussian parameter with bounds: g ~ N(0, tau²) and |g| <= `max_tolerances` tau. The bounds keep large
effects visible; with the prior alone, the data could absorb them. The unknowns g are one value for each `Nuisance`, then
x and y of each corner of the map.

To first order, map and pose errors only shift a reading. However, they also move outlines, and a ray may then meet another wall. Two
cases need a better place for the cast: a wall within a cell of an occupancy-grid map, and a reference whose error exceeds the noise of
a reading. In these cases, casts are made at the most likely walls and poses. The errors are still counted from the map and the
reference poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from planners.arena import Arena
from sensorgraph.diagnosis.scan.corner_sums import Corners
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.effects import EFFECTS, Amendment, Effect
from sensorgraph.effects.nuisance import MOUNT, POSE_LIKE, Nuisance
from sensorgraph.effects.places import obstacles
from sensorgraph.effects.range_bias import RANGE_BIAS
from sensorgraph.effects.range_drift import RANGE_DRIFT
from sensorgraph.effects.range_scale import RANGE_SCALE
from sensorgraph.types import Floats
from sensorgraph.world.cast_memory import Recent
from sensorgraph.world.robot import Tolerances

SETTINGS = SCAN.nuisance
HIDDEN_SIZES = RANGE_BIAS.sizes["b"], RANGE_SCALE.sizes["s"], RANGE_DRIFT.sizes["b1"]
"""[m, 1, m] Materiality of the effects of the laser that a careful setup may hide in part."""
UNIFORM = float(1 / np.sqrt(3))
"""Standard deviation of an error that is uniform within its tolerance: of a delay, or of a skew of the sweep."""
MAX_PRIORS = 4
"""Number of kept priors of the poses of some scans."""


def prior_widths(tolerances: Tolerances) -> Floats:
    """Return the prior standard deviation of each Nuisance, (8,) [m, m, rad, m, 1, m, s, s]."""
    bias, scale, drift = (SETTINGS.hidden_share * size for size in HIDDEN_SIZES)
    return np.array(
        [
            tolerances.mount_xy,
            tolerances.mount_xy,
            tolerances.mount_yaw,
            bias,
            scale,
            drift,
            UNIFORM * tolerances.stamp,
            UNIFORM * tolerances.stamp,
        ]
    )


def effects_with_nuisances() -> list[Effect]:
    """Return the effects whose parameters also exist as nuisances, in the order of the nuisances."""
    own = [effect for effect in EFFECTS.values() if effect.nuisances]
    return sorted(own, key=lambda effect: effect.nuisances[0])


def corners_of(data: ScanData) -> Corners:
    """Return the corners of the map that may shift; an empty set if there are too many."""
    corners = (
        data.kept(b"corners of obstacles", lambda: _of_arena(data.arena))
        if data.corners is None
        else data.corners
    )
    if corners.count > SETTINGS.max_corners:
        return Corners(ends=corners.ends * 0, count=0)
    return corners


def _of_arena(arena: Arena) -> Corners:
    """Return the corners of a drawn arena, with their obstacles."""
    index = {name: k for k, name in enumerate(obstacles(arena))}
    of_walls = [index.get(name.rsplit("/", 1)[0], len(index)) for name in arena.names]
    return Corners.of(arena.walls).of_obstacles(np.array(of_walls, dtype=np.intp), len(index))


@dataclass(eq=False)
class BeamNoise:
    """Noise of a reading, within the bounds of a careful setup."""

    core: float = 1.0
    """Scale of the nominal standard deviation."""
    tail: float = 0.03
    """Share of returns with the wide standard deviation."""
    loss: float = 1e-3
    """Probability that a ray which should return is missing."""
    stray: float = 1e-3
    """Share of outliers, which are uniform over the range."""

    def within(self, bounds: NoiseBounds) -> BeamNoise:
        """Return the noise, clipped to bounds."""
        return BeamNoise(**{k: float(np.clip(v, *getattr(bounds, k))) for k, v in vars(self).items()})


@dataclass(eq=False)
class State:
    """Values of the nuisances."""

    g: Floats
    """(8 + 2 n,) one value for each Nuisance, then x and y of the unknown of each corner and each obstacle."""
    delta: Floats
    """(n_scans, 3) [m, m, rad] pose errors."""
    noise: BeamNoise = field(default_factory=BeamNoise)
    pose_scale: float = 1.0
    """Factor by which the tolerances of the reference pose are too tight."""
    map_scale: float = 1.0
    """Factor by which the tolerance of the map is too tight."""
    laid: Floats | None = None
    """(2 n_corners,) [m] shifts of the corners of an occupancy-grid map in the cast of this state."""
    posed: Floats | None = None
    """(n_scans, 3) [m, m, rad] pose errors in that cast, where the tolerances of the reference pose are wide."""
    effects: Floats = field(default_factory=lambda: np.zeros(4))
    """(4,) [m, m, rad, s] mount and delay according to the effects in the model (`POSE_LIKE`)."""

    @property
    def corners(self) -> Floats:
        """(2 n,) [m] unknowns of the corners and obstacles (see `corner_sums`)."""
        return self.g[len(Nuisance) :]

    @property
    def stretch(self) -> float:
        """Larger of the factors by which the tolerances of reference pose and map are too tight."""
        return max(self.pose_scale, self.map_scale)

    def copy(self) -> State:
        """Return a copy that can be modified."""
        return replace(self, g=self.g.copy(), delta=self.delta.copy(), noise=replace(self.noise))


@dataclass(frozen=True, kw_only=True, eq=False)
class PosePrior:
    """Prior of the pose errors of all scans."""

    covariance: Floats
    """(n_scans, 3, 3)"""
    inverse: Floats
    """(n_scans, 3, 3)"""
    logdet: float
    """Sum over scans of log |P|."""


def pose_prior(data: ScanData, scale: float) -> PosePrior:
    """Return the prior of the pose errors; the latest ones of the data are kept, because a fit needs each several times.

        P = scale² (diag(pose_xy², pose_xy², pose_yaw²) + stamp² u uᵀ),    with u the velocity of the base.

    Parameters
    ----------
    scale : Factor of the tolerances.
    """
    t = data.tolerances
    xy, yaw = max(t.pose_xy, 1e-5), max(t.pose_yaw, 1e-6)

    def made() -> PosePrior:
        u = data.twists
        p = scale**2 * (np.diag([xy**2, xy**2, yaw**2]) + t.stamp**2 * u[:, :, None] * u[:, None, :])
        return PosePrior(
            covariance=p, inverse=np.asarray(np.linalg.inv(p)), logdet=float(np.linalg.slogdet(p)[1].sum())
        )

    kept: Recent[PosePrior] = data.kept(b"pose priors", lambda: Recent(MAX_PRIORS))
    return kept.get(np.array([scale, xy, yaw, t.stamp]).tobytes(), made)


# place of the casts ---------------------------------------------------------------------------------------------------


def as_cast(data: ScanData, state: State, *, same_scans: bool = True) -> ScanData:
    """Return data with the walls and poses of the cast of a state, or with its current ones if it has no cast.

    Parameters
    ----------
    same_scans : Whether the state belongs to these scans; otherwise their poses are kept.
    """
    laid = data.laid_by(state.corners if state.laid is None else state.laid)
    if data.posed is None or not same_scans:
        return laid
    return laid.posed_by(errors_of_laser(data, state) if state.posed is None else state.posed)


def is_cast_at(data: ScanData, state: State) -> bool:
    """Return whether data is cast at the walls and poses of a state, within a small fraction of the tolerances."""
    if not data.is_laid_by(state.corners):
        return False
    if data.posed is None:
        return True
    t = data.tolerances
    off = np.abs(errors_of_laser(data, state) - data.posed) / [t.pose_xy, t.pose_xy, t.pose_yaw]
    return bool(off.max() <= SCAN.fit.settled_step)


def for_model(data: ScanData, state: State, model: Sequence[Amendment]) -> State:
    """Return the start state for the fit of another model, with the laser of each scan at the same place.

    The pose errors compensate each change of mount and delay in the model, because the poses have absorbed such an effect before
    it is in the model. Otherwise it would count twice at the start, and most readings would look like outliers.
    """
    values = pose_like(model)
    if (values == state.effects).all():
        return state
    off = as_pose_errors(data, state.effects - values)
    posed = None if state.posed is None else state.posed + off
    return replace(state, effects=values, delta=state.delta + off, posed=posed)


def pose_like(model: Sequence[Amendment]) -> Floats:
    """Return mount and delay of the whole laser in a model, (4,) [m, m, rad, s], in the order of `nuisance.POSE_LIKE`."""
    out = np.zeros(len(POSE_LIKE))
    for amendment in (a for a in model if not a.place):
        for parameter in amendment.effect.parameters:
            if parameter.nuisance in POSE_LIKE:
                out[POSE_LIKE.index(parameter.nuisance)] += amendment[parameter.name]
    return out


def errors_of_laser(data: ScanData, state: State) -> Floats:
    """Return the pose errors (n_scans, 3) [m, m, rad] of the laser in a state, including its mount error."""
    return state.delta + as_pose_errors(data, np.append(state.g[list(MOUNT)], 0.0))


def as_pose_errors(data: ScanData, off: Floats) -> Floats:
    """Return the pose errors (n_scans, 3) [m, m, rad] that are equivalent to an error of mount and delay.

    Parameters
    ----------
    off : (4,) [m, m, rad, s] Error of mount and delay, in the order of `POSE_LIKE`.
    """
    x, y, yaw, late = off
    ahead, aside = data.sensor.mount[:2]
    x, y = x + yaw * aside, y - yaw * ahead  # the laser turns about itself, but a pose turns about the base
    c, s = np.cos(data.poses[:, 2]), np.sin(data.poses[:, 2])
    mounted = np.column_stack([c * x - s * y, s * x + c * y, np.full(data.n_scans, yaw)])
    return np.asarray(mounted - late * data.twists)
