"""A graph of the room of the tests, and runs whose robot believes given poses: what is watched."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from conftest import trusting_scans
from localization_samples import loop_poses, room_run

import sensorgraph as sg
from logs.run import Run
from sensorgraph.graph import Sensorgraph
from sensorgraph.types import Floats


@cache
def graph(model: str = "faces") -> Sensorgraph:
    """Return a graph of the room from two laps and a visit of its far side."""
    t = np.linspace(0.0, 1.0, 80)
    aside = np.column_stack([4.6 + 2.4 * t, 1.2 + 0.6 * t, 4 * t])
    poses = np.concatenate([loop_poses(240, laps=2.0), aside])
    run = room_run(poses, rate=10.0, seed=1)
    with trusting_scans():
        return sg.build(replace(run, pose_stamps=run.stamps, poses=poses), model=model)


def believing(run: Run, poses: Floats) -> Run:
    """Return a run whose robot believes poses (n_scans, 3)."""
    return replace(run, pose_stamps=run.stamps, poses=poses, meta={"pose_source": "/pose"})
