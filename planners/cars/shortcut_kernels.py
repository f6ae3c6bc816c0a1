"""Compiled kernels of `shortcuts`: find and choose the parts of a drive that a quicker word can replace.

A word w between the ends of a part (arc i to arc j) can replace it if it saves enough time:

    Condition: saved = T(runs around the part) - T(the same runs with w) > MIN_SAVING.

In addition, w must be clear and must cover every critical bin: a bin that only this part covers. An upper
bound of `saved` for all words is `max_saving`, the saving of a part that takes no time, less `min_length` /
speed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planners.array_kernels import is_any, last_up_to, make_heap, pop_least, set_all
from planners.cars.arc_path import (
    MAX_BINS,
    BinIntervals,
    CarContext,
    PathAnalysis,
    bins_covered,
    flat_bin,
    is_clear,
    is_logged,
    min_length,
    n_samples,
    pose_at,
    replacement_time,
    section_time,
)
from planners.cars.reeds_shepp import MAX_ARCS, Arcs, Pose, arc_end, empty_arcs, quickest_word
from planners.kernel import inner_kernel, kernel, outer_kernel
from planners.types import Bools, Floats, Ints
from planners.vehicle import SHORTEST_ARC

MAX_SAVING = 60.0
"""[s] maximum time that dropping a part of the drive would save; longer parts are not evaluated."""
MIN_SAVING = 0.1
"""[s] minimum saving of a shortcut."""


class Replacements(NamedTuple):
    """The best part to replace that begins at each arc."""

    saved: Floats
    """(n,) [s] saving; 0: no part."""
    end: Ints
    """(n,) arc at which the drive continues."""
    via: Ints
    """(n,) interval that the shortcut passes, so that its bin is not lost; -1: none."""


class ShortcutWorkspace(NamedTuple):
    """Work memory of one thread."""

    covering: Ints
    """(n_bins,) number of intervals of the path that cover each bin."""
    covering_inside: Ints
    """(n_bins,) number of those inside the part."""
    touched: Ints
    """(n,) bins that the part covers."""
    critical: Ints
    """(n,) critical bins, which only the part covers."""
    new_bins: Ints
    """(MAX_BINS,) bins that the shortcut covers."""
    arcs: Arcs
    word: Floats
    """(MAX_ARCS,) lengths of a word."""


@kernel
def covering_intervals(intervals: BinIntervals, context: CarContext) -> Bools:
    """Return whether each interval (m,) is long enough for a log of any phase to record its bin."""
    found = np.zeros(len(intervals.bin), np.bool_)
    for k in range(len(found)):
        found[k] = intervals.bin[k] >= 0 and is_logged(intervals.length[k], intervals.stops[k], context)
    return found


@inner_kernel
def interval_middle(interval: int, analysis: PathAnalysis) -> Pose:
    """Return the pose in the middle of an interval."""
    path, intervals, _, context = analysis
    at = intervals.start[interval] + 0.5 * intervals.length[interval]
    k = min(last_up_to(intervals.driven, at), len(path.length) - 1)
    return arc_end(pose_at(path, k), at - intervals.driven[k], path.bend[k], path.gear[k], context.radius)


@outer_kernel
def find_shortcut(i: int, j: int, via: int, analysis: PathAnalysis, word: Floats, out: Arcs) -> int:
    """Write the quickest arcs from the start of arc i to that of arc j to `out`; return their number or -1.

    Parameters
    ----------
    via : Interval whose middle the arcs pass; -1: none.
    word : (MAX_ARCS,) Work memory.
    """
    path, context = analysis.path, analysis.context
    gear, n = path.gear[i - 1], 0
    start = pose_at(path, i)
    n_legs = 1 if via < 0 else 2
    for leg in range(n_legs):
        goal, after = pose_at(path, j), path.gear[j]
        if leg < n_legs - 1:
            goal, after = interval_middle(via, analysis), 0
        more = quickest_word(
            start, goal, context.radius, gear, after, context.gear_change_cost, context.can_reverse, SHORTEST_ARC, n,
            word, out,
        )  # fmt: skip
        if more < 0:
            return -1
        n += more
        gear = out.gear[n - 1] if n > 0 else gear
        start = goal
    return n


@inner_kernel
def bins_lost(n_touched: int, n_covered: int, workspace: ShortcutWorkspace) -> tuple[int, int]:
    """Return the number of bins that a shortcut would lose, counted up to two, and the last of them."""
    for k in range(n_covered):
        workspace.covering_inside[workspace.new_bins[k]] -= 1
    n_lost, one = 0, -1
    for k in range(n_touched):
        own = workspace.touched[k]
        if n_lost < 2 and workspace.covering[own] <= workspace.covering_inside[own]:
            n_lost, one = n_lost + 1, own
    for k in range(n_covered):
        workspace.covering_inside[workspace.new_bins[k]] += 1
    return n_lost, one


@inner_kernel
def bins_missed(
    i: int, j: int, arcs: Arcs, n: int, critical: Ints, n_critical: int, analysis: PathAnalysis
) -> tuple[int, int]:
    """Return the number of critical bins that a shortcut does not pass, counted up to two, and the last of them.

    This is a quick test before `bins_covered`. The samples are so dense that each interval which covers a bin
    contains a sample or a stop of the car.
    """
    path, intervals, _, context = analysis
    all_seen = (1 << n_critical) - 1
    seen = 0
    for k in range(n_critical):
        if (
            critical[k] == intervals.bin[intervals.before[i]]
            or critical[k] == intervals.bin[intervals.after[j]]
        ):
            seen |= 1 << k
    start = pose_at(path, i)
    for m in range(n):
        if seen == all_seen:
            return 0, -1
        count = n_samples(arcs.length[m], context.min_stay / 2)
        for s in range(1, count + 1):
            pose = arc_end(start, s * arcs.length[m] / count, arcs.bend[m], arcs.gear[m], context.radius)
            own = flat_bin(pose, context)
            for k in range(n_critical):
                if critical[k] == own:
                    seen |= 1 << k
        start = arc_end(start, arcs.length[m], arcs.bend[m], arcs.gear[m], context.radius)
    n_unseen, one = 0, -1
    for k in range(n_critical):
        if not seen & (1 << k):
            n_unseen, one = min(n_unseen + 1, 2), critical[k]
    return n_unseen, one


@inner_kernel
def evaluate(
    i: int,
    j: int,
    n_critical: int,
    n_touched: int,
    analysis: PathAnalysis,
    workspace: ShortcutWorkspace,
    replacements: Replacements,
) -> None:
    """Store the quickest shortcut from arc i to arc j if it saves more than the one stored for arc i.

    Parameters
    ----------
    n_critical : Number of bins that only this part covers.
    n_touched : Number of bins that it covers.
    """
    path, intervals, runs, context = analysis
    best, before = max(replacements.saved[i], MIN_SAVING), section_time(i, j, runs)
    arcs, via = workspace.arcs, -1
    start, goal = pose_at(path, i), pose_at(path, j)
    most = max_saving(i, j, analysis)
    if most - min_length(start, goal, context.radius) / context.speed <= best:
        return
    for _ in range(2):
        n_arcs = find_shortcut(i, j, via, analysis, workspace.word, arcs)
        if n_arcs < 0:
            return
        saved = before - replacement_time(i, j, arcs, n_arcs, analysis)
        if saved <= best:
            return
        n_lost, one = 0, -1
        if n_critical > 0:
            n_lost, one = bins_missed(i, j, arcs, n_arcs, workspace.critical, n_critical, analysis)
            if n_lost == 0:
                n_covered = bins_covered(i, j, arcs, n_arcs, analysis, workspace.new_bins)
                n_lost, one = bins_lost(n_touched, n_covered, workspace)
        if n_lost == 0:
            if is_clear(start, arcs, n_arcs, context):
                replacements.saved[i], replacements.end[i], replacements.via[i] = saved, j, via
            return
        if n_lost > 1 or via >= 0:
            return
        via = longest_interval(one, intervals.before[i], intervals.after[j], intervals)
        middle = interval_middle(via, analysis)
        length = min_length(start, middle, context.radius) + min_length(middle, goal, context.radius)
        if most - length / context.speed <= best:
            return


@inner_kernel
def search_from(
    i: int,
    most: int,
    analysis: PathAnalysis,
    covers: Bools,
    must_stay: Bools,
    workspace: ShortcutWorkspace,
    replacements: Replacements,
) -> None:
    """Find the best part to replace that begins at arc i; see `search_replacements`."""
    path, intervals = analysis.path, analysis.intervals
    n_touched, n_critical, at = 0, 0, intervals.before[i] - 1
    for j in range(i + 1, len(path.length)):
        while at < intervals.after[j]:
            at += 1
            if must_stay[at]:
                n_critical = most + 1
            if covers[at]:
                own = intervals.bin[at]
                if workspace.covering_inside[own] == 0:
                    workspace.touched[n_touched] = own
                    n_touched += 1
                workspace.covering_inside[own] += 1
                if workspace.covering_inside[own] == workspace.covering[own]:
                    workspace.critical[min(n_critical, most)] = own
                    n_critical += 1
        if n_critical > most or max_saving(i, j, analysis) > MAX_SAVING:
            break
        evaluate(i, j, n_critical, n_touched, analysis, workspace, replacements)
    for k in range(n_touched):
        workspace.covering_inside[workspace.touched[k]] = 0


@kernel
def search_replacements(
    begin: int,
    stop: int,
    most: int,
    fresh: Bools,
    analysis: PathAnalysis,
    covers: Bools,
    must_stay: Bools,
    count: Ints,
    replacements: Replacements,
) -> None:
    """Find the best part to replace for each `fresh` (n,) arc from `begin` to `stop` (excluded).

    Parameters
    ----------
    most : Maximum number of bins that only the replaced part covers.
    covers : (m,) Whether each interval covers its bin.
    must_stay : (m,) Intervals whose bin no interval covers for certain; they are not replaced.
    count : (n_bins,) Number of intervals that cover each bin.
    """
    n = len(analysis.path.length)
    workspace = ShortcutWorkspace(
        count,
        np.zeros(len(count), np.int64),
        np.empty(len(analysis.intervals.bin), np.int64),
        np.empty(most + 1, np.int64),
        np.empty(MAX_BINS, np.int64),
        empty_arcs(2 * MAX_ARCS),
        np.empty(MAX_ARCS),
    )
    for i in range(max(begin, 1), min(stop, n - 1)):
        if fresh[i]:
            search_from(i, most, analysis, covers, must_stay, workspace, replacements)


@inner_kernel
def max_saving(i: int, j: int, analysis: PathAnalysis) -> float:
    """Return the time [s] saved if the part from arc i to arc j took none: an upper bound for all shortcuts."""
    path, _, runs, context = analysis
    outside = runs.before[i - 1] + path.length[i - 1] + runs.length[runs.run[j]] - runs.before[j]
    return float(section_time(i, j, runs) - outside / context.speed)


@inner_kernel
def longest_interval(own: int, first: int, last: int, intervals: BinIntervals) -> int:
    """Return the longest of the intervals `first` to `last` in a bin."""
    best = -1
    for k in range(max(first, 0), last + 1):
        if intervals.bin[k] == own and (best < 0 or intervals.length[k] > intervals.length[best]):
            best = k
    return best


@kernel
def choose_replacements(
    analysis: PathAnalysis, covers: Bools, count: Ints, replacements: Replacements
) -> Ints:
    """Choose parts to replace, largest saving first; no two of them touch.

    Returns
    -------
    The first arcs (k,) of the parts, in that order.
    """
    path, intervals, runs, context = analysis
    arcs, word, gained = empty_arcs(2 * MAX_ARCS), np.empty(MAX_ARCS), np.empty(MAX_BINS, np.int64)
    is_run_taken, is_taken = np.zeros(len(runs.length), np.bool_), np.zeros(len(intervals.bin), np.bool_)
    chosen, n_chosen = np.empty(len(path.length), np.int64), 0
    costs, heap = np.empty(len(replacements.saved)), np.empty(len(replacements.saved), np.int64)
    for i in range(len(costs)):
        costs[i] = -replacements.saved[i]
    make_heap(heap, len(heap), costs)
    for popped in range(len(heap)):
        i = pop_least(heap, len(heap) - popped, costs)
        if replacements.saved[i] <= 0:
            break
        j = replacements.end[i]
        first, last = max(intervals.before[i], 0), intervals.after[j]
        if is_any(is_taken, first, last):
            continue
        if context.can_reverse and is_any(is_run_taken, runs.run[i - 1], runs.run[j]):
            continue
        n_arcs = find_shortcut(i, j, replacements.via[i], analysis, word, arcs)
        n_gained = bins_covered(i, j, arcs, n_arcs, analysis, gained)
        for k in range(n_gained):
            count[gained[k]] += 1
        is_lost = False
        for k in range(first, last + 1):
            if covers[k]:
                count[intervals.bin[k]] -= 1
                is_lost |= count[intervals.bin[k]] == 0
        if is_lost:
            for k in range(first, last + 1):
                if covers[k]:
                    count[intervals.bin[k]] += 1
            for k in range(n_gained):
                count[gained[k]] -= 1
            continue
        set_all(is_taken, first, last)
        set_all(is_run_taken, runs.run[i - 1], runs.run[j])
        chosen[n_chosen] = i
        n_chosen += 1
    return chosen[:n_chosen]
