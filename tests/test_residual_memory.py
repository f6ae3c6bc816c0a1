"""The memory of residuals: what places keep comes back from events and noise, and what is drawn keeps its chances."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import further
from scipy import stats

from logs.run import RangeSensor, Run
from sensorgraph.building.build import build
from sensorgraph.errors import SensorgraphError
from sensorgraph.graph import Sensorgraph
from sensorgraph.models.place_noise import places_of, squares
from sensorgraph.models.residual_memory import ResidualMemory

pytestmark = pytest.mark.usefixtures("trusted_scans")

N_RAYS = 12
N_SCANS = 4000
SIZES, LIFETIMES = np.array([0.1, 0.2, 0.4]), np.array([1.0, 10.0])
STAMPS = 0.1 * np.arange(N_SCANS)


def memory(events: float, noise: float, size: int = 2, lifetime: int = 2) -> ResidualMemory:
    shares = np.zeros((2, 3, 3))
    shares[:, size, lifetime] = events, noise
    return ResidualMemory(sizes=SIZES, lifetimes=LIFETIMES, events=shares[0], noise=shares[1])


def driven(n: int = N_SCANS) -> np.ndarray:
    """Return where rays end (n, n_rays, 3), four walls of 8 m that a robot goes up and down along, slowly drifting."""
    k = np.arange(n)
    x = np.abs((0.07 * k) % 16.0 - 8.0)
    ray = np.arange(N_RAYS)
    return np.stack(
        np.broadcast_arrays(x[:, None] + 0.05 * (ray % 3), 0.0004 * k[:, None] + 3.0 * (ray // 3), 0.3),
        axis=-1,
    )


def drawn(kept: ResidualMemory, places: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng([seed, 1])
    numbers = [
        kept.numbers(seed, t, there, rng.random(N_RAYS), rng.normal(size=N_RAYS))
        for t, there in zip(STAMPS.tolist(), places, strict=False)
    ]
    u, z = (np.array(part) for part in zip(*numbers, strict=True))
    return u, z


def test_drawn_numbers_keep_their_distribution_and_have_the_memory() -> None:
    rng = np.random.default_rng(1)
    places = np.dstack([rng.uniform(-50, 50, (N_SCANS, N_RAYS, 2)), rng.uniform(-3, 3, (N_SCANS, N_RAYS))])
    u, z = drawn(memory(0.6, 0.7), places, 3)
    assert stats.kstest(u[::5].ravel(), "uniform").pvalue > 1e-3
    assert stats.kstest(z[::5].ravel(), "norm").pvalue > 1e-3
    u, z = drawn(memory(0.6, 0.7), np.broadcast_to(places[0], places.shape), 3)
    assert (np.ptp(u, axis=0) == 0).mean() == pytest.approx(
        0.6, abs=0.3
    )  # such a share of the squares keeps all
    assert np.var(z - z.mean(axis=0)) == pytest.approx(0.3, abs=0.03)


def test_what_a_place_keeps_lasts_its_lifetime_whoever_comes_by() -> None:
    place = np.tile([1.234, 0.5, 0.3], (N_RAYS, 1))
    short = memory(0.98, 0.0, lifetime=0)  # 1 s
    fresh = np.full(N_RAYS, 0.5), np.zeros(N_RAYS)
    values = np.array([short.numbers(1, t, place, *fresh)[0][0] for t in np.arange(0, 100, 0.1)])
    assert np.array_equal(values, [short.numbers(1, t, place, *fresh)[0][3] for t in np.arange(0, 100, 0.1)])
    if not (values == 0.5).all():  # the square keeps something
        assert 95 <= len(np.unique(values)) <= 102
    assert short.numbers(2, 0.0, place, *fresh)[0][0] != values[0] or values[0] == 0.5


@pytest.mark.parametrize(("size", "lifetime"), [(2, 1), *further((2, 2), (0, 2))])
def test_planted_shares_come_back(size: int, lifetime: int) -> None:
    """The squares, their intervals and what they keep are written out here once more, with random numbers for hashes."""
    places, rng = driven(), np.random.default_rng(5)
    side, lasts = SIZES[size], [*LIFETIMES, 1e9][lifetime]
    key = squares(places, float(side))
    interval = np.floor(STAMPS / lasts)[:, None, None]
    whole = np.concatenate([key, np.broadcast_to(interval, (*key.shape[:2], 1))], axis=2).reshape(-1, 4)
    _, number = np.unique(whole, axis=0, return_inverse=True)
    n = int(number.max()) + 1
    is_kept, kept, offset = rng.random(n) < 0.5, rng.random(n), rng.normal(size=n)
    number = number.reshape(places.shape[:2])
    u = np.where(is_kept[number], kept[number], rng.random(number.shape))
    z = np.sqrt(0.5) * offset[number] + np.sqrt(0.5) * rng.normal(size=number.shape)
    found = ResidualMemory.fit(
        residual=0.01 * z,
        chance=np.full(u.shape, 0.5),
        event=(u < 0.5).astype(float),
        places=places,
        stamps=STAMPS,
    )
    for shares in (found.events, found.noise):
        assert shares.sum() == pytest.approx(0.5, abs=0.15)
        assert shares @ np.ones(len(found.lifetimes) + 1) @ np.log2(found.sizes / side) == pytest.approx(
            0, abs=0.7
        )
    lasting = found.noise[:, found.lifetimes.searchsorted(100.0) :].sum()
    assert lasting > 0.25 if lasts > 1e6 else lasting < 0.25


def test_white_residuals_have_no_memory() -> None:
    rng = np.random.default_rng(3)
    event = (rng.random((N_SCANS, N_RAYS)) < 0.2).astype(float)
    found = ResidualMemory.fit(
        residual=rng.normal(size=event.shape), chance=np.full(event.shape, 0.2), event=event,
        places=driven(), stamps=STAMPS,
    )  # fmt: skip
    assert found.events.sum() < 0.05
    assert found.noise.sum() < 0.05


def square_run(n: int) -> Run:
    """Rays in a room of 4 m whose walls waver by 1 cm."""
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
    ranges = np.minimum(to_x, to_y)
    ends = places_of(poses, sensor.bearings, ranges, 8.0)
    waver = 0.01 * np.sign(np.sin(20.0 * (ends[..., 0] + ends[..., 1])))
    return Run(
        sensor=sensor,
        stamps=t,
        ranges=ranges + waver + 0.002 * rng.normal(size=ranges.shape),
        pose_stamps=t,
        poses=poses,
    )


def test_graph_keeps_its_memory_in_the_file(tmp_path: Path) -> None:
    run = square_run(600)
    graph = build([run], model="polynomial", degree=2, harmonics=2)
    assert graph.memory is None
    wrong = replace(memory(0.5, 0.2), events=np.zeros((2, 3)))
    with pytest.raises(SensorgraphError, match=r"memory\.events has shape"):
        _save_and_load(replace(graph, memory=wrong), tmp_path)
    with pytest.raises(SensorgraphError, match=r"the sum of memory\.noise"):
        _save_and_load(replace(graph, memory=replace(memory(0.5, 0.2), noise=np.full((3, 3), 0.2))), tmp_path)
    fitted = build([run], model="polynomial", degree=6, harmonics=6, n_terms=60, memory=True)
    assert fitted.memory is not None
    again = _save_and_load(fitted, tmp_path)
    assert again.memory is not None
    for name, array in fitted.memory.arrays().items():
        assert np.array_equal(array, again.memory.arrays()[name])
    assert "places keep" in fitted.facts()["memory"]


def test_too_few_readings_have_no_memory() -> None:
    with pytest.raises(SensorgraphError, match="training readings are too few to identify a `memory`"):
        build([square_run(200)], model="polynomial", degree=2, harmonics=2, memory=True)


def _save_and_load(graph: Sensorgraph, folder: Path) -> Sensorgraph:
    graph.save(folder / "g.sensorgraph")
    return Sensorgraph.load(folder / "g.sensorgraph")
