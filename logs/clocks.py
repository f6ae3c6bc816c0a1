"""Compare the clocks of the signals of a log, and convert their stamps to one clock.

A message has two times: the stamp in its header, from the clock of its publisher, and the log time, from the clock of
the recorder. With one clock per publisher,

    log time = header stamp + offset + latency,

where the latency is short and its variation is small. If the offsets of two signals differ by more than a latency, the
log times determine the difference of their clocks. Smaller differences are left to `diagnose`, which estimates them
from the motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from logs.signals import Signal, forward, half_range, in_nanoseconds
from logs.transforms import Stamps
from logs.types import Bools, Floats


@dataclass(frozen=True, kw_only=True)
class ClockLimits:
    """Limits for the clocks of a log; conventions, not fitted to data."""

    latency: float = 0.25
    """[s] a larger difference between the offsets of two signals is reported ..."""
    offset: float = 1.0
    """[s] ... and one above this is a difference of clocks, which is corrected."""
    post_dated: float = 3.0
    """[s] the same for the transform between map and odometry: localizers stamp it with the end of its validity."""
    drift: float = 0.1
    """[s] smallest drift between two clocks over the log that is corrected."""
    significance: float = 5.0
    """A difference is only corrected if it exceeds the scatter of the log times by this factor."""
    distinct: float = 0.5
    """Minimum share of distinct stamps; below it, the header stamps are too coarse and the log times are used."""
    rate: float = 3.0
    """A clock that is faster or slower than the others by this factor has another unit or rate."""
    unit: float = 0.25
    """Maximum relative deviation of a rate from a power of 1000, which is a unit."""
    most: int = 2000
    """Number of messages of a signal that are compared at most."""
    few: int = 10
    """Minimum number of messages for a statement on the rate and the resolution of a clock."""


CLOCK_LIMITS = ClockLimits()
UNITS = {1e-3: "milliseconds", 1e-6: "microseconds", 1e-9: "nanoseconds", 1e3: "thousands of seconds"}
"""Seconds per unit of a stamp -> name of the unit."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SettledClocks:
    """The stamps of all signals on one clock."""

    stamps: list[Stamps]
    """For each signal: (n,) [ns] in the order of the log."""
    notes: list[str]
    is_changed: bool
    """Whether any stamp was changed."""


@dataclass(kw_only=True, eq=False)
class _Clock:
    """The clock of one signal."""

    signal: Signal
    stamps: Stamps
    sound: Bools
    """(n,) whether a message has a usable header stamp."""
    notes: list[str] = field(default_factory=list)
    is_joined: bool = False
    """Whether the stamps were joined by the log times, so that their offset follows from these alone."""

    @property
    def offsets(self) -> Floats:
        """(n_sound,) [s] log time minus stamp."""
        return np.asarray((self.signal.logged[self.sound] - self.stamps[self.sound]) / 1e9)

    @property
    def at(self) -> Floats:
        """(n_sound,) [ns] log times of the usable stamps, as floats for interpolation."""
        return self.signal.logged[self.sound].astype(np.float64)

    def offset_at(self, logged: Floats | Stamps) -> Floats:
        """Return the offset (n,) [s] at log times [ns]."""
        order = np.argsort(self.at, kind="stable")
        return np.interp(logged.astype(np.float64), self.at[order], self.offsets[order])


@dataclass(frozen=True, kw_only=True)
class _Difference:
    """The difference between two clocks by their log times: the offset of the first minus that of the second."""

    offset: float
    """[s] in the middle of the log."""
    drift: float
    """[s] over the log; 0 if insignificant."""
    scatter: float
    """[s] half the range of the central 90 % of the differences, without the drift."""
    middle: float
    """[ns] log time at which `offset` applies."""
    span: float
    """[ns] of log time over which `drift` applies."""

    def at(self, logged: Stamps) -> Floats:
        """Return the difference (n,) [s] at log times [ns]; a clock keeps its rate outside the common time."""
        share = (logged - self.middle) / self.span if self.span > 0 else np.zeros(len(logged))
        return np.asarray(self.offset + self.drift * share)


def settle(signals: Sequence[Signal]) -> SettledClocks:
    """Convert the stamps of all signals to one clock, where the log times determine how.

    Header stamps that agree with each other are never changed, whatever the log times are.
    """
    given = list(signals)
    signals, notes = in_nanoseconds(given)
    signals, said = forward(signals, CLOCK_LIMITS.offset)
    notes += said
    clocks = [_clock(signal) for signal in signals]
    _rescale(clocks)
    for clock in clocks:
        _join_segments(clock)
        notes += clock.notes
    usable = [clock for clock in clocks if clock.sound.any()]
    if usable:
        reference = _reference(usable)
        by_log = _drift_of(reference.at, reference.offsets)
        notes += _log_notes(reference, by_log)
        others = [(clock, _difference(clock, reference)) for clock in usable if clock is not reference]
        if abs(by_log.offset) > CLOCK_LIMITS.offset or by_log.drift:
            for clock in clocks:
                notes += _convert_log_times(clock, reference)
        for clock, found in others:
            notes += _align(clock, found, reference.signal.name)
    stamps = [clock.stamps for clock in clocks]
    changed = any(
        not np.array_equal(new, old.stamps if old.has_header else old.logged)
        for new, old in zip(stamps, given, strict=True)
    )
    return SettledClocks(stamps=stamps, notes=notes, is_changed=changed)


def _clock(signal: Signal) -> _Clock:
    """Return the clock of a signal, and which of its header stamps are usable."""
    n, logged = len(signal.stamps), signal.logged
    has_log = n > 0 and (bool(np.ptp(logged) > 0) or (n == 1 and logged[0] != 0))
    if not signal.has_header:
        return _Clock(signal=signal, stamps=logged.copy(), sound=np.zeros(n, dtype=np.bool_))
    clock = _Clock(signal=signal, stamps=signal.stamps.copy(), sound=np.full(n, has_log))
    if not has_log:
        return clock
    absent = signal.stamps == 0
    if absent.any():
        clock.sound = ~absent
        clock.notes.append(
            f"{signal.name}: {int(absent.sum())} messages have stamp 0, their log time was used"
        )
    n_sound, n_distinct = int(clock.sound.sum()), len(np.unique(signal.stamps[clock.sound]))
    is_coarse = n_distinct < CLOCK_LIMITS.distinct * n_sound and (
        n_sound >= CLOCK_LIMITS.few or n_distinct == 1
    )
    if is_coarse and len(np.unique(logged)) > n_distinct / CLOCK_LIMITS.distinct:
        what = "are all equal" if n_distinct == 1 else f"have only {n_distinct} different values"
        clock.notes.append(f"{signal.name}: the {n_sound} header stamps {what}, the log times were used")
        clock.sound = np.zeros(n, dtype=np.bool_)
    clock.stamps[~clock.sound] = logged[~clock.sound]
    return clock


def _rescale(clocks: Sequence[_Clock]) -> None:
    """Rescale the stamps of clocks that run at another rate than most, in place."""
    rates: dict[int, float] = {}
    for clock in clocks:
        rate = _rate(clock)
        is_unit = rate is not None and _unit(rate) is not None
        if rate is not None and (is_unit or clock.sound.sum() >= CLOCK_LIMITS.few):
            rates[id(clock)] = rate
    usual = _usual_rate([rate for rate in rates.values() if _unit(rate) is None])
    for clock in clocks:
        rate = rates.get(id(clock))
        if rate is None:
            continue
        unit = _unit(rate)
        factor = rate / usual if unit is None else unit
        if max(factor, 1 / factor) < CLOCK_LIMITS.rate:
            continue
        first = int(clock.stamps[clock.sound][0]) if unit is None else 0
        moved = first + np.rint((clock.stamps[clock.sound] - first) * factor).astype(np.int64)
        clock.stamps[clock.sound] = moved
        named = UNITS.get(unit or 0.0)
        what = (
            f"are in {named}, not in seconds"
            if named
            else f"run {1 / factor:.3g} times as fast as the others"
        )
        clock.notes.append(f"{clock.signal.name}: the stamps {what}, by the log times: they were rescaled")


def _rate(clock: _Clock) -> float | None:
    """Return the log time per stamp time: the median over ten parts; None if the stamps do not advance."""
    stamps, logged = clock.stamps[clock.sound], clock.signal.logged[clock.sound]
    if len(stamps) < 2:
        return None
    ends = np.unique(np.linspace(0, len(stamps) - 1, 11).astype(np.intp))
    passed, by_log = np.diff(stamps[ends]), np.diff(logged[ends])
    ahead = (passed > 0) & (by_log > 0)
    return float(np.median(by_log[ahead] / passed[ahead])) if ahead.any() else None


def _unit(rate: float) -> float | None:
    """Return the unit [s] in which stamps with this rate are written, if it is not the second."""
    return next((unit for unit in UNITS if abs(rate / unit - 1) < CLOCK_LIMITS.unit), None)


def _usual_rate(rates: Sequence[float]) -> float:
    """Return the rate that most clocks have; among equally frequent ones, that nearest 1."""

    def rank(rate: float) -> tuple[int, float]:
        n_near = sum(max(rate / other, other / rate) < CLOCK_LIMITS.rate for other in rates)
        return n_near, -abs(float(np.log(rate)))

    return max(rates, key=rank, default=1.0)


def _join_segments(clock: _Clock) -> None:
    """Join the stamps of a clock that was reset, or of single wrong stamps, by the log times, in place."""
    index = np.flatnonzero(clock.sound)
    if len(index) < 2:
        return
    steps, by_log = np.diff(clock.stamps[index]) / 1e9, np.diff(clock.signal.logged[index]) / 1e9
    least = max(CLOCK_LIMITS.offset, CLOCK_LIMITS.significance * float(np.median(np.abs(by_log - steps))))
    breaks = np.flatnonzero((by_log >= 0) & ((steps < -least) | (steps - by_log > least)))
    segments = np.split(index, breaks + 1)
    offsets = [float(np.median(clock.signal.logged[s] - clock.stamps[s])) / 1e9 for s in segments]
    main = max(range(len(segments)), key=lambda k: len(segments[k]))
    moved = [k for k, value in enumerate(offsets) if abs(value - offsets[main]) > least]
    joined = clock.stamps.copy()
    for k in moved:
        joined[segments[k]] += round(1e9 * (offsets[k] - offsets[main]))
    if moved and _n_uneven(joined[index]) <= _n_uneven(clock.stamps[index]):
        clock.stamps, clock.is_joined = joined, True
        n_moved = sum(len(segments[k]) for k in moved)
        largest = max((offsets[k] - offsets[main] for k in moved), key=abs)
        clock.notes.append(
            f"{clock.signal.name}: the clock was reset, {n_moved} of {len(index)} stamps differ by up to "
            f"{abs(largest):,.1f} s from the others: joined by the log times"
        )


def _n_uneven(stamps: Stamps) -> int:
    """Return the number of steps between sorted stamps (n,) that are no period; late messages fit between the others."""
    steps = np.diff(np.sort(stamps))
    return int((np.abs(steps - np.median(steps)) > np.median(steps) / 2).sum())


def _reference(clocks: Sequence[_Clock]) -> _Clock:
    """Return the clock with which most others agree; among equals the one closest to the log times, then the first."""

    def rank(clock: _Clock) -> tuple[int, float, bool]:
        others = (_difference(other, clock) for other in clocks if other is not clock)
        n_agreeing = sum(abs(d.offset) <= CLOCK_LIMITS.offset and d.drift == 0 for d in others)
        by_log = _drift_of(clock.at, clock.offsets)
        return n_agreeing, -round(abs(by_log.drift), 1), abs(by_log.offset) <= CLOCK_LIMITS.offset

    return max(clocks, key=rank)  # the first of equals


def _difference(clock: _Clock, reference: _Clock) -> _Difference:
    """Return the difference between two clocks, at the messages of the first that the second spans."""
    thin = slice(None, None, 1 + len(clock.at) // CLOCK_LIMITS.most)
    at, offsets = clock.at[thin], clock.offsets[thin]
    low, high = reference.at.min(), reference.at.max()
    common = (at >= low) & (at <= high)
    if common.any():
        at, offsets = at[common], offsets[common]
    return _drift_of(at, offsets - reference.offset_at(at))


def _drift_of(at: Floats, values: Floats) -> _Difference:
    """Return offset, drift and scatter of values (n,) [s] at log times (n,) [ns], by medians."""
    middle, span = float(at.min() + at.max()) / 2, float(np.ptp(at))
    drift, share = 0.0, (at - middle) / span if span > 0 else np.zeros(len(at))
    third = len(at) // 3
    if third >= CLOCK_LIMITS.few:
        order = np.argsort(at, kind="stable")
        first, last = order[:third], order[-third:]
        rise = float(np.median(values[last]) - np.median(values[first]))
        run = float(np.median(share[last]) - np.median(share[first]))
        drift = rise / run if run > 0 else 0.0
    scatter = half_range(values - drift * share)
    if abs(drift) < max(CLOCK_LIMITS.drift, CLOCK_LIMITS.significance * scatter):
        drift, scatter = 0.0, half_range(values)
    offset = float(np.median(values - drift * share))
    return _Difference(offset=offset, drift=drift, scatter=scatter, middle=middle, span=span)


def _log_notes(reference: _Clock, by_log: _Difference) -> list[str]:
    """Report log times that differ from the header stamps of all signals."""
    rate = _rate(reference) if len(reference.at) >= CLOCK_LIMITS.few else None
    if rate is not None and max(rate, 1 / rate) > CLOCK_LIMITS.rate:
        return [f"the header stamps run {1 / rate:.3g} times as fast as the log times: they were used"]
    words = list[str]()
    if abs(by_log.offset) > CLOCK_LIMITS.offset:
        words.append(
            f"{abs(by_log.offset):,.3f} s {'after' if by_log.offset > 0 else 'before'} the header stamps"
        )
    if by_log.drift:
        words.append(f"drifting by {by_log.drift:+.2f} s against the header stamps over the log")
    return [f"the log times are {' and '.join(words)}: the header stamps were used"] if words else []


def _convert_log_times(clock: _Clock, reference: _Clock) -> list[str]:
    """Convert the log times that replace stamps to the clock of the header stamps, in place; return the notes."""
    bare = ~clock.sound
    if not bare.any():
        return []
    clock.stamps[bare] -= np.rint(1e9 * reference.offset_at(clock.signal.logged[bare])).astype(np.int64)
    if clock.signal.has_header:
        return []
    return [
        f"{clock.signal.name}: its messages have no stamp, the log times were converted to the clock of "
        f"{reference.signal.name}"
    ]


def _align(clock: _Clock, found: _Difference, name: str) -> list[str]:
    """Convert the stamps of a clock to the reference clock `name`, in place; return the notes."""
    apart, is_ahead = abs(found.offset), found.offset < 0
    most = CLOCK_LIMITS.post_dated if clock.signal.is_correction and is_ahead else CLOCK_LIMITS.offset
    most = CLOCK_LIMITS.latency if clock.is_joined else most
    how = f"{apart:,.3f} s {'ahead of' if is_ahead else 'behind'} those of {name}"
    is_certain = apart > CLOCK_LIMITS.significance * found.scatter
    if (apart > most and is_certain) or found.drift:
        drift = f" and drift by {found.drift:+.2f} s over the log" if found.drift else ""
        moved = np.rint(1e9 * found.at(clock.signal.logged[clock.sound])).astype(np.int64)
        clock.stamps[clock.sound] += moved
        what = f"{how}{drift}, the log times agree to {max(found.scatter, 1e-3):.2g} s: they were used to correct the stamps"
    elif apart > most:
        what = f"{how} according to the log times, which scatter by {found.scatter:.2g} s: they were left as they are"
    elif apart > CLOCK_LIMITS.latency and not clock.signal.is_correction:
        what = (
            f"{how} according to the log times, a latency or a clock offset, which `diagnose` estimates: they were left "
            "as they are"
        )
    else:
        return []
    return [f"{clock.signal.name}: the stamps are {what}"]
