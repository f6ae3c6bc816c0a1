"""More scans of the same places: edges stay single, rare places stay in the draft, nothing gets worse."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from sensorgraph.models.faces.blurred_edges import pooled
from sensorgraph.models.faces.change_points import Crossings, _cost, _partition, fit_stretches
from sensorgraph.models.faces.fit import _thinned
from sensorgraph.models.faces.ray_march import FaceSet
from sensorgraph.models.faces.visibility import Rays
from sensorgraph.types import Floats

FACE = FaceSet(
    normals=np.array([[0.0, 1.0]]), offsets=np.zeros(1), first=np.array([0, 2]), edges=np.array([0.0, 1.0]),
    levels=np.array([1.0, 0.0]), blur=np.zeros(2), neighbour=np.full(2, -1),
)  # fmt: skip


def crossed(n: int, visible: Floats, edges: list[float], error: float, seed: int = 0) -> Crossings:
    """Crossings of one face with stretches of some visibility, whose places are logged with an error [m]."""
    rng = np.random.default_rng(seed)
    true = rng.uniform(0.0, 1.0, n)
    chance = visible[np.searchsorted(edges, true)]
    errors = error * rng.uniform(0.5, 2.0, n)  # near and far, head-on and grazing
    logged = true + errors * rng.normal(size=n)
    order = np.argsort(logged)
    stop = (rng.uniform(size=n) < chance).astype(float)
    return Crossings(logged[order], stop[order], np.ones(n), errors[order], np.array([0, n], dtype=np.intp))


@pytest.mark.parametrize("n", [2_000, 20_000, 100_000])
def test_an_edge_seen_from_noisy_poses_is_one_edge_however_many_rays_cross(n: int) -> None:
    found = fit_stretches(FACE, crossed(n, np.array([0.0, 0.998]), [0.4], 0.004))
    assert len(found.edges) == 3
    assert abs(found.edges[1] - 0.4) < 5 * found.blur[1]
    assert found.blur[1] < 0.003  # [m] less than one crossing's error
    assert found.levels[:2] == pytest.approx([0.0, 0.998], abs=0.01)


def test_more_crossings_know_an_edge_better() -> None:
    few, many = (
        fit_stretches(FACE, crossed(n, np.array([0.0, 0.998]), [0.4], 0.004)) for n in (2_000, 50_000)
    )
    assert many.blur[1] < few.blur[1] / 3  # five times, by the root of 25


def test_a_stretch_that_stops_every_other_ray_stays() -> None:
    found = fit_stretches(FACE, crossed(20_000, np.array([0.0, 0.5, 0.998]), [0.4, 0.5], 0.004))
    assert found.edges[1:3] == pytest.approx([0.4, 0.5], abs=0.003)
    assert found.levels[1] == pytest.approx(0.5, abs=0.05)  # 2,000 crossings: 0.011


def test_a_leg_narrower_than_a_few_errors_is_seen_as_often_as_it_is() -> None:
    found = fit_stretches(FACE, crossed(20_000, np.array([0.0, 0.998, 0.0]), [0.40, 0.42], 0.004))
    assert len(found.edges) == 4
    assert found.edges[1:3] == pytest.approx([0.40, 0.42], abs=0.002)
    assert found.levels[1] > 0.95


def test_exact_places_are_cut_as_they_stand() -> None:
    found = fit_stretches(FACE, crossed(2_000, np.array([0.0, 1.0]), [0.4], 0.0))
    assert found.edges[1] == pytest.approx(0.4, abs=0.002)  # 2,000 crossings on a metre


@pytest.mark.parametrize("chances", [(0.5, 0.5), (0.02, 0.9, 0.3)])
def test_a_partition_costs_no_more_than_any_other(chances: tuple[float, ...]) -> None:
    rng = np.random.default_rng(2)
    n, penalty = 240, 5.0
    weight = rng.uniform(0.2, 1.0, n)
    stop = (rng.uniform(size=n) < np.repeat(chances, n // len(chances))).astype(float)
    stops, weights = (np.concatenate([[0.0], np.cumsum(x)]) for x in (stop * weight, weight))

    def cost(a: int, b: int) -> float:
        return float(_cost(stops[b] - stops[a], weights[b] - weights[a]))

    least = [-penalty]
    for b in range(1, n + 1):
        least.append(min(least[a] + penalty + cost(a, b) for a in range(b)))
    cuts = _partition(stop, weight, penalty)
    found = sum(cost(a, b) for a, b in itertools.pairwise(cuts)) + penalty * (len(cuts) - 2)
    assert found == pytest.approx(least[-1], abs=1e-9)


def test_pooled_crossings_are_bounded_by_the_length_and_keep_the_sums() -> None:
    few, many = (crossed(n, np.array([0.0, 0.998]), [0.4], 0.004) for n in (200_000, 800_000))
    short, long = (pooled(*one.at(0)) for one in (few, many))
    assert len(long[0]) < 1.1 * len(short[0]) < 0.05 * 200_000
    t, stop, weight, error = long
    assert (np.diff(t) >= 0).all()
    assert weight.sum() == pytest.approx(many.weight.sum())
    for mean, each in ((t, many.t), (stop, many.stop), (error, many.error)):
        assert weight @ mean == pytest.approx(many.weight @ each)


def test_crossings_with_exact_places_are_not_pooled() -> None:
    one = crossed(2_000, np.array([0.0, 1.0]), [0.4], 0.0)
    np.testing.assert_allclose(pooled(*one.at(0))[0], one.t, atol=1e-12)  # m, rounding


def test_drafts_keep_places_that_were_passed_once() -> None:
    rng = np.random.default_rng(1)
    origins = np.concatenate([rng.uniform(0.0, 0.4, (20_000, 2)), [[5.2, 5.2]] * 50])
    turn = rng.uniform(-np.pi, np.pi, len(origins))
    rays = Rays(
        origins=origins,
        directions=np.column_stack([np.cos(turn), np.sin(turn)]),
        ranges=np.ones(len(origins)),
        range_max=8.0,
    )
    draft = _thinned(rays, 2_000)
    assert 1_900 < len(draft) <= 2_000
    assert (draft.origins[:, 0] > 5).sum() == 50


def test_crossings_without_weight_are_not_in_a_pool() -> None:
    t, error = np.array([0.0, 0.1, 0.5]), np.full(3, 0.004)
    place, stop, weight, _ = pooled(t, np.array([1.0, 0.0, 1.0]), np.array([1.0, 0.0, 2.0]), error)
    np.testing.assert_array_equal(place, [0.0, 0.5])
    np.testing.assert_array_equal(stop, [1.0, 1.0])
    np.testing.assert_array_equal(weight, [1.0, 2.0])
