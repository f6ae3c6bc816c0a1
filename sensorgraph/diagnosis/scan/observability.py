"""What a run could not have shown, and which effects it cannot tell apart.

Asked of every effect of the scan channel: how much evidence would it be expected to bring on these poses, nuisances
refitted? Smooth effects: half the squared length of their columns after projection, in the normal equations of the
fit (the Fisher information with poses and nuisances eliminated). Rough ones: the rays that would lose or change their
reading. Whoever finds nothing should know what there was to find.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sensorgraph.diagnosis.scan.fit import Fitted
from sensorgraph.diagnosis.scan.gauss_newton import Solver, boxed
from sensorgraph.diagnosis.scan.model_selection import THRESHOLD, price
from sensorgraph.diagnosis.scan.nuisance import BOX
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.score_test import Hypothesis, hypotheses
from sensorgraph.diagnosis.scan.settings import NoiseBounds
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.effects.nuisance import Nuisance
from sensorgraph.effects.places import in_sector, named_walls, obstacles
from sensorgraph.types import Bools, Floats

TIMES = 3.0  # materialities: an effect of this size should show
ALIKE = 0.98  # correlation of projected columns above which effects are one and the same to a run
STRANGE = 5.0  # [nats] of a reading far from where it is expected
SECTORS = 6  # in which a sector's bias is looked for
SECTOR = np.radians(30.0)  # [rad] of them
LONG = 30.0  # [s] of a run, below which nothing drifts
TYPICAL: dict[str, dict[str, float]] = {  # sizes of effects that have no materiality
    "glass": {"alpha_ret": np.radians(20.0)},
    "mirror": {},
    "black_surface": {"r0": 1.0},
    "incidence_dropout": {"alpha_max": np.radians(75.0)},
    "max_range": {"share": 0.75},
    "min_range": {"r_min": 0.3},
    "quantisation": {"q": 0.01},
    "self_occlusion": {"r0": 0.25},
    "sonar_cone": {"gamma": np.radians(10.0)},
    "tilt": {"beta": np.radians(3.0)},
    "missing_obstacle": {},
}
NAMES = 4  # places named in a sentence
SPOT = 0.25  # [m] of the raster of free space
LOOKS = 60  # scans that the raster is looked at from
NEAR, STEEP = 0.3, np.radians(70.0)  # [m], [rad] what makes a ray telling for a pair of rough effects


@dataclass(frozen=True, kw_only=True)
class Alike:
    """Two effects that this run cannot tell apart."""

    a: str
    b: str
    correlation: float
    """Of what they do to the readings, nuisances refitted."""
    nats: float
    """Expected between them, if the first is there at three times its materiality."""
    why: str
    """One sentence, with what would tell them apart."""


def not_observable(
    data: ScanData, fitted: Fitted, *, threshold: float = THRESHOLD, from_scans: bool | None = None
) -> dict[str, str]:
    """Say, effect by effect, what this run could not have shown, and why.

    Parameters
    ----------
    threshold : [nats] of evidence that a name takes, beyond the price of its parameters
    from_scans : the poses were estimated from these very scans (SLAM); None: where they are the laser's own
    """
    view = _View(data, fitted, threshold)
    out = _hidden_by_poses(data, data.laser_frame if from_scans is None else from_scans)
    present = set(fitted.names())
    for found in (_smooth(view), _sectors(view), _rough(view)):
        for name, why in found.items():
            if name not in present and name not in out:
                out[name] = why
    return dict(sorted(out.items(), key=lambda item: list(EFFECTS).index(item[0])))


def alike(data: ScanData, fitted: Fitted, *, threshold: float = THRESHOLD) -> list[Alike]:
    """List the pairs of effects that this run would show, but cannot tell apart."""
    view = _View(data, fitted, threshold)
    return [*_alike_smooth(view), *_alike_rough(view)]


class _View:
    """What the questions share."""

    def __init__(self, data: ScanData, fitted: Fitted, threshold: float) -> None:
        self.data, self.fitted, self.threshold = data, fitted, threshold
        self.system, self.solver = fitted.solution.system, fitted.solver
        self.tau = self.solver.scaled(fitted.state)
        self.n = self.solver.n_g
        beams, expected = fitted.cast.beams, fitted.cast.expected
        self.reading = expected.reading
        with np.errstate(invalid="ignore"):
            self.seen = (expected.reading < data.sensor.range_max) & (expected.p_return > 0.5)
        self.seen &= ~np.isnan(data.ranges)
        self.wall = beams.wall
        self.incidence = np.where(self.seen, np.nan_to_num(beams.incidence), 0.0)
        self.range = np.where(self.seen, self.reading, 0.0)
        self.n_seen = int(self.seen.sum())
        self._projected: dict[frozenset[Nuisance], Floats] = {}

    def need(self, amendment: Amendment) -> float:
        """Return the nats that the name takes."""
        return self.threshold + price(amendment, self.data)

    @cached_property
    def hypotheses(self) -> list[Hypothesis]:
        """Smooth effects as directions among the nuisances."""
        return hypotheses(self.data, self.fitted)

    def locked(self, own: Sequence[Nuisance]) -> Bools:
        """Return which nuisances are held when these copies are, (n_g,)."""
        held = self.solver.locked.copy()
        held[list(own)] = True
        return held

    def projected(self, own: Sequence[Nuisance]) -> Floats:
        """Return the information (n_g, n_g) that is left when the nuisances took their share, copies `own` held."""
        key = frozenset(own)
        if key not in self._projected:
            free = ~self.locked(own)
            matrix = self.system.matrix
            k = len(matrix)
            rest = np.concatenate([free, np.ones(k - self.n, dtype=np.bool_)])
            inner = matrix[np.ix_(rest, rest)].copy()
            inner[np.diag_indices_from(inner)] += np.concatenate(
                [1 / self.tau[free] ** 2, np.full(k - self.n, 1e-9)]
            )
            across = matrix[rest][:, : self.n]
            self._projected[key] = matrix[: self.n, : self.n] - across.T @ np.linalg.solve(inner, across)
        return self._projected[key]

    def nats(self, shift: Floats, free: Floats | None = None, own: Sequence[Nuisance] = ()) -> float:
        """Return the evidence expected if the truth is off by `shift` (n_g,) and a model lacks it.

        Parameters
        ----------
        free : (n_g, k) directions that the other model may take instead, their copies `own` held
        """
        matrix = self.system.matrix
        k = len(matrix)
        x = np.concatenate([shift, np.zeros(k - self.n)])
        return _missing(matrix, matrix @ x, float(x @ matrix @ x), self.tau, self.locked(own), free)

    def lost(self, chance: Floats | float, some: Bools) -> float:
        """Return the evidence expected if rays `some` return by `chance` only (array or number), losses refitted."""
        p = np.clip(np.broadcast_to(chance, some.shape)[some], 1e-6, 1.0)
        loss = self.fitted.state.noise.loss
        most = max(NoiseBounds().loss[1], loss)
        taken = min(most, loss + float((1 - p).sum()) / max(self.n_seen, 1))
        q = np.clip(p * (1 - loss), 1e-9, 1 - 1e-9)
        gone = 1 - q
        gain = float((q * np.log(q / (1 - taken)) + gone * np.log(gone / taken)).sum())
        rest = self.n_seen - len(p)
        return gain + rest * float(
            loss * np.log(loss / taken) + (1 - loss) * np.log((1 - loss) / (1 - taken))
        )


def _missing(
    matrix: Floats, right: Floats, square: float, tau: Floats, held: Bools, free: Floats | None
) -> float:
    """Return half the square that is left after nuisances in their boxes, and directions `free`, took what they can."""
    n = len(tau)
    if free is not None:
        k = len(right)
        big = np.eye(k, k + free.shape[1])
        big[:n, k:] = free
        matrix, right = big.T @ matrix @ big, big.T @ right
    g, p = boxed(matrix, right, tau, BOX * tau, held)
    x = np.concatenate([g, p])
    taken = float(right @ x - 0.5 * x @ matrix @ x - 0.5 * np.sum((g / tau) ** 2))
    return max(0.5 * square - taken, 0.0)


def _hidden_by_poses(data: ScanData, from_scans: bool) -> dict[str, str]:
    out: dict[str, str] = {}
    if data.laser_frame:
        why = "the poses are the laser's own, so that the mount has no part in them"
        out |= {"mount_xy": why, "mount_yaw": why}
    if from_scans:
        why = "poses that were fitted to these very scans have taken it along"
        out |= {name: why for name in ("latency", "range_drift") if name not in out}
    return out


# smooth effects ------------------------------------------------------------------------------------------------------


def _sizes(amendment: Amendment) -> Floats:
    """Return shifts (m, k) by TIMES the materiality; of a plane, in four directions."""
    names = amendment.effect.steps
    sizes = np.array([TIMES * amendment.effect.sizes.get(name, 0.0) for name in names])
    if amendment.name in ("mount_xy", "moved_obstacle"):
        angle = np.arange(4) * np.pi / 4
        return np.asarray(np.stack([np.cos(angle), np.sin(angle)], axis=1) * sizes)
    return np.asarray(sizes[None])


def _smooth(view: _View) -> dict[str, str]:
    """Judge what lies in the span of the nuisances."""
    out: dict[str, str] = {}
    blind: dict[str, list[str]] = {}
    partly: dict[str, list[str]] = {}
    for hypothesis in view.hypotheses:
        amendment, directions = hypothesis.amendment, hypothesis.directions
        need = view.need(amendment)
        nats = [view.nats(directions @ size) for size in _sizes(amendment)]
        if min(nats) >= need:
            continue
        if amendment.place:
            group = blind if max(nats) < need else partly
            group.setdefault(amendment.name, []).append(amendment.place)
            continue
        reason = REASONS[amendment.name](view.data, view)
        if max(nats) >= need:
            angle = int(45 * int(np.argmin(nats)))
            reason = f"not along {angle} degrees (0 is ahead): {reason}"
        out[amendment.name] = f"{reason}; at {TIMES:g} times its materiality {_said(min(nats), need)}"
    if view.data.span < LONG:
        out["range_drift"] = f"the run lasts {view.data.span:.0f} s, too short for a drift"
    for name, places in blind.items():
        out[name] = f"{_list(places)}: hardly looked at, {TIMES:g} times its materiality would not show"
    for name, places in partly.items():
        said = f"{_list(places)}: a shift across the line of sight would not show"
        out[name] = f"{out[name]}; {said}" if name in out else said
    return out


def _said(nats: float, need: float) -> str:
    return f"it would bring {nats:.0f} nats, and a name takes {need:.0f}"


def _list(places: Sequence[str]) -> str:
    more = len(places) - NAMES
    return ", ".join(places[:NAMES]) + (f" and {more} more" if more > 0 else "")


def _speeds(data: ScanData) -> str:
    speed = float(np.percentile(np.hypot(*data.twists[:, :2].T), 95))
    turn = float(np.percentile(np.abs(data.twists[:, 2]), 95))
    return f"the robot drove at most {speed:.2f} m/s and turned at most {turn:.2f} rad/s"


def _count(data: ScanData, view: _View) -> str:
    return f"only {view.n_seen} returns"


def _spread(data: ScanData, view: _View) -> str:
    low, high = np.percentile(view.reading[view.seen], [5, 95]) if view.n_seen else (0.0, 0.0)
    return f"ranges only from {low:.1f} to {high:.1f} m"


def _slants(data: ScanData, view: _View) -> str:
    share = float((view.incidence[view.seen] > np.radians(20)).mean()) if view.n_seen else 0.0
    return f"{100 * share:.0f} % of the returns are from walls met at more than 20 degrees"


REASONS: dict[str, Callable[[ScanData, _View], str]] = {
    "range_bias": _count,
    "range_scale": _spread,
    "range_drift": lambda data, view: f"the run lasts {data.span:.0f} s",
    "mount_yaw": _slants,
    "mount_xy": _count,
    "latency": lambda data, view: _speeds(data),
    "scan_skew": lambda data, view: _speeds(data),
    "map_scale": _spread,
}


def _sectors(view: _View) -> dict[str, str]:
    """Judge a bias of sectors: their columns are not in the equations of the fit, so assemble once more."""
    data, old, n = view.data, view.solver, view.n
    bearings = data.sensor.bearings
    centres = bearings[0] + (np.arange(SECTORS) + 0.5) / SECTORS * (bearings[-1] - bearings[0])
    inside = np.array([in_sector(bearings, c - SECTOR / 2, c + SECTOR / 2) for c in centres])
    effects = np.where(old.jacobian.valid[:, None] & inside[None], 1.0, 0.0)
    walls = view.fitted.cast.scene.walls
    solver = Solver(data, old.expected, old.jacobian, walls, effects, old.corners, old.locked)
    matrix = solver.assemble(
        view.fitted.solution.responsibilities.weight, view.fitted.state.pose_scale
    ).matrix
    b = TIMES * EFFECTS["sector_bias"].sizes["b"]
    need = view.need(EFFECTS["sector_bias"](theta1=0.0, theta2=0.0, b=b))
    nuisances = matrix[:n, :n]
    nats = [
        _missing(nuisances, b * matrix[:n, k], float(b * b * matrix[k, k]), view.tau, old.locked, None)
        for k in range(n, n + SECTORS)
    ]
    blind = [f"{np.degrees(c):.0f}" for c, value in zip(centres, nats, strict=True) if value < need]
    if not blind:
        return {}
    return {
        "sector_bias": f"round bearing {_list(blind)} degrees there are too few returns, or too few headings"
    }


# rough effects -------------------------------------------------------------------------------------------------------


def _rough(view: _View) -> dict[str, str]:
    """Judge what loses or changes single readings, by counting them."""
    found = {
        "min_range": _min_range(view),
        "max_range": _max_range(view),
        "incidence_dropout": _incidence(view),
        "quantisation": _quantisation(view),
        "tilt": _tilt(view),
        "range_noise": _range_noise(view),
        "mixed_pixels": _mixed_pixels(view),
        "sonar_cone": _sonar(view),
        "self_occlusion": _self_occlusion(view),
        "random_outliers": _strays(view, "random_outliers"),
        "people": _strays(view, "people"),
        "glass": _glass(view),
        "mirror": _mirror(view),
        "black_surface": _black(view),
        "missing_obstacle": _missing_obstacle(view),
        "unmapped_obstacle": _unmapped(view),
    }
    return {name: why for name, why in found.items() if why}


def _min_range(view: _View) -> str:
    r_min = TYPICAL["min_range"]["r_min"]
    some = view.seen & (view.reading < r_min)
    if view.lost(0.0, some) >= view.need(EFFECTS["min_range"](r_min=r_min)):
        return ""
    nearest = float(view.reading[view.seen].min()) if view.n_seen else 0.0
    if nearest < r_min:
        return f"only {int(some.sum())} returns from nearer than {r_min:.1f} m"
    return f"no return from nearer than {nearest:.2f} m"


def _max_range(view: _View) -> str:
    far = TYPICAL["max_range"]["share"] * view.data.sensor.range_max
    some = view.seen & (view.reading > far)
    if view.lost(0.0, some) >= view.need(EFFECTS["max_range"](R=far)):
        return ""
    farthest = float(view.range.max())
    if farthest > far:
        return f"only {int(some.sum())} returns from farther than {far:.1f} m"
    return f"no return from farther than {farthest:.1f} m, of {view.data.sensor.range_max:.0f} m"


def _incidence(view: _View) -> str:
    alpha = TYPICAL["incidence_dropout"]["alpha_max"]
    some = view.incidence > alpha
    if view.lost(0.0, some) >= view.need(EFFECTS["incidence_dropout"](alpha_max=alpha)):
        return ""
    return f"only {int(some.sum())} rays met a wall at more than {np.degrees(alpha):.0f} degrees"


def _quantisation(view: _View) -> str:
    q, resolution = TYPICAL["quantisation"]["q"], view.data.sensor.resolution
    if resolution >= q:
        return f"the log itself has steps of {1000 * resolution:.0f} mm"
    need = view.need(EFFECTS["quantisation"](q=q))
    if view.n_seen * np.log(q / max(resolution, 1e-4)) >= need:
        return ""
    return f"only {view.n_seen} returns"


def _tilt(view: _View) -> str:
    beta, sensor = TYPICAL["tilt"]["beta"], view.data.sensor
    need = view.need(EFFECTS["tilt"](beta=beta, theta0=0.0))
    floor = sensor.height / np.sin(beta)
    middle = np.cos(sensor.bearings - sensor.bearings.mean())
    with np.errstate(divide="ignore"):
        meets = np.where(middle > 0, sensor.height / np.sin(np.maximum(beta * middle, 1e-12)), np.inf)
    some = view.seen & (view.reading > meets)
    if STRANGE * some.sum() >= need:
        return ""
    return (
        f"hardly a ray ahead is longer than the {floor:.1f} m at which a plane tilted by "
        f"{np.degrees(beta):.0f} degrees meets the floor"
    )


def _range_noise(view: _View) -> str:
    k, sigma = TIMES * EFFECTS["range_noise"].sizes["k"], view.data.sensor.sigma
    if sigma <= 0 or not view.n_seen:
        return ""
    ratio = 1 + (k * view.reading[view.seen] / sigma) ** 2
    scale = np.linspace(*NoiseBounds().core, 9)[:, None] ** 2
    counts, edges = np.histogram(ratio, bins=40)
    middle = (edges[1:] + edges[:-1]) / 2 / scale  # (9, 40)
    nats = float((0.5 * (middle - 1 - np.log(middle)) * counts).sum(axis=1).min())
    need = view.need(EFFECTS["range_noise"](k=k))
    longest = float(np.percentile(view.reading[view.seen], 95))
    return "" if nats >= need else f"hardly a range above {longest:.1f} m; {_said(nats, need)}"


def _mixed_pixels(view: _View) -> str:
    gamma = TIMES * EFFECTS["mixed_pixels"].sizes["gamma"]
    bearings = view.data.sensor.bearings
    gap = float(np.median(np.abs(np.diff(bearings)))) if len(bearings) > 1 else np.inf
    step = np.abs(np.diff(view.range, axis=1)) > 0.1
    edges = step & view.seen[:, 1:] & view.seen[:, :-1]
    n = float(edges.sum()) * min(1.0, 2 * gamma / gap)
    if STRANGE * n >= view.need(EFFECTS["mixed_pixels"](gamma=gamma)):
        return ""
    return f"only {int(edges.sum())} times did two neighbouring rays straddle an edge in depth"


def _sonar(view: _View) -> str:
    gamma = TYPICAL["sonar_cone"]["gamma"]
    bearings = view.data.sensor.bearings
    side = int(gamma / np.median(np.abs(np.diff(bearings)))) if len(bearings) > 1 else 0
    shorter = np.zeros(view.range.shape, dtype=np.bool_)
    if side:
        limit = view.range - 4 * max(view.data.sensor.sigma, 1e-3)
        shorter[:, side:] |= view.seen[:, :-side] & (view.range[:, :-side] < limit[:, side:])
        shorter[:, :-side] |= view.seen[:, side:] & (view.range[:, side:] < limit[:, :-side])
    if STRANGE * shorter.sum() >= view.need(EFFECTS["sonar_cone"](gamma=gamma, alpha_max=1.0)):
        return ""
    return "neighbouring rays read alike, as if the cone were one of them"


def _self_occlusion(view: _View) -> str:
    r0, sensor = TYPICAL["self_occlusion"]["r0"], view.data.sensor
    need = view.need(EFFECTS["self_occlusion"](r0=r0, theta1=0.0, theta2=0.0))
    few = STRANGE * (view.seen & (view.reading > r0 + 0.05)).sum(axis=0) < need
    if not few.any():
        return ""
    return f"{int(few.sum())} of {sensor.n_rays} rays hardly ever returned from beyond {r0:.2f} m"


def _strays(view: _View, name: str) -> str:
    p = TIMES * EFFECTS[name].sizes["p"]
    usual = max(NoiseBounds().stray[1], view.fitted.state.noise.stray)
    nats = view.n_seen * (p * np.log(p / usual) + (1 - p) * np.log((1 - p) / (1 - usual))) if p > usual else 0
    need = view.need(EFFECTS[name](p=p))
    return "" if nats >= need else f"only {view.n_seen} returns; {_said(nats, need)}"


def _per_wall(view: _View, nats: Floats, need: float, why: str) -> str:
    """Name the walls on which too few rays would tell; `nats` (n_scans, n_rays) of each ray."""
    names = view.data.arena.names
    on = view.wall >= 0
    total = np.bincount(view.wall[on], nats[on], len(names))[: len(names)]
    blind = [name for name, value in zip(names, total, strict=True) if value < need]
    return f"{_list(blind)}: {why}" if blind else ""


def _place(name: str, view: _View, **values: float) -> float:
    return view.need(EFFECTS[name](a=0.0, b=1.0, **values))


def _glass(view: _View) -> str:
    alpha = TYPICAL["glass"]["alpha_ret"]
    slanting = np.asarray(STRANGE * (view.seen & (view.incidence > alpha)))
    why = f"hardly met at more than {np.degrees(alpha):.0f} degrees"
    return _per_wall(view, slanting, _place("glass", view, alpha_ret=alpha, depth=1.0), why)


def _mirror(view: _View) -> str:
    return _per_wall(view, np.asarray(STRANGE * view.seen), _place("mirror", view), "hardly met by a ray")


def _black(view: _View) -> str:
    r0 = TYPICAL["black_surface"]["r0"]
    with np.errstate(divide="ignore"):
        p = np.clip(np.cos(view.incidence) * (r0 / np.maximum(view.range, 1e-3)) ** 2, 1e-3, 1 - 1e-3)
    loss = max(NoiseBounds().loss[1], view.fitted.state.noise.loss)
    nats = view.seen * (p * np.log(p / (1 - loss)) + (1 - p) * np.log((1 - p) / loss))
    why = f"hardly met from farther than {r0:.0f} m, or at a slant"
    return _per_wall(view, nats, _place("black_surface", view, r0=r0), why)


def _missing_obstacle(view: _View) -> str:
    need = view.need(EFFECTS["missing_obstacle"]())
    blind = []
    for name in obstacles(view.data.arena):
        walls = named_walls(view.data.arena, name)
        if STRANGE * (np.isin(view.wall, walls) & view.seen).sum() < need:
            blind.append(name)
    return f"{_list(blind)}: hardly met by a ray" if blind else ""


def _unmapped(view: _View) -> str:
    """Name the part of free space that was hardly looked at."""
    data, beams = view.data, view.fitted.cast.beams
    x0, y0, x1, y1 = data.arena.bounds
    step = max(SPOT, float(np.sqrt((x1 - x0) * (y1 - y0) / 1500)))
    x, y = np.meshgrid(np.arange(x0 + step / 2, x1, step), np.arange(y0 + step / 2, y1, step))
    spots = np.stack([x.ravel(), y.ravel()], axis=1)
    spots = spots[data.arena.contains(spots)]
    if not len(spots):
        return ""
    some = np.unique(np.linspace(0, data.n_scans - 1, LOOKS).astype(np.intp))
    ox, oy = (np.broadcast_to(o, beams.ux.shape)[some, 0] for o in (beams.ox, beams.oy))
    dx, dy = spots[:, 0] - ox[:, None], spots[:, 1] - oy[:, None]  # (looks, spots)
    bearings = data.sensor.bearings
    first = np.arctan2(beams.uy[some, 0], beams.ux[some, 0])[:, None]
    turn = (np.arctan2(dy, dx) - first) % (2 * np.pi)
    width = float(np.median(np.diff(bearings))) if len(bearings) > 1 else 1.0
    ray = np.round(turn / width).astype(np.intp) if width > 0 else np.full(turn.shape, len(bearings))
    inside = ray < len(bearings)
    far = np.take_along_axis(view.reading[some], np.where(inside, ray, 0), axis=1)
    looks = (inside & (np.hypot(dx, dy) < far)).sum(axis=0)
    blind = looks < 2
    if blind.mean() < 0.03:
        return ""
    middle = spots[blind][np.hypot(*(spots[blind] - spots[blind].mean(axis=0)).T).argmin()]
    return (
        f"{100 * blind.mean():.0f} % of the free space was hardly looked at, for instance round "
        f"({middle[0]:.1f}, {middle[1]:.1f}) m"
    )


# pairs ---------------------------------------------------------------------------------------------------------------


def _alike_smooth(view: _View) -> list[Alike]:
    """Compare what smooth effects do to the readings, once nuisances have taken their share."""
    rows = []
    for hypothesis in view.hypotheses:
        amendment, directions, own = hypothesis.amendment, hypothesis.directions, hypothesis.nuisances
        shifts = [directions @ size for size in _sizes(amendment)]
        nats = [view.nats(shift) for shift in shifts]
        best = int(np.argmax(nats))
        rows.append((amendment, directions, own, shifts[best], nats[best] >= view.need(amendment)))
    out = []
    for i, (a, da, own_a, xa, shown_a) in enumerate(rows):
        for b, db, own_b, xb, shown_b in rows[i + 1 :]:
            if (a.place and (b.place or not shown_a)) or (b.place and not shown_b):
                continue
            own = (*own_a, *own_b)
            one = _compare(view, xa, db, own, shown_a)
            other = _compare(view, xb, da, own, shown_b)
            found = [f for f in (one, other) if f is not None]
            if found:
                out.append(_said_alike(a, b, max(f[0] for f in found), min(f[1] for f in found)))
    return sorted(out, key=lambda pair: pair.nats)


def _compare(
    view: _View, shift: Floats, others: Floats, own: Sequence[Nuisance], shown: bool
) -> tuple[float, float] | None:
    """Return correlation and expected nats if an effect (its shift, whether it shows at all) could be another."""
    correlation, strength = _correlation(view, shift, others, own)
    if strength < 1.0 or (correlation < ALIKE and not shown):
        return None
    if correlation < ALIKE and strength * (1 - correlation**2) > view.threshold:
        return None  # boxes on the nuisances can only leave more
    nats = view.nats(shift, others, own)
    return (correlation, nats) if correlation >= ALIKE or nats < view.threshold else None


def _correlation(view: _View, x: Floats, others: Floats, own: Sequence[Nuisance]) -> tuple[float, float]:
    """Return how one column correlates with the span of others, nuisances projected out, and its own nats."""
    columns = np.column_stack([x, others])
    f = columns.T @ view.projected(own) @ columns
    explained = f[0, 1:] @ np.linalg.lstsq(f[1:, 1:], f[1:, 0], rcond=1e-9)[0]
    share = float(np.clip(explained / max(f[0, 0], 1e-300), 0.0, 1.0))
    return float(np.sqrt(share)), float(0.5 * f[0, 0])


def _said_alike(a: Amendment, b: Amendment, correlation: float, nats: float) -> Alike:
    name_a, name_b = (f"{e.effect.title} at {e.place}" if e.place else e.effect.title for e in (a, b))
    why = f"this run can hardly tell {name_a} from {name_b} ({nats:.0f} nats between them)"
    raw_a, raw_b = (f"{e.name} of {e.place}" if e.place else e.name for e in (a, b))
    return Alike(a=raw_a, b=raw_b, correlation=correlation, nats=nats, why=f"{why}; {separation(a, b)}")


def separation(a: Amendment, b: Amendment) -> str:
    """Say what would tell two effects apart."""
    hint = a.effect.rivals.get(b.name) or b.effect.rivals.get(a.name)
    return hint or f"{a.effect.title} varies with {a.effect.varies}, {b.effect.title} with {b.effect.varies}"


def _alike_rough(view: _View) -> list[Alike]:
    """Find losses that could as well belong to one wall or one bearing."""
    far = TYPICAL["max_range"]["share"] * view.data.sensor.range_max
    out = []
    for name, some in (
        ("max_range", view.seen & (view.reading > far)),
        ("incidence_dropout", view.incidence > STEEP),
    ):
        walls = np.bincount(view.wall[some & (view.wall >= 0)])
        n = int(walls.sum())
        if n >= 4 and walls.max() > ALIKE * n:
            wall = view.data.arena.names[int(walls.argmax())]
            out.append(_pair(name, "black_surface", f"all such rays met {wall}"))
    near = view.seen & (view.reading < NEAR)
    rays = np.flatnonzero(near.any(axis=0))
    if near.sum() >= 4 and np.ptp(view.data.sensor.bearings[rays]) < np.radians(20):
        out.append(_pair("min_range", "self_occlusion", "all near returns came from one bearing"))
    return out


def _pair(a: str, b: str, why: str) -> Alike:
    hint = EFFECTS[a].rivals[b]
    told = f"this run cannot tell {EFFECTS[a].title} from {EFFECTS[b].title}"
    return Alike(a=a, b=b, correlation=1.0, nats=0.0, why=f"{told}: {why}; {hint}")
