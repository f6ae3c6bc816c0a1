"""Commissioning: what a run that is known to be good shows is the baseline of every later run at that site.

A map made of scans, poses made of the same scans and a room full of chairs leave residuals that no robot.yaml
describes. A run from the day when all was well has them too: how noisy readings are, how many are lost or stray, how
far its poses jitter, how much evidence each effect of the library picks up from clutter alone, and how large it seems
(see `usual`). All that is frozen here, so that a later run is asked only for the difference between the two.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.special import stdtrit

from logs.run import Run
from planners.arena import Arena
from sensorgraph.diagnosis.scan.fit import Fitted, fit, solver_for, start_state
from sensorgraph.diagnosis.scan.gauss_newton import Solver, State
from sensorgraph.diagnosis.scan.goodness_of_fit import GoodnessOfFit, check
from sensorgraph.diagnosis.scan.likelihood import e_step
from sensorgraph.diagnosis.scan.model_selection import THRESHOLD, is_rough, price, searched, shortlist
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.scan_data import LEAST_SCANS, ScanData, prepare_scans
from sensorgraph.diagnosis.scan.settings import NoiseBounds
from sensorgraph.diagnosis.scan.site_variation import (
    FEW,
    SURE,
    BaselineInterval,
    WindowEstimate,
    alone,
    usual_sizes,
)
from sensorgraph.effects import EFFECTS, Amendment, quantisation
from sensorgraph.types import Bools, Floats
from sensorgraph.world.robot import Robot, Tolerances

logger = logging.getLogger(__name__)

TIMES = 3.0  # what a name takes, over the most that clutter alone has brought
LOCAL_TIMES = 2.0  # the same for effects at one place, of which a good run shows the worst of many
SEVERAL = 1.4  # the same where several good runs show how far clutter goes, at least
MOST_TIMES = 3.0  # and at most
STEADY = 0.43  # share of a stamp's tolerance that is the same all through a run (see `nuisance.widths`)
SHORT = 0.3  # [m] a map of shorter walls has no panes
WIDE = NoiseBounds(
    core=(0.3, 4.0), tail=(0.005, 0.6), loss=(1e-4, 0.3), stray=(1e-4, 0.5), min_pose_scale=1.0, max_scale=1.0
)
SLACK = 1.15  # by which noise levels may rise above those of the good run
CALMER = 2.0  # by which they may be lower: less noise is no effect
MISFIT = 3.0  # over that of the good run, before anything is said to be unknown
CLEAR = 1.5  # times a doubt's threshold: the clutter of two days is never quite the same
STRIKE_SHARE = 0.02  # of what is left beyond that: among clutter, names fall later
SECTOR = np.radians(20.0)  # of rays that share what is in their way
FACTORS = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.5)  # of the tolerances of the poses
WINDOWS = (1, 2, 4)  # the run is looked at as a whole, in halves and in quarters
BASELINE: dict[str, dict[str, float]] = {  # what a site or a map may always show, with first values
    "range_noise": {"k": 0.004},
    "range_bias": {"b": 0.0},
    "range_scale": {"s": 0.0},
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Commissioned:
    """What a run known to be good says of its site, its poses and its sensor."""

    robot: Robot
    """With the tolerances of the poses, and the resolution of the sensor, that the run showed."""
    known: tuple[Amendment, ...]
    """What the run itself shows: part of the simulator from now on."""
    noise_bounds: NoiseBounds
    """Noise, frozen near what the run showed."""
    unseen: Mapping[str, float]
    """Effect -> inf, where a map like this one cannot show it."""
    runs: tuple[tuple[tuple[WindowEstimate, ...], ...], ...]
    """Of each run, as a whole and cut finer: what its windows showed though nothing was wrong."""

    @property
    def n_runs(self) -> int:
        """From so many runs, or stretches of them."""
        return len(self.runs)

    def said(self, name: str) -> dict[str, Any]:
        """Return what was learnt, as plain data for the report; floors are those of a run as long as the first."""
        first = self.runs[0][0][0]
        seen = self.alike(first.n_scans)
        usual = usual_sizes(seen, first.n_scans)
        floors = self.floors(seen, usual, first.n_scans, first.n_readings)
        return {
            "run": name,
            "runs": self.n_runs,
            "tolerances": asdict(self.robot.tolerances),
            "resolution": self.robot.sensor.resolution,
            "noise": _noise_dict(self.noise_bounds),
            "known": {a.name: dict(a.parameters) for a in self.known},
            "clutter_floor_nats": {n: round(g, 1) for n, g in floors.items()},
            "usual_sizes": {n: u.said(n) for n, u in usual.items()},
            "not_looked_for": list(self.unseen),
        }

    def alike(self, n_scans: int) -> list[WindowEstimate]:
        """Return windows of the good runs that are nearly as long; shorter ones too, where these are few."""
        levels = []
        for cuts in self.runs:
            apart = [abs(np.log(level[0].n_scans / n_scans)) for level in cuts]
            levels.append(cuts[int(np.argmin(apart)) :])
        seen: list[WindowEstimate] = []
        for depth in range(max(len(level) for level in levels)):
            seen += [s for finer in levels for level in finer[depth : depth + 1] for s in level]
            if len(seen) >= FEW:
                break
        return seen

    def floors(
        self,
        seen: Sequence[WindowEstimate],
        usual: Mapping[str, BaselineInterval],
        n_scans: int,
        n_readings: int,
    ) -> dict[str, float]:
        """Return, per effect, what it may gain though nothing is wrong [nats], in a run of this length.

        Not of smooth effects of the whole sensor whose usual size is known: that is the finer sieve.
        """
        gained: dict[str, list[float]] = {}
        for s in seen:
            size = float(np.sqrt(n_readings / s.n_readings))
            for name, gain in s.gains.items():
                if not (name in usual and EFFECTS[name].nuisances):
                    gained.setdefault(name, []).append(gain if is_local(name) else gain * size)
        return {name: max(values) * self._times(name, np.array(values)) for name, values in gained.items()}

    def _times(self, name: str, gained: Floats) -> float:
        """Return what a name takes, over the most that clutter alone has brought: more, where windows differ much.

        Parameters
        ----------
        gained : [nats] in each of the windows where clutter brought anything
        """
        if self.n_runs == 1:
            return LOCAL_TIMES if is_local(name) else TIMES
        if EFFECTS[name].place != "sector":  # a run has many walls and spots, and its gain is of the worst
            return SEVERAL
        if len(gained) < FEW or gained.min() <= 0:
            return TIMES
        logs = np.log(gained)  # of a further window: a prediction interval
        far = stdtrit(len(logs) - 1, SURE) * logs.std(ddof=1) * np.sqrt(1 + 1 / len(logs))
        return float(np.clip(np.exp(logs.mean() + far) / gained.max(), SEVERAL, MOST_TIMES))

    def told(self, data: ScanData) -> ScanData:
        """Return evidence of a later run that is judged against this one.

        Its poses may be the laser's own: a mount that has moved since shows as a difference.
        """
        seen = self.alike(data.n_scans)
        usual = usual_sizes(seen, data.n_scans)
        extra: dict[str, float] = dict(self.unseen)
        for name, gain in self.floors(seen, usual, data.n_scans, data.ranges.size).items():
            extra[name] = max(gain - THRESHOLD, 0.0)
        return replace(data, laser_frame=False, floors=extra, usual=usual, memo={})

    def calmed(self, verdict: GoodnessOfFit, data: ScanData) -> GoodnessOfFit:
        """Take back a doubt that is no larger than the good run's own, and weigh only what is beyond that."""
        seen = [s for cuts in self.runs for level in cuts[:2] for s in level]
        own = max(s.misfit / s.n_readings for s in seen) * data.ranges.size
        beyond = verdict.misfit - MISFIT * own
        clear = verdict.threshold <= 0 or verdict.statistic > CLEAR * verdict.threshold
        if beyond > 0 and clear:
            return replace(verdict, misfit=STRIKE_SHARE * beyond)
        return replace(verdict, statement="", deviation=None, misfit=0.0, failed=frozenset())


def _noise_dict(bounds: NoiseBounds) -> dict[str, Any]:
    """Return bounds of the noise under the keys of report.json."""
    return {
        "core": bounds.core,
        "tail": bounds.tail,
        "loss": bounds.loss,
        "stray": bounds.stray,
        "pose": bounds.min_pose_scale,
        "most": bounds.max_scale,
    }


def commission(run: Run, arena: Arena, robot: Robot, *, seed: int = 0, learn: bool = True) -> Commissioned:
    """Learn the baseline of a site from a run that is known to be good.

    Parameters
    ----------
    learn : take what the run itself shows into the simulator, and look at its halves for the tolerances; not where
    runs are merged
    """
    rng = np.random.default_rng(seed)
    data, _ = prepare_scans(run, arena, robot)
    data = replace(data, laser_frame=False)
    null = fit(data, (), start_state(data, WIDE), WIDE, outer=1, inner=12)
    sensor = robot.sensor
    for found in quantisation.propose(FitResiduals(data, null)):
        sensor = replace(sensor, resolution=found.values["q"])
    tolerances = pose_tolerances(data, null)
    robot = replace(robot, sensor=sensor, tolerances=tolerances)
    data = replace(
        data,
        sensor=replace(data.sensor, resolution=sensor.resolution),
        tolerances=tolerances,
        memo={},
    )
    known = baseline(data) if learn else ()
    data = replace(data, known=(*data.known, *known), memo={})
    cuts = WINDOWS[:2] if learn else WINDOWS[:1]
    robot = replace(robot, tolerances=shift_tolerances(data, cuts))
    data = replace(data, tolerances=robot.tolerances, floors=unseen(arena), memo={})
    parts = [part for n in cuts for part in windows(data, n)]
    noise_bounds = frozen([fit(p, (), start_state(p, WIDE), WIDE, outer=1, inner=12) for p in parts])
    seen = [tuple(sighting(part, noise_bounds, rng) for part in windows(data, n)) for n in WINDOWS]
    logger.debug("known %s; sightings %s", known, seen)
    return Commissioned(
        robot=robot,
        known=known,
        noise_bounds=noise_bounds,
        unseen=data.floors,
        runs=(tuple(level for level in seen if level),),
    )


def commission_all(runs: Sequence[Run], arena: Arena, robot: Robot, *, seed: int = 0) -> Commissioned:
    """Learn the baseline of a site from one run that is known to be good, or from several."""
    if len(runs) == 1:
        return commission(runs[0], arena, robot, seed=seed)
    return merged([commission(run, arena, robot, seed=seed, learn=False) for run in runs])


def sighting(data: ScanData, noise_bounds: NoiseBounds, rng: np.random.Generator) -> WindowEstimate:
    """Look at one window of a good run as if it were a run under test."""
    null = fit(data, (), start_state(data, noise_bounds), noise_bounds, outer=1, inner=7)
    gained, sizes = gains(data, null, noise_bounds)
    smooth, wobbles = alone(null)
    return WindowEstimate(
        n_scans=data.n_scans,
        n_readings=int(data.ranges.size),
        gains=gained,
        sizes={**sizes, **smooth},
        wobbles=wobbles,
        misfit=check(data, null, 0.0, {}, rng=rng).misfit,
    )


def unseen(arena: Arena) -> dict[str, float]:
    """Return infinite floors of effects of whole walls and of true edges, where the map is made of scraps."""
    size = np.hypot(*(arena.walls[:, 1] - arena.walls[:, 0]).T)
    if len(size) == 0 or np.median(size) > SHORT:
        return {}
    optics = ("mixed_pixels", "sonar_cone")
    whole = [name for name, effect in EFFECTS.items() if effect.place in ("wall", "obstacle")]
    return dict.fromkeys((*whole, *optics), float("inf"))


def is_local(name: str) -> bool:
    """Tell whether an effect sits at one place of the site: a longer run shows it no more than a shorter one."""
    return EFFECTS[name].place in ("wall", "obstacle", "spot")


def windows(data: ScanData, n: int) -> list[ScanData]:
    """Cut the run into n stretches of the same count of scans, unless they get too short."""
    cuts = np.linspace(0, data.n_scans, n + 1).astype(np.intp)
    if data.n_scans < n * LEAST_SCANS:
        return []
    parts = []
    for low, high in pairwise(cuts):
        part = data.part(np.arange(low, high))
        span = float(part.stamps[-1] - part.stamps[0])
        parts.append(replace(part, begin=float(part.stamps[0]), span=max(span, 1e-9)))
    return parts


def shift_tolerances(data: ScanData, cuts: Sequence[int]) -> Tolerances:
    """Return the tolerances, those of mount and stamps as wide as these seem to shift though nothing has moved.

    The clock is fitted by itself: while a robot turns one way only, a late clock looks like a yaw.
    """
    mount = [EFFECTS["mount_xy"](dx=0.0, dy=0.0), EFFECTS["mount_yaw"](delta=0.0)]
    clock = [EFFECTS["latency"](tau=0.0)]
    t, rows = data.tolerances, []
    for part in (part for n in cuts for part in windows(data, n)):
        xy, yaw = fit(part, mount, start_state(part, WIDE), WIDE, outer=3, inner=5).model
        (late,) = fit(part, clock, start_state(part, WIDE), WIDE, outer=3, inner=5).model
        rows.append([xy["dx"] ** 2 / 2 + xy["dy"] ** 2 / 2, yaw["delta"] ** 2, late["tau"] ** 2])
    shift, turn, stamp = np.sqrt(np.mean(rows, axis=0))
    return replace(
        t,
        mount_xy=max(t.mount_xy, float(shift)),
        mount_yaw=max(t.mount_yaw, float(turn)),
        stamp=max(t.stamp, float(stamp) / STEADY),
    )


def merged(several: Sequence[Commissioned]) -> Commissioned:
    """Put together what several good runs of a site show (none of them with `learn`)."""
    first = several[0]
    tolerances = [c.robot.tolerances for c in several]
    shifts = {k: np.array([getattr(t, k) for t in tolerances]) for k in ("mount_xy", "mount_yaw", "stamp")}
    widest = {k: float(np.sqrt(np.mean(v**2))) for k, v in shifts.items()}
    usual = {k: float(np.median([getattr(t, k) for t in tolerances])) for k in ("pose_xy", "pose_yaw")}
    freedoms = [c.noise_bounds for c in several]
    noise_bounds = replace(
        freedoms[0],
        core=_union([f.core for f in freedoms]),
        tail=_union([f.tail for f in freedoms]),
        loss=_union([f.loss for f in freedoms]),
        stray=_union([f.stray for f in freedoms]),
    )
    return Commissioned(
        robot=replace(first.robot, tolerances=replace(tolerances[0], **widest, **usual)),
        known=(),
        noise_bounds=noise_bounds,
        unseen=dict(item for c in several for item in c.unseen.items()),
        runs=tuple(cuts for c in several for cuts in c.runs),
    )


def _union(spans: Sequence[tuple[float, float]]) -> tuple[float, float]:
    return min(low for low, _ in spans), max(high for _, high in spans)


def baseline(data: ScanData) -> tuple[Amendment, ...]:
    """Fit what the run itself shows, one effect after another, as long as each is worth its price."""
    current = fit(data, (), start_state(data, WIDE), WIDE, outer=1, inner=12)
    left = dict(BASELINE)
    while left:
        tried = []
        for name, values in left.items():
            model = (*current.model, EFFECTS[name](**values))
            got = fit(data, model, current.state, WIDE, outer=3, inner=4)
            if is_rough(model[-1]):
                got = searched(data, got, WIDE, rounds=6, first=1.0, turns=2)
            tried.append((got.j - current.j - price(got.model[-1], data), got))
        gain, best = max(tried, key=lambda pair: pair[0])
        if gain < THRESHOLD:
            break
        current = best
        left.pop(best.model[-1].name)
    return current.model


def frozen(fits: list[Fitted]) -> NoiseBounds:
    """Return the noise levels that the stretches of the good run span, a little widened."""
    noises = [f.state.noise for f in fits]

    def span(name: str, least: float) -> tuple[float, float]:
        values = [float(getattr(noise, name)) for noise in noises]
        return max(min(values) / CALMER, least), max(values) * SLACK

    return NoiseBounds(
        core=span("core", 0.1),
        tail=span("tail", 0.001),
        loss=span("loss", 1e-4),
        stray=span("stray", 1e-4),
        min_pose_scale=1.0,
        max_scale=1.0,
    )


def gains(
    data: ScanData, null: Fitted, noise_bounds: NoiseBounds
) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
    """Return, per effect, the most that it gains beyond its price [nats], and the sizes of those of the whole sensor."""
    out: dict[str, float] = {}
    sizes: dict[str, dict[str, float]] = {}
    for candidate in shortlist(data, null, set(), 0.0):
        got = fit(data, (candidate.amendment,), null.state, noise_bounds, outer=3, inner=3)
        if is_rough(got.model[-1]):
            got = searched(data, got, noise_bounds, rounds=3, first=1.0, turns=1)
        (effect,) = got.model
        gain = got.j - null.j - price(effect, data)
        if gain > out.get(effect.name, -np.inf) and effect.effect.place is None:
            sizes[effect.name] = {k: effect[k] for k in effect.effect.sizes}
        out[effect.name] = max(out.get(effect.name, 0.0), gain)
    return out, {name: values for name, values in sizes.items() if values}


def pose_tolerances(data: ScanData, null: Fitted) -> Tolerances:
    """Return the tolerances of the poses under which one half of the bearings predicts the other half best."""
    t = data.tolerances
    solver, _ = solver_for(data, ())
    side = np.floor((data.sensor.bearings - data.sensor.bearings[0]) / SECTOR).astype(np.intp) % 2 == 0
    factor = {"pose_xy": 1.0, "pose_yaw": 1.0}
    memory: dict[tuple[float, ...], float] = {}

    def score(trial: dict[str, float]) -> float:
        key = tuple(trial.values())
        if key not in memory:
            tolerances = replace(t, **{k: v * getattr(t, k) for k, v in trial.items()})
            solver.data = replace(data, tolerances=tolerances)
            memory[key] = sum(crossed(solver, null.state, some) for some in (side, ~side))
        return memory[key]

    for _ in range(2):
        for name in factor:
            factor[name] = max(FACTORS, key=lambda f: score({**factor, name: f}))
    return replace(t, **{k: v * getattr(t, k) for k, v in factor.items()})


def crossed(solver: Solver, state: State, rays: Bools) -> float:
    """Fit the pose of each scan to some rays; return the log-likelihood of the others [nats]."""
    data, expected, none = solver.data, solver.expected, np.zeros(0)
    state = state.copy()
    state.delta = np.zeros_like(state.delta)
    for _ in range(4):
        responsibilities = e_step(data, expected, solver.shift(state, none), state.noise)
        weight: Floats = np.where(rays, responsibilities.weight, 0.0)
        state.delta = solver.poses_at(solver.assemble(weight, 1.0), state.g)
    log_p = e_step(data, expected, solver.shift(state, none), state.noise).log_p
    return float(log_p[:, ~rays].sum())
