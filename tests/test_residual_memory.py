"""The memory of residuals: planted chains come back from their events, and what is drawn keeps its chances."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from logs.run import RangeSensor, Run
from sensorgraph.building.build import build
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.models.residual_memory import MemoryState, ResidualMemory
from sensorgraph.recording.identified_world import NoiseWithMemory, ScanNoise

N_RAYS = 12
INDEX = np.arange(4000)


def memory(lasting: float, shared: float, ar: float, across: float) -> ResidualMemory:
    return ResidualMemory(
        lasting=np.full(N_RAYS, lasting), shared=np.array([shared]), ar=np.tile([ar, 0.0], (N_RAYS, 1)),
        ma=np.zeros((N_RAYS, 1)), gain=np.full(N_RAYS, np.sqrt(1 - ar**2)), across=np.array([across]),
    )  # fmt: skip


def test_drawn_numbers_keep_their_distribution_and_have_the_memory() -> None:
    rng = np.random.default_rng(1)
    state = MemoryState(memory(0.6, 0.3, 0.8, 0.5))
    drawn = [state.step(rng.random(N_RAYS), rng.normal(size=N_RAYS), rng.random((2, N_RAYS))) for _ in INDEX]
    u, z = (np.array(part) for part in zip(*drawn, strict=True))
    assert stats.kstest(u[::25].ravel(), "uniform").pvalue > 1e-3
    assert stats.kstest(z[::25].ravel(), "norm").pvalue > 1e-3
    assert abs(np.corrcoef(z[1:, 3], z[:-1, 3])[0, 1] - 0.8) < 0.05
    assert abs(np.corrcoef(z[:, 3], z[:, 4])[0, 1] - 0.5) < 0.08
    assert (u[:, 1:] == u[:, :-1]).mean() > 0.3


def test_planted_bursts_and_noise_come_back() -> None:
    """Events of a two-state chain written out here: after an event another one comes with chance 0.1 + 0.5 * 0.9."""
    rng = np.random.default_rng(2)
    event = np.zeros((len(INDEX), N_RAYS))
    noise = np.zeros_like(event)
    for k in range(1, len(INDEX)):
        chance = np.where(event[k - 1] == 1, 0.1 + 0.5 * 0.9, 0.1 * (1 - 0.5))
        event[k] = rng.random(N_RAYS) < chance
        noise[k] = 0.7 * noise[k - 1] + 0.01 * rng.normal(size=N_RAYS)
    found = ResidualMemory.fit(residual=noise, chance=np.full(event.shape, 0.1), event=event, index=INDEX)
    assert np.allclose(found.lasting, 0.5, atol=0.08)
    assert found.shared[0] < 0.05
    one_step = found.ar[:, 0] + found.ma[:, 0]  # of the impulse response
    assert np.allclose(one_step, 0.7, atol=0.08)


def test_white_residuals_have_no_memory() -> None:
    rng = np.random.default_rng(3)
    event = (rng.random((len(INDEX), N_RAYS)) < 0.2).astype(float)
    noise = rng.normal(size=event.shape)
    found = ResidualMemory.fit(residual=noise, chance=np.full(event.shape, 0.2), event=event, index=INDEX)
    assert found.lasting.max() < 0.05
    assert found.shared[0] < 0.02
    assert found.ar.any(axis=1).mean() < 0.35  # 5 % alarms; 12 rays


def test_noise_of_a_scan_belongs_to_its_number_whoever_asks() -> None:
    planted = memory(0.6, 0.3, 0.8, 0.5)
    in_order, mixed = NoiseWithMemory(7, planted), NoiseWithMemory(7, planted)
    every = [in_order.of(k) for k in range(20)]
    for number in (13, 2, 2, 19):
        assert np.array_equal(mixed.of(number), every[number])
    none = NoiseWithMemory(7, memory(0.0, 0.0, 0.0, 0.0))
    assert np.allclose(none.of(5), ScanNoise(7, N_RAYS).of(5))


def square_run(n: int) -> Run:
    """Rays in a room of 4 m whose noise is sticky."""
    rng = np.random.default_rng(4)
    sensor = RangeSensor(bearings=np.radians(np.linspace(-60, 60, 9)))
    t = 0.1 * np.arange(n)
    phi = 0.3 * t
    poses = np.column_stack([2 + np.cos(phi), 2 + np.sin(phi), np.pi - (np.pi - 1.7 * phi) % (2 * np.pi)])
    angle = poses[:, 2:3] + sensor.bearings
    c, s = np.cos(angle), np.sin(angle)
    with np.errstate(divide="ignore"):
        to_x = np.abs((np.where(c > 0, 4.0, 0.0) - poses[:, 0:1]) / c)
        to_y = np.abs((np.where(s > 0, 4.0, 0.0) - poses[:, 1:2]) / s)
    noise = np.zeros(to_x.shape)
    for k in range(1, n):
        noise[k] = 0.9 * noise[k - 1] + 0.005 * rng.normal(size=9)
    return Run(sensor=sensor, stamps=t, ranges=np.minimum(to_x, to_y) + noise, pose_stamps=t, poses=poses)


def test_graph_keeps_its_memory_in_the_file(tmp_path: Path) -> None:
    run = square_run(600)
    graph = build([run], model="polynomial", degree=2, harmonics=2)
    assert graph.memory is None
    graph = replace(graph, memory=memory(0.5, 0.2, 0.5, 0.1))
    with pytest.raises(SensorgraphError, match=r"memory\.lasting has shape"):
        _save_and_load(graph, tmp_path)  # of 12 rays, not 9
    fitted = build([run], model="polynomial", degree=6, harmonics=6, n_terms=60, memory=True)
    assert fitted.memory is not None
    again = _save_and_load(fitted, tmp_path)
    assert again.memory is not None
    for name, array in fitted.memory.arrays().items():
        assert np.array_equal(array, again.memory.arrays()[name])
    assert "events last" in fitted.facts()["memory"]


def _save_and_load(graph: Sensorgraph, folder: Path) -> Sensorgraph:
    graph.save(folder / "g.sensorgraph")
    return Sensorgraph.load(folder / "g.sensorgraph")
