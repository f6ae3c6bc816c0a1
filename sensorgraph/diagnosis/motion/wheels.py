"""Odometry against the reference pose: wheel effects, slippery patches, and the clock between the two.

Reference poses are averaged over a tenth of a second; what the body did from one average to the next, along its
heading and in yaw, is compared with what the wheels say. All effects but the clock and the place of a patch are
linear in that comparison. Rows are whitened (`channel`), so that scale factors are judged over long stretches
and patches and clocks over short ones, as the noise of camera and wheels asks for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from logs.run import Run
from sensorgraph.diagnosis.motion.odometry_rows import Rows, aligned, lay_out, signals_of, stack
from sensorgraph.diagnosis.motion.unmodelled_structure import (
    Family,
    Judge,
    LimitedNoise,
    families,
    kind_of,
    limits_of,
)
from sensorgraph.diagnosis.motion.whitened_regression import (
    PENALTY,
    TEMPER,
    THRESHOLD,
    Increments,
    Normal,
    Prior,
    Solution,
    autoregression,
    huber,
    probabilities,
    whiten,
)
from sensorgraph.diagnosis.result import ChannelResult, Deviation, FitQuality, Gap, Rival, Unknown
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.types import Bools, Floats
from sensorgraph.world.robot import Robot

ORDER = 24
"""Of the whitening filters."""
CLUSTER = 2.0
"""[s] within which errors may be correlated beyond the filter."""
GLOBAL = ("wheel_radius", "wheel_radius_diff", "wheel_base", "pose_clock_offset")
SCALES = (0.0015, 0.001, 0.002)
"""Tolerances of radius, difference and base: what a careful set-up holds."""
MARKER = 0.003
"""[m] between the axle and what the reference calls base_link."""
CLOCKS = (0.0015, 0.0035)
"""[s] least and largest tolerance of the clocks."""
RADII = (0.2, 0.3, 0.42, 0.56, 0.72, 0.92)
"""[m] of patches that are tried."""
PLACE_DOUBT = 2.0
"""Widens the spread of a patch's place: set on development cases, where the search alone was too sure of it."""
STAMPS = 8.0
"""Times less than the tolerance of one stamp that the mean of a run's stamps is off."""
FAINT = 1e-3
"""[nats] per row that structure must explain: less is 0.2 % of the noise's variance, and matters to nobody."""
FOREIGN = 20.0
"""[nats] that structure outside the library needs where what is left is noise; in proportion more where it is not."""
SHARE = 0.02
"""Of the evidence of all names: structure below it is where an effect's model is not exact."""
RIM = 0.1
"""The same of the evidence of a patch: none is a sharp round disc, and what its rim does looks like structure."""
FURTHER = 0.005
"""Of the evidence of all names that a further patch must bring: less mends the rim of the others."""


def diagnose_odometry(run: Run, robot: Robot, *, seed: int = 0) -> ChannelResult:
    """Name what makes odometry and reference pose differ."""
    signals = signals_of(run)
    if isinstance(signals, str):
        return ChannelResult(channel="odometry", skipped=signals)
    stamps, poses, wheels, notes = signals
    rows = aligned(stamps, poses, wheels)
    if isinstance(rows, str):
        return ChannelResult(channel="odometry", skipped=rows)
    search = _Search(rows=rows, wheels=wheels, robot=robot, rng=np.random.default_rng(seed))
    search.whiten_rows()
    late = search.late()
    if abs(late) > 3e-4:
        moved = lay_out(stamps, poses, wheels, rows.clock + late)
        if moved is not None:
            search = _Search(rows=moved, wheels=wheels, robot=robot, rng=np.random.default_rng(seed))
            search.whiten_rows()
    return search.result(notes)


def clock_offset(run: Run, robot: Robot) -> tuple[float, float] | None:
    """Return how much older the odometry is than its stamp, and its standard error [s]; None if unknown."""
    signals = signals_of(run)
    if isinstance(signals, str):
        return None
    stamps, poses, wheels, _ = signals
    rows = aligned(stamps, poses, wheels)
    if isinstance(rows, str):
        return None
    search = _Search(rows=rows, wheels=wheels, robot=robot, rng=np.random.default_rng(0))
    search.whiten_rows()
    prior = search.prior(GLOBAL)
    solution = search.normal.solve(prior)
    spread = search.normal.sandwich(solution, search.clusters)
    return search.rows.clock + float(solution.theta[3]), float(np.sqrt(spread[3, 3]))


@dataclass(frozen=True, kw_only=True, eq=False)
class Patch:
    """A slippery disc and what it does to the rows."""

    x: float
    y: float
    r: float
    spread: Floats
    """(4, 4) covariance of s, x, y, r from the search."""
    shift: float = 0.0

    def mask(self, spots: Floats) -> Floats:
        """Return the share of each increment inside the disc."""
        return _inside(spots, np.array([[self.x, self.y, self.r]]))[:, 0]


def _inside(spots: Floats, discs: Floats) -> Floats:
    """Return (n_increments, n_discs) soft membership, 1 inside; the edge is as wide as an increment is long."""
    far = np.hypot(spots[:, 0, None] - discs[None, :, 0], spots[:, 1, None] - discs[None, :, 1])
    return np.clip((discs[None, :, 2] - far) / 0.02 + 0.5, 0.0, 1.0)


def _grid_about(disc: Floats) -> Floats:
    """Return discs (n, 3) of every size whose centres lie within 0.9 m of a disc's, and the disc itself."""
    steps, radii = np.arange(-0.9, 0.91, 0.3), np.arange(0.15, 1.26, 0.15)
    dx, dy, r = (axis.ravel() for axis in np.meshgrid(steps, steps, radii, indexing="ij"))
    near = np.hypot(dx, dy) <= 0.91
    return np.concatenate([disc[None], np.column_stack([disc[0] + dx, disc[1] + dy, r])[near]])


class _Search:
    """One run's search for wheel effects: rows, noise, the model so far."""

    def __init__(self, *, rows: Rows, wheels: Increments, robot: Robot, rng: np.random.Generator) -> None:
        self.rows, self.wheels, self.robot, self.rng = rows, wheels, robot, rng
        self.base = robot.wheels.base
        self.A, self.y = stack(rows, wheels, self.base)
        self.ok = np.concatenate([rows.is_valid, rows.is_valid])
        block = ((rows.stamps - rows.stamps[0]) / CLUSTER).astype(np.intp)
        self.clusters = np.concatenate([block, block]).astype(np.float64)
        self.patches: list[Patch] = []
        self.families = families(rows, wheels)
        self.limits = limits_of(rows, wheels, robot)
        self.foreign: list[str] = []
        self.tests: dict[str, tuple[float, float]] = {}
        self.taps: list[Floats] = []
        self.sigmas: list[float] = []
        self.weights = np.ones(len(self.y))
        self.normal = Normal.of(self.A, self.y)

    # noise

    def whiten_rows(self) -> None:
        """Fit the noise to what the model leaves with all wheel effects free, twice, and whiten the rows with it.

        Structure outside the library takes no part in it unless accepted: so many smooth columns would swallow
        the slow part of the wheels' noise, and the rest would look too good."""
        self._fit_noise(self.columns())
        self._form()

    def _fit_noise(self, columns: Floats, turns: int = 2) -> float:
        """Fit columns and noise in turn; return the log-likelihood of the noise, without constants [nats]."""
        scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
        if not self.taps:
            self.taps = [np.eye(1, ORDER + 1)[0]] * 2
            self.sigmas = [float(np.std(part[ok]) + 1e-12) for part, ok in self._halves(self.y)]
        for _ in range(turns):
            Z, y = self._white(scaled), self._white(self.y)
            G = Z.T @ Z
            theta = np.linalg.solve(G + 1e-8 * np.trace(G) / len(G) * np.eye(len(G)), Z.T @ y)
            left = self.y - scaled @ theta
            spare = 1 / np.sqrt(1 - 0.5 * len(theta) / max(self.ok.sum(), 1))
            self.taps, self.sigmas = list(self.taps), list(self.sigmas)
            for i, (part, ok) in enumerate(self._halves(left)):
                limit = 4.0 * 1.4826 * np.median(np.abs(part[ok])) + 1e-12
                self.taps[i], self.sigmas[i] = autoregression(
                    [np.clip(part, -limit, limit) * spare], [ok], ORDER
                )
            self.weights = np.ones(len(self.y))
            self.weights = np.sqrt(huber(self._white(left)))
        return -float(self.rows.is_valid.sum()) * float(np.log(self.sigmas).sum())

    def _profile(self, columns: Floats) -> float:
        """Return the log-likelihood of columns with a noise of their own, leaving the model's noise alone [nats]."""
        kept = self.taps, self.sigmas, self.weights
        value = self._fit_noise(columns)
        self.taps, self.sigmas, self.weights = kept
        return value

    def _halves(self, values: Floats) -> list[tuple[Floats, Bools]]:
        n = self.rows.n
        return [(values[:n], self.rows.is_valid), (values[n:], self.rows.is_valid)]

    def _white(self, columns: Floats) -> Floats:
        n = self.rows.n
        out = np.concatenate(
            [
                whiten(columns[:n], self.taps[0], self.sigmas[0]),
                whiten(columns[n:], self.taps[1], self.sigmas[1]),
            ]
        )
        keep = np.where(self.ok, self.weights, 0.0)
        out *= keep if out.ndim == 1 else keep[:, None]
        return out

    def _form(self) -> None:
        self.normal = Normal.of(self._white(self.columns()), self._white(self.y))

    # columns

    def columns(self) -> Floats:
        """Return all columns (2 n, 5 + patches + foreign structure)."""
        parts = [self.A]
        if self.patches:
            masks = np.stack([patch.mask(self.rows.spots) for patch in self.patches], axis=1)
            parts.append(-self._gained(masks))
        parts += [self.families[name].columns for name in self.foreign]
        return np.concatenate(parts, axis=1)

    def _gained(self, masks: Floats) -> Floats:
        """Return what the wheels say (2 n, k) where masks (n_increments, k) weigh the increments."""
        along = self.rows.D_along @ (self.wheels.way[:, None] * masks)
        yaw = self.rows.D_yaw @ (self.wheels.turn[:, None] * masks)
        return np.asarray(np.where(self.ok[:, None], np.concatenate([along, yaw]), 0.0))

    def prior(self, names: Sequence[str]) -> Prior:
        """Return the prior of the columns with some effects free; patches are free or shut out."""
        clock = float(np.clip(0.6 * self.robot.tolerances.stamp, *CLOCKS))
        sigma = np.array([*SCALES, clock, MARKER, *[1e-9] * len(self.patches)])
        k = len(sigma)
        wide = [np.full(len(f.labels), f.sigma) for f in map(self.families.__getitem__, self.foreign)]
        sigma = np.concatenate([sigma, *wide])
        mean = np.zeros(len(sigma))
        mean[3] = -self.rows.clock
        free = [GLOBAL.index(name) for name in names if name in GLOBAL]
        free += [5 + i for i in range(len(self.patches)) if f"wheel_slip {i}" in names]
        prior = Prior.of(sigma, mean).freed(free)
        prior.box[k:] = np.inf
        return prior

    def late(self) -> float:
        """Return how far the assumed clock is still off, all effects free [s]."""
        return float(np.clip(self.normal.solve(self.prior(GLOBAL)).theta[3], -0.02, 0.02))

    def score(self, names: Sequence[str]) -> float:
        """Return the penalised log-likelihood of a set of effects [nats]."""
        return self.normal.solve(self.prior(names)).J

    def cost(self, name: str) -> float:
        """Return the penalty for an effect's parameters [nats]."""
        return PENALTY * (4 if name.startswith("wheel_slip") else 1)

    def evidence(self, names: Sequence[str], name: str) -> float:
        """Return how much the data prefer a set with an effect to the set without it [nats]."""
        rest = [other for other in names if other != name]
        return self.score([*rest, name]) - self.score(rest) - self.cost(name)

    # search

    def select(self) -> list[str]:
        """Add effects while the evidence lasts, then take superfluous ones back.

        Structure that no effect makes competes with them: where it explains more, it enters in their stead.
        """
        names: list[str] = []
        for _ in range(7):
            gains = {name: self.evidence(names, name) for name in GLOBAL if name not in names}
            patch, gain = self._best_patch(names) if len(self.patches) < 3 else (None, -np.inf)
            if (
                patch is not None
                and gain + self.cost("wheel_slip") > 4.0
                and gain < max(50.0, *gains.values(), 0.0)
            ):
                # an unmodelled patch is noise to the filter: judge it by a noise of its own
                column = -self._gained(patch.mask(self.rows.spots)[:, None])
                own = self.columns()
                fresh = self._profile(np.concatenate([own, column], axis=1)) - self._profile(own)
                gain = max(gain, fresh - self.cost("wheel_slip") - 8.0)
            top = max([gain, *gains.values()])
            if top < THRESHOLD:
                break
            if patch is not None and gain == top:
                self.patches.append(patch)
                names.append(f"wheel_slip {len(self.patches) - 1}")
                self._form()
                self._refine(len(self.patches) - 1, names)
            else:
                names.append(max(gains, key=lambda name: gains[name]))
            self.whiten_rows()
            self._delete(names)
        self._compete(names)
        for i in range(len(self.patches)):
            if f"wheel_slip {i}" in names:
                self._refine(i, names)
        self._delete(names)
        return names

    def _compete(self, names: list[str]) -> None:
        """Let structure that no effect makes stand beside the effects, or in their stead."""
        own = np.concatenate([self.columns(), self._edges(names)], axis=1)
        judge = Judge(self.rows.is_valid, self.y, LimitedNoise(self.limits))
        name, gain = judge.best(own, self.families)
        noise = judge.dispersion(CLUSTER, self.limits[0].period)
        is_instead = False
        if self.patches:
            other, alone = name, judge.gain(self.A, self.families[name])
            if len(self.patches) > 1:  # what several patches mimic need not be what they leave
                other, alone = judge.best(self.A, self.families)
            alone -= judge.gain_of(own, self.A)
            is_instead = alone + 4 * PENALTY * len(self.patches) > gain
            name, gain = (other, alone) if alone > gain else (name, gain)
        needed = max(FOREIGN * noise, FAINT * self.rows.n)
        needed = needed if is_instead else max(needed, self._inexact(names))
        if gain < needed:
            return
        self.tests[name] = (gain, needed)
        if is_instead:
            self.patches = []
            names[:] = [other for other in names if other in GLOBAL]
        self.foreign.append(name)
        self.whiten_rows()
        self._delete(names)

    def _inexact(self, names: Sequence[str]) -> float:
        """Return what the models of the effects themselves may leave for structure to explain [nats]."""
        wheels = [name for name in names if name in GLOBAL]
        patch = max(self.score(names) - self.score(wheels), 0.0)
        if len(names) - len(wheels) > 1:  # several patches and still structure: they mimic something else
            patch = 0.0
        return SHARE * (self.score(wheels) - self.score([])) + RIM * patch

    def _delete(self, names: list[str]) -> None:
        """Take superfluous effects back, the weakest first."""
        while names:
            spare = {name: self.evidence(names, name) - self._needed(names, name) for name in names}
            weakest = min(names, key=lambda name: spare[name])
            if spare[weakest] >= 0.0:
                return
            names.remove(weakest)

    def _needed(self, names: Sequence[str], name: str) -> float:
        """Return the evidence that an effect must bring beside the others [nats]."""
        others = [other for other in names if other.startswith("wheel_slip") and other != name]
        if not (name.startswith("wheel_slip") and others):
            return THRESHOLD
        return max(THRESHOLD, FURTHER * (self.score(names) - self.score([])))

    def _best_patch(self, names: Sequence[str]) -> tuple[Patch | None, float]:
        moving = np.abs(self.wheels.way) > 1e-3
        spots = self.rows.spots[moving, :2]
        if len(spots) < 20:
            return None, -np.inf
        cell = 0.15
        keys = np.unique(np.round(spots / cell).astype(np.intp), axis=0)
        if len(keys) > 250:
            keys = keys[:: len(keys) // 250 + 1]
        discs = np.concatenate([np.column_stack([keys * cell, np.full(len(keys), r)]) for r in RADII])
        gains, _ = self._disc_gains(discs, names)
        disc = discs[int(np.argmax(gains))]
        for step in (0.08, 0.04):
            near = disc + step * self.rng.uniform(-1.5, 1.5, size=(120, 3))
            near[:, 2] = np.clip(near[:, 2], 0.12, 1.2)
            near = np.concatenate([disc[None], near])
            gains, _ = self._disc_gains(near, names)
            disc = near[int(np.argmax(gains))]
        x, y, r = (float(value) for value in disc)
        return Patch(x=x, y=y, r=r, spread=np.zeros((4, 4))), float(gains.max()) - PENALTY * 4

    def _disc_gains(self, discs: Floats, names: Sequence[str]) -> tuple[Floats, Floats]:
        """Return likelihood gained [nats] and motion lost for each disc, given a set of effects."""
        solution = self.normal.solve(self.prior(names))
        Z = -self._white(self._gained(_inside(self.rows.spots, discs)))
        left = self.normal.y - self.normal.A @ solution.theta
        prior = self.prior(names)
        score = left @ Z
        cross = self.normal.A.T @ Z
        free = np.diag(solution.covariance) > 0
        C = solution.covariance[np.ix_(free, free)]
        info = np.einsum("ij,ij->j", Z, Z) - np.einsum("ij,ij->j", cross[free], C @ cross[free])
        info = np.maximum(info, 1e-9 + 1e-6 * np.einsum("ij,ij->j", Z, Z))
        lost = np.clip(score / info, 0.0, 0.95)
        del prior
        gains = lost * score - 0.5 * lost**2 * info
        gains[info < 400.0] = 0.0  # 5 % standard error: the disc was hardly driven through
        return gains, lost

    def _refine(self, i: int, names: Sequence[str]) -> None:
        """Move a patch to the middle of its likelihood and take its spread from there."""
        rest = [name for name in names if name != f"wheel_slip {i}"]
        patch = self.patches[i]
        disc = np.array([patch.x, patch.y, patch.r])
        cloud = _grid_about(disc)
        height, motion = self._disc_gains(cloud, rest)
        disc = cloud[int(np.argmax(height))]
        scale = 0.25
        for turn_no in range(5):
            # a larger disc whose near edge stays where it was fits almost as well: look along that ridge too
            turn = self.rng.uniform(-np.pi, np.pi, size=80)
            grow = 2 * scale * self.rng.normal(size=80)
            ridge = disc + grow[:, None] * np.stack([np.cos(turn), np.sin(turn), np.ones(80)], axis=1)
            ridge += 0.02 * self.rng.normal(size=ridge.shape)
            near = np.concatenate([disc + scale * self.rng.normal(size=(80, 3)), ridge])
            near = near[(near[:, 2] > 0.1) & (near[:, 2] < 1.3)]
            if not len(near):
                continue
            gains, lost = self._disc_gains(near, rest)
            cloud = np.concatenate([cloud, near])
            height, motion = np.append(height, gains), np.append(motion, lost)
            disc = cloud[int(np.argmax(height))]
            scale = (0.25, 0.12, 0.06, 0.03, 0.03)[turn_no]
        # one disc for each cell of the search: it is dense where it was searched, not where a disc is likely
        best = np.argsort(-height)
        best = best[height[best] > height[best[0]] - 6.0]
        _, first = np.unique(np.round(cloud[best] / 0.05), axis=0, return_index=True)
        best = best[first]
        # discs of every size are as likely as their mirror images under a magnifying glass: 1 / r³
        weight = np.exp((height[best] - height.max()) / TEMPER) / cloud[best, 2] ** 3
        weight /= weight.sum()
        values = np.column_stack([motion, cloud])[best]
        middle = weight @ values
        nearest = int(np.argmin(((values[:, 1:] - middle[1:]) ** 2).sum(axis=1)))
        disc = cloud[best[nearest]]
        off = values - values[nearest]
        covariance = (off * weight[:, None]).T @ off
        self.patches[i] = Patch(x=float(disc[0]), y=float(disc[1]), r=float(disc[2]), spread=covariance)
        self._form()

    # result

    def result(self, notes: Mapping[str, object]) -> ChannelResult:
        """Search, judge and report."""
        deviations = self._deviations()
        names = self.select()
        unknown = self._unknown(names)
        solution = self.normal.solve(self.prior(names))
        spread = self.normal.sandwich(solution, self.clusters)
        found = [self._amendment(name, names, solution, spread) for name in names]
        found.sort(key=lambda a: -(a.evidence or 0.0))
        named = [a for a in found if _is_material(a)]
        small = [a for a in found if not _is_material(a)]
        rivals = [rival for name in names for rival in self._rivals(name, names, named)]
        extra = {
            **notes,
            "clock_offset_s": self.rows.clock + float(solution.theta[3]),
            "rows": int(self.ok.sum()),
        }
        return ChannelResult(
            channel="odometry",
            effects=tuple(named),
            within_tolerance=tuple(small),
            unknown=unknown,
            rivals=tuple(rivals),
            deviations=deviations,
            gap=self._gap(names),
            not_observable=self._not_observable(names),
            notes=extra,
        )

    def _amendment(self, name: str, names: Sequence[str], solution: Solution, spread: Floats) -> Amendment:
        theta, sd = solution.theta, np.sqrt(np.diag(spread))
        evidence = self.evidence(names, name)
        rivals = self._alternatives(name, names)
        probability = probabilities({name: evidence, **rivals})[name]
        location = None
        if name.startswith("wheel_slip"):
            i = int(name.split()[1])
            patch = self.patches[i]
            values = {"s": float(np.clip(theta[5 + i], 0, 1)), "x": patch.x, "y": patch.y, "r": patch.r}
            width = np.sqrt(np.diag(patch.spread))
            errors = {"s": float(np.hypot(sd[5 + i], width[0]))} | {
                key: float(np.hypot(PLACE_DOUBT * w, 0.02)) for key, w in zip("xyr", width[1:], strict=True)
            }
            location = (patch.x, patch.y)
            effect = EFFECTS["wheel_slip"]
        else:
            effect = EFFECTS[name]
            gain = 1 + theta[0] if "wheel_radius" in names else 1.0
            k = GLOBAL.index(name)
            if name == "wheel_radius":
                values = {"s": float(1 / gain - 1)}
                errors = {"s": float(sd[k] / gain**2)}
            elif name == "wheel_base":
                values = {"s": float((gain + theta[k]) / gain - 1)}
                errors = {"s": float(sd[k])}
            elif name == "wheel_radius_diff":
                values = {"s": float(theta[k] / gain)}
                errors = {"s": float(sd[k])}
            else:
                values = {"tau": float(self.rows.clock + theta[k])}
                errors = {"tau": float(np.hypot(sd[k], self.robot.tolerances.stamp / STAMPS))}
        out = replace(effect(**values), stderr=errors, probability=probability, evidence=evidence)
        return out.at(xy=location) if location is not None else out

    def _alternatives(self, name: str, names: Sequence[str]) -> dict[str, float]:
        """Return the evidence of each effect that could stand in an effect's place [nats]."""
        rest = [other for other in names if other != name]
        out = {other: self.evidence([*rest, other], other) for other in GLOBAL if other not in names}
        if not name.startswith("wheel_slip"):
            _, gain = self._best_patch(rest)
            out["wheel_slip"] = gain
        return out

    def _rivals(self, key: str, names: Sequence[str], named: Sequence[Amendment]) -> list[Rival]:
        name = key.split()[0]
        if name not in {a.name for a in named}:
            return []
        rivals = self._alternatives(key, names)
        best = max(rivals, key=lambda other: rivals[other], default="")
        if not best or rivals[best] < THRESHOLD:
            return []
        advice = EFFECTS[name].rivals.get(best) or EFFECTS[best].rivals.get(name) or EFFECTS[name].varies
        return [Rival(name=best, instead_of=name, evidence_nats=rivals[best], separates=advice)]

    # criticism

    def _steady(self) -> dict[str, Family]:
        """Return the families whose columns stand for themselves; the moments of a jump are one choice of many."""
        return {name: family for name, family in self.families.items() if not family.choices}

    def _deviations(self) -> tuple[Deviation, ...]:
        """Say where the bare simulator differs, before any effect is named."""
        solution = self.normal.solve(self.prior([]))
        left = self.normal.y - self.normal.A @ solution.theta
        out = []
        for name, family in self._steady().items():
            columns, labels = family.columns, family.labels
            Z = self._white(columns)
            sums = np.stack(
                [np.bincount(self.clusters.astype(np.intp), weights=z) for z in (Z * left[:, None]).T]
            )
            info = (Z**2).sum(axis=0)
            z = Z.T @ left / np.sqrt(np.maximum(np.maximum(info, (sums**2).sum(axis=1)), 1e-12))
            for i in np.flatnonzero((np.abs(z) > 4.0) & (info > 1e-6)):
                n = int((np.abs(columns[:, i]) > 1e-9).sum())
                out.append(
                    Deviation(
                        family="bias",
                        partition=name,
                        label=labels[i],
                        z=float(z[i]),
                        size=float(Z[:, i] @ left / info[i]),
                        n_rays=n,
                        channel="odometry",
                    )
                )
        out.sort(key=lambda w: -abs(w.z))
        return tuple(out[:12])

    def _unknown(self, names: Sequence[str]) -> Unknown | None:
        """Say what structure entered the model in the stead of effects."""
        if not self.foreign:
            return None
        name, (z, threshold) = self.foreign[0], self.tests[self.foreign[0]]
        text = self.families[name].statement
        return Unknown(
            statement=f"odometry and reference pose differ {text}, which no effect of the library explains",
            deviation=Deviation(
                family="bias",
                partition=kind_of(name),
                label=text,
                z=z,
                size=z,
                n_rays=int(self.ok.sum()),
                channel="odometry",
            ),
            statistic=z,
            threshold=threshold,
        )

    def _edges(self, names: Sequence[str]) -> Floats:
        """Return what small changes of a patch's place and radius would do, so that they are no news."""
        parts = [np.zeros((len(self.y), 0))]
        for i, patch in enumerate(self.patches):
            if f"wheel_slip {i}" not in names:
                continue
            here = np.array([patch.x, patch.y, patch.r])
            moved = np.concatenate([here + 0.06 * np.eye(3), here - 0.06 * np.eye(3)])
            masks = _inside(self.rows.spots, moved)
            parts.append(self._gained(masks[:, :3] - masks[:, 3:]))
        return np.concatenate(parts, axis=1)

    def _gap(self, names: Sequence[str]) -> Gap:
        """Fit on every other 5 s, measure on the rest, and the other way round."""
        n = self.rows.n
        odd = ((self.rows.stamps - self.rows.stamps[0]) // 5.0).astype(np.intp) % 2
        half = np.concatenate([odd, odd])
        columns = self.columns()
        after = np.zeros(len(self.y))
        for side in (0, 1):
            train = half == side
            fit = Normal.of(self.normal.A[train], self.normal.y[train]).solve(self.prior(names))
            after[~train] = (self.y - columns @ fit.theta)[~train]
        nominal = np.zeros(columns.shape[1])
        nominal[3] = -self.rows.clock
        before = self.y - columns @ nominal
        rich = np.concatenate([columns, *[f.columns for f in self._steady().values()]], axis=1)
        Z = self._white(rich)
        G = Z.T @ Z
        theta = np.linalg.solve(G + 1e-8 * np.trace(G) / len(G) * np.eye(len(G)), Z.T @ self.normal.y)
        rest = max(int(self.ok.sum()) - len(theta), 1)
        floor = (self.y - rich @ theta) * np.sqrt(self.ok.sum() / rest)
        return Gap(
            before=self._fit(before), after=self._fit(after), noise_floor=self._fit(floor), n_rays=2 * n
        )

    def _fit(self, residual: Floats) -> FitQuality:
        n, step = self.rows.n, float(np.median(np.diff(self.rows.stamps)))
        m = max(1, round(1.0 / step))
        k = n // m
        use = np.where(self.ok, residual, 0.0)
        along, yaw = (part[: k * m].reshape(k, m).sum(axis=1) / (m * step) for part in (use[:n], use[n:]))
        rmse = float(np.sqrt(np.mean(along**2 + (self.base / 2 * yaw) ** 2)))
        saved, self.weights = self.weights, np.ones(len(self.y))
        white = self._white(use)[self.ok]
        self.weights = saved
        sigma = np.repeat(self.sigmas, n)[self.ok]
        nats = float(np.mean(0.5 * white**2 + np.log(sigma * np.sqrt(2 * np.pi))))
        return FitQuality(rmse_m=rmse, normalised=float(np.sqrt(np.mean(white**2))), nats_per_ray=nats)

    def _not_observable(self, names: Sequence[str]) -> dict[str, str]:
        """Say which effects could not have been seen at three times their materiality."""
        out = {}
        found = {name.split()[0] for name in names}
        for name in GLOBAL:
            if name in found:
                continue
            limit = 3 * next(iter(EFFECTS[name].sizes.values()))
            covariance = self.normal.solve(self.prior([*names, name])).covariance
            expected = 0.5 * limit**2 / max(float(covariance[GLOBAL.index(name), GLOBAL.index(name)]), 1e-18)
            if expected - PENALTY < THRESHOLD:
                out[name] = (
                    f"{_LACKS[name]}: at three times its materiality it would bring {max(expected, 0):.0f} nats"
                )
        if "wheel_slip" not in found and float(np.abs(self.wheels.way).sum()) < 1.0:
            out["wheel_slip"] = "the robot drove less than 1 m"
        return out


_LACKS = {
    "wheel_radius": "too little driving",
    "wheel_radius_diff": "too little straight driving",
    "wheel_base": "too little turning",
    "pose_clock_offset": "too little acceleration",
}


def _is_material(a: Amendment) -> bool:
    return all(abs(a.parameters[key]) >= limit for key, limit in a.effect.sizes.items())
