"""Inputs of the search kernels, and the memory that they write to."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planners.kernel import inner_kernel
from planners.search.kernel_world import (
    MAX_BINS_PER_PRIMITIVE,
    Scratch,
    SearchWorld,
    new_scratch,
)
from planners.search.motion_primitives import MotionPrimitives
from planners.search.settings import SearchSettings
from planners.types import Floats, Int32s, Ints

GOAL_CAPACITY = 8
"""Capacity of each unit of time in the search for the nearest bin, as a multiple of its width."""


GOAL_HORIZON, GOAL_MAX_STATES = 400, 300_000
"""[units of time] horizon, and maximum number of states, of the search for the nearest bin."""


class Workspace(NamedTuple):
    """Memory of the beam and of the search for the nearest bin, allocated once per run, for up to n nodes."""

    places: Floats
    """(n, 2) [m] places."""
    scores: Floats
    """(n,)"""
    headings: Int32s
    """(n,) heading steps."""
    modes: Int32s
    """(n,)"""
    total_covered: Int32s
    """(n,) number of bins covered on the path to each node, including its own."""
    parents: Int32s
    """(n,) parent node; -1: the root."""
    branches: Int32s
    """(n,) branch that leads to each node."""
    n_covered: Int32s
    """(n,) number of bins that this branch covers."""
    covered: Ints
    """(n, MAX_BINS_PER_PRIMITIVE) flat indices of those bins."""
    pool: Int32s
    """(layers, capacity) waiting nodes of each unit of time."""
    pool_sizes: Ints
    """(layers,) number of waiting nodes."""
    hash_keys: Ints
    """(slots,) visited lattice states."""
    hash_stamps: Ints
    """(slots,) number of the search that wrote each slot; slots of other searches are free."""
    stamp: Ints
    """(1,) number of the current search."""
    costs: Floats
    """(n,) costs of the nodes to be ordered ..."""
    heap: Ints
    """(n,) ... and the heap that orders them."""
    leaves: Int32s
    """(n,) nodes at or beyond the horizon."""
    sequence: Int32s
    """(n,) branches of the result."""
    far: Ints
    """(nx, ny) number of cell borders to the nearest cell with a missing bin."""
    cell_queue: Ints
    """(nx * ny,) queue of cells while `far` is filled."""
    scratch: Scratch


class SearchTables(NamedTuple):
    """What the kernels of a search read and write."""

    settings: SearchSettings
    world: SearchWorld
    primitives: MotionPrimitives
    workspace: Workspace


def beam_capacity(width: int, n_branches: int) -> int:
    """Return the capacity of each unit of time in the beam.

    A car's primitives differ in duration, so nodes of several layers may wait for the same unit of time.
    """
    return width * n_branches * (2 if n_branches > 3 else 1)


beam_capacity_kernel = inner_kernel(beam_capacity)


def workspace_for(
    settings: SearchSettings, primitives: MotionPrimitives, shape: tuple[int, ...]
) -> Workspace:
    """Return the memory of searches with these settings in an area of `shape` (nx, ny) cells."""
    n_branches = primitives.next_mode.shape[1]
    layers = primitives.n_headings + primitives.max_cost + 1
    in_beam = beam_capacity(settings.beam_width, n_branches)
    capacity = max(in_beam, settings.goal_width * GOAL_CAPACITY)
    most = max(GOAL_MAX_STATES, layers * in_beam)
    slots = 1 << int(np.ceil(np.log2(2 * most)))
    whole = np.empty((6, most), dtype=np.int32)
    return Workspace(
        places=np.empty((most, 2)),
        scores=np.empty(most),
        headings=whole[0],
        modes=whole[1],
        total_covered=whole[2],
        parents=whole[3],
        branches=whole[4],
        n_covered=whole[5],
        covered=np.empty((most, MAX_BINS_PER_PRIMITIVE), dtype=np.int64),
        pool=np.empty((layers, capacity), dtype=np.int32),
        pool_sizes=np.zeros(layers, dtype=np.int64),
        hash_keys=np.empty(slots, dtype=np.int64),
        hash_stamps=np.zeros(slots, dtype=np.int64),
        stamp=np.zeros(1, dtype=np.int64),
        costs=np.empty(most),
        heap=np.empty(most, dtype=np.int64),
        leaves=np.empty(most, dtype=np.int32),
        sequence=np.empty(most, dtype=np.int32),
        far=np.empty(shape, dtype=np.int64),
        cell_queue=np.empty(shape[0] * shape[1], dtype=np.int64),
        scratch=new_scratch(abs(primitives.safe_depth)),
    )
