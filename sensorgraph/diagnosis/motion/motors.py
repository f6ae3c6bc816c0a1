"""Commands against odometry: lag, dead time and saturation of the motors.

Every set of effects is a small simulation of the motors (dead time, first order, limited acceleration), fitted to
what the wheels say they did. How far the odometry misreads the wheels is nuisance here: a free gain of a few per
cent, a turn in proportion to speed, and a clock offset as far as the reference poses tell it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_banded

from logs.run import Run
from sensorgraph.diagnosis.motion.noise import Noise
from sensorgraph.diagnosis.motion.unmodelled_structure import Family, Judge, kind_of
from sensorgraph.diagnosis.motion.wheels import clock_offset
from sensorgraph.diagnosis.motion.whitened_regression import (
    PENALTY,
    THRESHOLD,
    Increments,
    Normal,
    Prior,
    Solution,
    autoregression,
    huber,
    increments,
    probabilities,
    whiten,
)
from sensorgraph.diagnosis.result import ChannelResult, Deviation, FitQuality, Gap, Rival, Unknown
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.types import Bools, Floats
from sensorgraph.world.robot import Robot

STEP = 0.01
"""[s] of the simulated motors."""
CONTROL_STEP = 0.003
"""[s] by which a controller's own step blurs a dead time."""
ORDER = 4
GAIN = 0.03
"""Tolerance of the gain from command to odometry; its box is 2.5 times this."""
LAG = 0.004
"""[s] tolerance of the time constant."""
CLOCKS = (0.0015, 0.0035)
"""[s] least and largest tolerance of the clocks."""
FOREIGN = THRESHOLD
"""[nats] that structure outside the library needs."""
SHARE = 0.01
"""Of the evidence of the strongest name: structure below it is where that effect's model is not exact."""
DEADBANDS = (0.03, 0.06, 0.09, 0.12, 0.15, 0.18, 0.21, 0.24, 0.28, 0.33)
"""Shares of the largest command below which motors may do nothing."""
LEAST_ROWS = 100
CLUSTER = 2.0
DRIVE = ("actuator_lag", "dead_time", "speed_saturation")
COLUMNS = ("lag", "dead time", "gain v", "gain omega", "turn per way", "v_max")


@dataclass(frozen=True, kw_only=True, eq=False)
class Motors:
    """Parameters of the simulated motors."""

    tau: float
    """[s]"""
    delay: float
    """[s]"""
    v_max: float = float("inf")
    """[m/s]"""


def diagnose_drive(run: Run, robot: Robot, *, seed: int = 0, use_clock: bool = True) -> ChannelResult:
    """Name what makes commands and odometry differ."""
    wheels = increments(run)
    if wheels is None:
        return ChannelResult(channel="drive", skipped="this run has no odometry that moves")
    good = np.isfinite(run.commands).all(axis=1) if len(run.commands) else np.zeros(0, dtype=np.bool_)
    stamps, commands = run.cmd_stamps[good], run.commands[good]
    if len(stamps) < 20:
        return ChannelResult(
            channel="drive", skipped=f"this run has {len(stamps)} commands, expected at least 20"
        )
    if np.ptp(commands, axis=0).max() < 1e-3:
        return ChannelResult(channel="drive", skipped="the commands of this run never change")
    clock = clock_offset(run, robot) if use_clock else None
    search = _Search(stamps=stamps, commands=commands, wheels=wheels, robot=robot, clock=clock)
    if search.n_valid < LEAST_ROWS:
        return ChannelResult(
            channel="drive",
            skipped=f"commands and odometry overlap in {search.n_valid} samples, expected at least {LEAST_ROWS}",
        )
    return search.result()


class _Search:
    """One run's search for effects of the motors."""

    def __init__(
        self,
        *,
        stamps: Floats,
        commands: Floats,
        wheels: Increments,
        robot: Robot,
        clock: tuple[float, float] | None,
    ) -> None:
        self.robot, self.wheels = robot, wheels
        tolerance = float(np.clip(0.6 * robot.tolerances.stamp, *CLOCKS))
        late, doubt = clock if clock is not None else (0.0, 0.0)
        is_late = abs(late) > max(2 * tolerance, 3 * doubt, 0.004)
        self.late = late if is_late else 0.0
        self.shift = float(np.hypot(tolerance, min(doubt, 0.01) if is_late else 0.0))
        self.has_reference = clock is not None
        self.start, self.end = wheels.start - self.late, wheels.end - self.late
        self.rates = wheels.rates
        limits = robot.limits
        self.t0 = stamps[0] - 1.0
        self.n_steps = int((min(stamps[-1] + 1.0, self.end[-1] + 0.1) - self.t0) / STEP) + 2
        self.grid = self.t0 + STEP * np.arange(self.n_steps)
        # a command acts from its stamp on
        self.cmd_stamps, self.commands = stamps, commands
        self.top = float(np.quantile(np.abs(commands[:, 0]), 0.999)) if len(commands) else 0.0
        self.slew = np.array([limits.a, limits.alpha])
        gap = np.interp(self.end, stamps[1:], np.diff(stamps)) if len(stamps) > 2 else np.zeros(len(self.end))
        self.ok: Bools = (
            (self.start > stamps[0] + 0.3)
            & (self.end < stamps[-1])
            & (gap < 0.35)
            & (self.end - self.start < 0.35)
        )
        self.ok2 = np.concatenate([self.ok, self.ok])
        self.n_valid = int(self.ok.sum())
        self.y = np.where(self.ok2, np.concatenate([self.rates[:, 0], self.rates[:, 1]]), 0.0)
        block = ((self.start - self.start[0]) / CLUSTER).astype(np.intp)
        self.clusters = np.concatenate([block, block]).astype(np.float64)
        self.sigmas = [robot.wheels.sigma_v, robot.wheels.sigma_omega]
        self.taps = [np.eye(1, ORDER + 1)[0]] * 2
        self.weights = np.ones(len(self.y))
        self.nominal = Motors(tau=robot.actuators.tau, delay=robot.actuators.delay)
        self.is_limited = True
        self.simulated: dict[tuple[Motors, bool], tuple[Floats, Floats]] = {}
        self.extra = np.zeros((len(self.y), 0))

    # simulation

    def simulate(self, motors: Motors, *, later: float = 0.0) -> Floats:
        """Return mean (v, omega) of the motors over each increment (2 n,), all `later` [s] than commanded."""
        key = (motors, self.is_limited)
        if key not in self.simulated:
            self.simulated[key] = self._travelled(motors)
        ends, travelled = self.simulated[key]
        start, end = self.start - later, self.end - later
        out = np.stack([np.interp(end, ends, c) - np.interp(start, ends, c) for c in travelled.T], axis=1)
        return np.where(self.ok2, (out / (end - start)[:, None]).T.ravel(), 0.0)

    def _travelled(self, motors: Motors) -> tuple[Floats, Floats]:
        """Return stamps (n_steps,) [s] and way and turn of the motors up to them (n_steps, 2)."""
        index = np.searchsorted(self.cmd_stamps, self.grid + STEP - motors.delay, side="right") - 1
        held = np.where((index >= 0)[:, None], self.commands[np.maximum(index, 0)], 0.0)
        # the step in which a held command changes is shared between old and new
        when = self.cmd_stamps[np.maximum(index, 0)] + motors.delay
        late = np.clip((when - self.grid) / STEP, 0.0, 1.0)
        old = np.where((index >= 1)[:, None], self.commands[np.maximum(index - 1, 0)], 0.0)
        held = held + late[:, None] * (old - held)
        held[:, 0] = np.clip(held[:, 0], -motors.v_max, motors.v_max)
        keep = float(np.exp(-STEP / motors.tau)) if motors.tau > 1e-6 else 0.0
        bands = np.array([[1.0], [-keep]]) * np.ones(len(held))
        speed = solve_banded((1, 0), bands, (1 - keep) * held)  # speed[k] - keep speed[k - 1]
        if self.is_limited:
            for i, most in enumerate(self.slew):
                if np.abs(np.diff(speed[:, i])).max(initial=0.0) > 1.02 * most * STEP:
                    speed[:, i] = _limited(held[:, i], keep, most * STEP)
        # speed[k] is reached at the end of step k
        travelled = np.cumsum(np.concatenate([np.zeros((1, 2)), speed[:-1] + speed[1:]]), axis=0) * STEP / 2
        return self.grid + STEP, travelled

    def linearise(self, motors: Motors) -> tuple[Floats, Floats]:
        """Return the simulated rows (2 n,) and the columns (2 n, 6) of COLUMNS."""
        base = self.simulate(motors)
        n = len(self.ok)
        d_tau = max(0.004, 0.05 * motors.tau)
        lag = (self.simulate(replace(motors, tau=motors.tau + d_tau)) - base) / d_tau
        dead = (self.simulate(motors, later=0.01) - self.simulate(motors, later=-0.01)) / 0.02
        nil = np.zeros(n)
        v, omega = base[:n], base[n:]
        columns = [
            lag,
            dead,
            np.concatenate([v, nil]),
            np.concatenate([nil, omega]),
            np.concatenate([nil, v]),
        ]
        if np.isfinite(motors.v_max):
            columns.append(
                (base - self.simulate(replace(motors, v_max=max(motors.v_max - 0.004, 1e-3)))) / 0.004
            )
        else:
            columns.append(np.zeros(2 * n))
        return base, np.stack(columns, axis=1)

    # fit

    def prior(self, names: Sequence[str], motors: Motors) -> Prior:
        """Return the prior of the columns, as steps from `motors`."""
        base = self.robot.wheels.base
        sigma = np.array([LAG, self.shift, GAIN, GAIN, 0.02 / base, 1e-9])
        mean = np.array(
            [self.nominal.tau - motors.tau, self.nominal.delay - motors.delay, 0.0, 0.0, 0.0, 0.0]
        )
        sigma = np.concatenate([sigma, np.full(self.extra.shape[1], 0.5)])
        mean = np.concatenate([mean, np.zeros(self.extra.shape[1])])
        prior = Prior.of(sigma, mean).freed([[0, 1, 5][DRIVE.index(name)] for name in names])
        prior.box[6:] = np.inf
        return prior

    def fit(self, names: Sequence[str], start: Motors | None = None) -> Fitted:
        """Return the boxed optimum of a set of effects (Gauss-Newton)."""
        motors = start or self.nominal
        if "speed_saturation" in names and not np.isfinite(motors.v_max):
            motors = replace(motors, v_max=self._first_v_max())
        if "speed_saturation" not in names:
            motors = replace(motors, v_max=float("inf"))
        best: Fitted | None = None
        for _ in range(6):
            base, A = self.linearise(motors)
            A = np.concatenate([A, self.extra], axis=1)
            normal = Normal.of(self._white(A), self._white(self.y - base))
            solution = normal.solve(self.prior(names, motors))
            step = solution.theta
            here = Fitted(motors=motors, normal=normal, solution=solution, base=base, A=A)
            small = abs(step[0]) < 1e-3 and abs(step[1]) < 1e-3 and abs(step[5]) < 5e-4
            if best is None or small or solution.J > best.solution.J:
                best = here
            if small:
                break
            motors = Motors(
                tau=float(np.clip(motors.tau + np.clip(step[0], -0.08, 0.15), 1e-3, 3.0)),
                delay=float(motors.delay + np.clip(step[1], -0.1, 0.1)),
                v_max=float(max(motors.v_max + np.clip(step[5], -0.05, 0.05), 0.02)),
            )
        assert best is not None
        return best

    def _first_v_max(self) -> float:
        """Return the speed that is not exceeded though commands ask for more."""
        fastest = float(np.quantile(np.abs(self.rates[self.ok, 0]), 0.995))
        return float(np.clip(fastest, 0.03, max(self.top - 0.005, 0.03)))

    def _white(self, columns: Floats) -> Floats:
        n = len(self.ok)
        parts = [whiten(columns[i * n : (i + 1) * n], self.taps[i], self.sigmas[i]) for i in (0, 1)]
        out = np.concatenate(parts)
        keep = np.where(self.ok2, self.weights, 0.0)
        out *= keep if out.ndim == 1 else keep[:, None]
        return out

    def whiten_rows(self, residual: Floats) -> float:
        """Fit the noise to a residual (2 n,); return its log-likelihood, without constants [nats]."""
        n = len(self.ok)
        for i in (0, 1):
            part = residual[i * n : (i + 1) * n]
            limit = 4.0 * 1.4826 * np.median(np.abs(part[self.ok])) + 1e-9
            taps, sigma = autoregression([np.clip(part, -limit, limit)], [self.ok], ORDER)
            self.taps[i], self.sigmas[i] = taps, max(sigma, 1e-6)
        self.weights = np.ones(len(self.y))
        self.weights = np.sqrt(huber(self._white(residual)))
        return -self.n_valid * float(np.log(self.sigmas).sum())

    def residual(self, fitted: Fitted) -> Floats:
        """Return what a fit leaves (2 n,)."""
        return np.where(self.ok2, self.y - fitted.base - fitted.A @ fitted.solution.theta, 0.0)

    # search

    def select(self) -> tuple[list[str], Fitted]:
        """Start from all effects free, for the noise; then add and take back by evidence."""
        able = [name for name in DRIVE if name != "speed_saturation" or self.top > 0.05]
        full = self.fit(able)
        self.is_limited = False  # some robots limit their commands, and not their motors
        free = self.fit(able)
        if free.solution.J < full.solution.J:
            self.is_limited = True
        else:
            full = free
        for _ in range(2):
            self.whiten_rows(self.residual(full))
            full = self.fit(able, full.motors)
        names: list[str] = []
        here = self.fit([])
        for _ in range(4):
            trials = {name: self.fit([*names, name], here.motors) for name in able if name not in names}
            gains = {name: trial.solution.J - here.solution.J - PENALTY for name, trial in trials.items()}
            best = max(gains, key=lambda name: gains[name], default="")
            if not best or gains[best] < THRESHOLD:
                break
            names.append(best)
            here = trials[best]
            for name in list(names):
                rest = [other for other in names if other != name]
                without = self.fit(rest, here.motors)
                if len(names) > 1 and here.solution.J - without.solution.J - PENALTY < THRESHOLD:
                    names, here = rest, without
        return names, here

    def evidence(self, names: Sequence[str], here: Fitted) -> dict[str, float]:
        """Return the penalised gain of each effect of a set [nats]."""
        return {
            name: here.solution.J
            - self.fit([other for other in names if other != name], here.motors).solution.J
            - PENALTY
            for name in names
        }

    def compete(self, names: list[str], here: Fitted) -> tuple[list[str], Fitted, Unknown | None]:
        """Let structure that no effect makes stand beside the effects, or in their stead."""
        own = here.A[:, [0, 1, 2, 3, 4] + ([5] if "speed_saturation" in names else [])]
        judge = Judge(self.ok, np.where(self.ok2, self.y - here.base, 0.0), free_noise)
        found = self._families(here)
        name, size = judge.best(own, found)
        needed = max(FOREIGN, SHARE * max(self.evidence(names, here).values(), default=0.0))
        if size < needed:
            return names, here, None
        columns = found[name].columns
        self.extra = columns
        full = self.fit(names, here.motors)
        self.whiten_rows(self.residual(full))
        full = self.fit(names, full.motors)
        for effect in list(names):
            rest = [other for other in names if other != effect]
            without = self.fit(rest, full.motors)
            if full.solution.J - without.solution.J - PENALTY < THRESHOLD:
                names, full = rest, without
        text = found[name].statement
        unknown = Unknown(
            statement=f"commands and odometry differ {text}, which no effect of the library explains",
            deviation=Deviation(
                family="bias",
                partition=kind_of(name),
                label=text,
                z=float(np.sqrt(2 * size)),
                size=size,
                n_rays=self.n_valid,
                channel="drive",
            ),
            statistic=size,
            threshold=needed,
        )
        return names, full, unknown

    def _families(self, here: Fitted) -> dict[str, Family]:
        """Return differences that no effect makes."""
        n = len(self.ok)
        v, omega = here.base[:n], here.base[n:]
        nil = np.zeros(n)
        middle = (self.start + self.end) / 2
        share = (middle - middle[self.ok][0]) / np.ptp(middle[self.ok])

        def split(masks: Sequence[Floats], turns: Sequence[Floats]) -> Floats:
            columns = [np.concatenate([v * m, nil]) for m in masks]
            columns += [np.concatenate([nil, omega * m]) for m in turns]
            return np.where(self.ok2[:, None], np.stack(columns, axis=1), 0.0)

        pieces = np.clip((6 * share).astype(np.intp), 0, 5)
        times = [(pieces == k).astype(np.float64) for k in range(1, 6)]
        top_v, top_omega = max(float(np.abs(v).max()), 1e-3), max(float(np.abs(omega).max()), 1e-3)
        slow = [(np.abs(v) < q * top_v).astype(np.float64) for q in (0.25, 0.5)]
        slow_turns = [(np.abs(omega) < q * top_omega).astype(np.float64) for q in (0.12, 0.2, 0.35, 0.6)]
        columns = {
            "time": split(times, times),
            "speed": split(slow, slow_turns),
            "direction": split([(v < 0).astype(np.float64)], [(omega < 0).astype(np.float64)]),
            "timing": np.stack(
                [np.concatenate([here.A[:n, 1] * m, here.A[n:, 1] * m]) for m in times], axis=1
            ),
        }
        columns |= {f"jump {k}": split([late], [late]) for k, late in enumerate(_moments(share))}
        columns |= {f"deadband {k}": part[:, None] for k, part in enumerate(self._deadbands(here))}
        kinds = [kind_of(name) for name in columns]
        return {
            name: Family(
                columns=part,
                labels=[],
                sigma=SIGMAS[kind_of(name)],
                choices=float(np.log(kinds.count(kind_of(name)))),
                statement=_STATEMENTS[kind_of(name)],
            )
            for name, part in columns.items()
        }

    def _deadbands(self, here: Fitted) -> list[Floats]:
        """Return what it would change if commands below some size did nothing (2 n,) each."""
        kept, out = self.commands, []
        top = np.maximum(np.abs(kept).max(axis=0), 1e-3)
        for column in (0, 1):
            for share in DEADBANDS:
                self.commands = kept.copy()
                self.commands[np.abs(kept[:, column]) < share * top[column], column] = 0.0
                ends, travelled = self._travelled(here.motors)
                moved = [np.interp(self.end, ends, c) - np.interp(self.start, ends, c) for c in travelled.T]
                out.append(np.concatenate(moved) / np.tile(self.end - self.start, 2) - here.base)
        self.commands = kept
        return [np.where(self.ok2, column, 0.0) for column in out]

    # result

    def result(self) -> ChannelResult:
        """Search, judge and report."""
        names, here = self.select()
        deviations = self._deviations()
        names, here, unknown = self.compete(names, here)
        evidence = self.evidence(names, here)
        if any(value < THRESHOLD for value in evidence.values()):
            names = [name for name in names if evidence[name] >= THRESHOLD]
            here = self.fit(names, here.motors)
            evidence = self.evidence(names, here)
        spread = here.normal.sandwich(here.solution, self.clusters)
        found, rivals = [], []
        for name in sorted(names, key=lambda name: -evidence[name]):
            amendment, rival = self._amendment(name, names, here, spread, evidence[name])
            found.append(amendment)
            if rival is not None:
                rivals.append(rival)
        named = [a for a in found if self._is_material(a)]
        notes = {
            "odometry_from": self.wheels.source,
            "clock_offset_s": self.late,
            "clock_from_reference": self.has_reference,
            "gain_v": 1 + float(here.solution.theta[2]),
            "gain_omega": 1 + float(here.solution.theta[3]),
        }
        return ChannelResult(
            channel="drive",
            effects=tuple(named),
            within_tolerance=tuple(a for a in found if not self._is_material(a)),
            unknown=unknown,
            rivals=tuple(rivals),
            deviations=deviations,
            gap=self._gap(names, here),
            not_observable=self._not_observable(names, here),
            notes=notes,
        )

    def _amendment(
        self, name: str, names: Sequence[str], here: Fitted, spread: Floats, evidence: float
    ) -> tuple[Amendment, Rival | None]:
        k = [0, 1, 5][DRIVE.index(name)]
        theta, sd = here.solution.theta, float(np.sqrt(spread[k, k]))
        key, value, shared = {
            "actuator_lag": ("tau", here.motors.tau + theta[0] - self.nominal.tau, 0.0),
            "dead_time": ("L", here.motors.delay + theta[1] - self.nominal.delay, CONTROL_STEP),
            "speed_saturation": ("v_max", here.motors.v_max + theta[5], 0.0),
        }[name]
        rest = [other for other in names if other != name]
        floor = self.fit(rest, here.motors).solution.J
        others = {
            other: self.fit([*rest, other], here.motors).solution.J - floor - PENALTY
            for other in DRIVE
            if other not in names and (other != "speed_saturation" or self.top > 0.05)
        }
        probability = probabilities({name: evidence, **others})[name]
        amendment = replace(
            EFFECTS[name](**{key: float(value)}),
            stderr={key: float(np.hypot(sd, shared))},
            probability=probability,
            evidence=evidence,
        )
        best = max(others, key=lambda other: others[other], default="")
        rival = None
        if best and others[best] >= THRESHOLD:
            advice = EFFECTS[name].rivals.get(best) or EFFECTS[best].rivals.get(name) or EFFECTS[name].varies
            rival = Rival(name=best, instead_of=name, evidence_nats=others[best], separates=advice)
        elif name == "dead_time" and not self.has_reference:
            rival = Rival(
                name="pose_clock_offset",
                instead_of=name,
                evidence_nats=evidence,
                separates="reference poses, which this run lacks: an odometry clock that is late looks the same",
            )
        return amendment, rival

    def _is_material(self, a: Amendment) -> bool:
        if a.name == "speed_saturation":
            return bool(self.top - a["v_max"] > 0.02)
        return all(abs(a.parameters[key]) >= limit for key, limit in a.effect.sizes.items())

    def _deviations(self) -> tuple[Deviation, ...]:
        """Say where the bare simulator differs, before any effect is named."""
        here = self.fit([])
        left = here.normal.y - here.normal.A @ here.solution.theta
        n = len(self.ok)
        command = np.abs(here.base[:n])
        gain = np.abs(np.gradient(here.base[:n])) / np.maximum(self.end - self.start, 1e-6)
        parts = {
            ("speed", f"|v| above {0.85 * self.top:.2f} m/s"): command > 0.85 * self.top,
            ("speed", f"|v| from {0.4 * self.top:.2f} to {0.85 * self.top:.2f} m/s"): (
                command > 0.4 * self.top
            )
            & (command <= 0.85 * self.top),
            ("acceleration", "while v changes"): gain > 0.1,
            ("acceleration", "while v is steady"): (gain < 0.02) & (command > 0.02),
        }
        signs = np.sign(here.base[:n])
        change = np.sign(np.gradient(here.base[:n]))
        out = []
        for (partition, label), mask in parts.items():
            sign = change if label == "while v changes" else signs
            e = left[:n] * sign * mask
            sums = np.bincount(self.clusters[:n].astype(np.intp), weights=e)
            scale = float(np.sqrt(max((sums**2).sum(), mask.sum(), 1.0)))
            z = float(e.sum() / scale)
            if abs(z) > 4:
                size = float(e.sum() / max(mask.sum(), 1) * self.sigmas[0])
                out.append(
                    Deviation(
                        family="bias",
                        partition=partition,
                        label=label,
                        z=z,
                        size=size,
                        n_rays=int(mask.sum()),
                        channel="drive",
                    )
                )
        return tuple(sorted(out, key=lambda w: -abs(w.z)))

    def _gap(self, names: Sequence[str], here: Fitted) -> Gap:
        """Fit on every other 5 s, measure on the rest, and the other way round."""
        odd = ((self.start - self.start[0]) // 5.0).astype(np.intp) % 2
        half = np.concatenate([odd, odd])
        after = np.zeros(len(self.y))
        for side in (0, 1):
            train = half == side
            part = Normal.of(here.normal.A[train], here.normal.y[train]).solve(self.prior(names, here.motors))
            after[~train] = (self.y - here.base - here.A @ part.theta)[~train]
        before = self.y - self.simulate(self.nominal)
        noise = self.residual(here)
        k = len(COLUMNS) + self.extra.shape[1]
        floor = noise * np.sqrt(2 * self.n_valid / max(2 * self.n_valid - k, 1))
        return Gap(
            before=self._measure(before),
            after=self._measure(after),
            noise_floor=self._measure(floor),
            n_rays=2 * self.n_valid,
        )

    def _measure(self, residual: Floats) -> FitQuality:
        n = len(self.ok)
        use = np.where(self.ok2, residual, 0.0)
        v, omega = use[:n][self.ok], use[n:][self.ok]
        rmse = float(np.sqrt(np.mean(v**2 + (self.robot.wheels.base / 2 * omega) ** 2)))
        saved, self.weights = self.weights, np.ones(len(self.y))
        white = self._white(use)[self.ok2]
        self.weights = saved
        sigma = np.repeat(self.sigmas, n)[self.ok2]
        nats = float(np.mean(0.5 * white**2 + np.log(sigma * np.sqrt(2 * np.pi))))
        return FitQuality(rmse_m=rmse, normalised=float(np.sqrt(np.mean(white**2))), nats_per_ray=nats)

    def _not_observable(self, names: Sequence[str], here: Fitted) -> dict[str, str]:
        """Say which effects could not have been seen at three times their materiality."""
        out = {}
        for k, name in enumerate(DRIVE[:2]):
            if name in names:
                continue
            limit = 3 * next(iter(EFFECTS[name].sizes.values()))
            covariance = here.normal.solve(self.prior([*names, name], here.motors)).covariance
            expected = 0.5 * limit**2 / max(float(covariance[k, k]), 1e-18)
            if expected - PENALTY < THRESHOLD:
                out[name] = (
                    f"too few changes of the commands: it would bring {expected:.0f} nats at three times its materiality"
                )
        limit = self.robot.limits.v
        if "speed_saturation" not in names and self.top < 0.9 * limit:
            out["speed_saturation"] = (
                f"no command asks for more than {self.top:.2f} of {limit:.2f} m/s: a cap above that cannot be seen"
            )
        return out


@dataclass(frozen=True, kw_only=True, eq=False)
class Fitted:
    """A fit: motors, and the linear system about them."""

    motors: Motors
    normal: Normal
    solution: Solution
    base: Floats
    A: Floats


def _limited(held: Floats, keep: float, most: float) -> Floats:
    """Return speeds (n,) of a first-order motor whose change per step is limited."""
    out, v, share = [], 0.0, 1 - keep
    for u in held.tolist():
        change = (u - v) * share
        v += most if change > most else -most if change < -most else change
        out.append(v)
    return np.array(out)


def free_noise(i: int, residual: Floats, ok: Bools) -> Noise:
    """Return autoregressive noise as the residual (n,) shows it, whichever kind of row it is."""
    limit = 4.0 * 1.4826 * np.median(np.abs(residual[ok])) + 1e-9
    taps, sigma = autoregression([np.clip(residual, -limit, limit)], [ok], ORDER)
    return Noise(taps=taps, sigma=max(sigma, 1e-6))


def _moments(share: Floats) -> list[Floats]:
    """Return masks (n,) of what comes after each of some moments; `share` (n,) of the run has passed."""
    return [(share > k / 16).astype(np.float64) for k in range(1, 16)]


SIGMAS = {"time": 0.1, "jump": 0.1, "speed": 0.1, "direction": 0.1, "timing": 0.05, "deadband": 1.0}
"""Of each coefficient, a priori: gains and shares; timing in seconds."""
_STATEMENTS = {
    "time": "by a gain that changes in time",
    "jump": "by a gain that changes once",
    "speed": "by a gain that depends on speed or turn rate",
    "direction": "differently forward and backward, or to the left and to the right",
    "deadband": "where commands are small",
    "timing": "by a delay that changes in time",
}
