"""Do drawn scans have the memory of recorded ones? Lengths of bursts, correlation in time and of neighbours.

    OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 python -m benchmarks.residual_memory GRAPH RUN [--scans 4000]

RUN is a log with poses, such as `sensorgraph locate intel.clf.bz2 -o intel.mcap` writes, GRAPH one of its place. The memory
is identified on the first half of the scans; the second half is drawn from the graph at its own poses, without a memory and
with it, and compared with what was recorded. Events are returns that are missing or off the predicted surface by 5 cm.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.arguments import heads, parser_of
from logs import read
from logs.run import Run, pair
from logs.transforms import compose
from planners.types import Floats
from sensorgraph.evaluation.evaluate import poses_for
from sensorgraph.graph import Sensorgraph
from sensorgraph.models.base import Prediction
from sensorgraph.models.faces.model import Faces
from sensorgraph.models.narmax.sequences import stretches
from sensorgraph.models.place_noise import places_of
from sensorgraph.models.residual_memory import ResidualMemory, events_of
from sensorgraph.recording.identified_world import ScanNoise

LAGS = (1, 2, 3, 5, 8, 10)
SEED = 1


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("graph", type=Path)
    parser.add_argument("run", type=Path)
    parser.add_argument("--scans", type=int, default=4000)
    arguments = parser.parse_args()
    graph, run = Sensorgraph.load(arguments.graph), read(arguments.run)
    scans = np.flatnonzero(pair(run).paired)[: arguments.scans]
    poses = poses_for(graph, run.pose_frame, run.sensor.mount, pair(run).poses[scans])
    said, index = graph.predict(poses), _index(run, scans)
    half = len(scans) // 2
    ranges = run.ranges[scans]
    first = events_of(ranges[:half], said.mode[:half], said.p_no_return[:half], said.p_off[:half])
    starts = compose(poses, np.zeros(3) if graph.pose_frame == "laser" else graph.sensor.mount)
    places = places_of(starts, graph.sensor.bearings, said.mode, graph.sensor.range_max)
    stamps = run.stamps[scans]
    memory = ResidualMemory.fit(**first, places=places[:half], stamps=stamps[:half])
    print(memory.summary())
    later = slice(half, len(scans))
    worlds = {
        "recorded": ranges[later],
        "drawn without memory": _drawn(graph, poses[later], None, places[later], stamps[later]),
        "drawn with memory": _drawn(graph, poses[later], memory, places[later], stamps[later]),
    }
    found = {name: _statistics(values, said, later, index[later]) for name, values in worlds.items()}
    print(heads("", *found))
    for label in found["recorded"]:
        print(f"| {label} | " + " | ".join(f"{values[label]:.3f}" for values in found.values()) + " |")


def _index(run: Run, scans: np.ndarray) -> np.ndarray:
    """Return scan numbers in which a gap leaves a number out."""
    used = np.zeros(run.n_scans, dtype=np.bool_)
    used[scans] = True
    return np.arange(len(scans)) + stretches(run.stamps, used, float(np.median(np.diff(run.stamps))))


def _drawn(
    graph: Sensorgraph, poses: Floats, memory: ResidualMemory | None, places: Floats, stamps: Floats
) -> Floats:
    model, fresh = graph.model, ScanNoise(SEED, graph.sensor.n_rays)
    assert isinstance(model, Faces)
    numbers = [fresh.of(k) for k in range(len(poses))]
    if memory is not None:
        numbers = [
            memory.numbers(SEED, t, there, *own)
            for t, there, own in zip(stamps.tolist(), places, numbers, strict=True)
        ]
    uniform, normal = (np.array(part) for part in zip(*numbers, strict=True))
    return model.draw(poses, uniform, normal)


def _statistics(ranges: Floats, said: Prediction, rows: slice, index: np.ndarray) -> dict[str, float]:
    part = events_of(ranges, said.mode[rows], said.p_no_return[rows], said.p_off[rows])
    event, residual = part["event"] - part["chance"], part["residual"]
    residual = residual - np.nanmean(residual, axis=0)
    lengths = _bursts(part["event"], index)
    lost = _bursts(np.isposinf(ranges).astype(float), index)
    out = {
        "events, share": float(np.nanmean(part["event"])),
        "length of a burst of events, mean [scans]": float(lengths.mean()),
        "bursts of 3 scans or more, share": float((lengths >= 3).mean()),
        "bursts of 10 scans or more, share": float((lengths >= 10).mean()),
        "length of a burst without return, mean [scans]": float(lost.mean()) if len(lost) else float("nan"),
        "events of neighbours, correlation": _correlation(event[:, 1:], event[:, :-1]),
        "noise of neighbours, correlation": _correlation(residual[:, 1:], residual[:, :-1]),
    }
    for name, values in (("events", event), ("noise", residual)):
        for lag in LAGS:
            follows = index[lag:] - index[:-lag] == lag
            out[f"{name}, ACF at {lag}"] = _correlation(values[lag:][follows], values[:-lag][follows])
    return out


def _correlation(a: Floats, b: Floats) -> float:
    known = np.isfinite(a) & np.isfinite(b)
    return float(np.corrcoef(a[known], b[known])[0, 1])


def _bursts(event: Floats, index: np.ndarray) -> np.ndarray:
    """Return the lengths of runs of events of all rays; a gap ends a run."""
    out = []
    breaks = np.r_[True, np.diff(index) != 1]
    for column in (event == 1).T:
        start = column & (breaks | ~np.r_[False, column[:-1]])
        number = np.cumsum(start)
        out.append(np.bincount(number[column])[1:] if column.any() else np.zeros(0, dtype=int))
    lengths = np.concatenate(out)
    return lengths[lengths > 0]


if __name__ == "__main__":
    main()
