"""Every effect of the scan channel does what its sentence says: closed forms in a rectangle, no ray caster used."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from effects_samples import (
    BOX,
    LOWER,
    SENSOR,
    SPAN,
    STAMPS,
    TURN,
    UPPER,
    arena,
    hit_at,
    lasers,
    motion,
    scene,
    to_walls,
)  # fmt: skip

from logs.run import RangeSensor
from planners.types import Bools, Floats
from sensorgraph.effects import EFFECTS, Amendment
from sensorgraph.effects.mixed_pixels import N_SPREAD
from sensorgraph.world.raycast import cast
from sensorgraph.world.scene import Scene, draw_readings

TIGHT = 1e-9  # [m] float64 at 10 m, through a few sines
B = SENSOR.bearings
N = SENSOR.n_rays
IDEAL, COSINE = to_walls(lasers())
EAST = "room/edge_1"  # x = 6, from y = 0 to y = 5
Law = tuple[Amendment, Floats]


def effect(name: str, place: str = "", **values: float) -> Amendment:
    made = EFFECTS[name](**values)
    return made.at(place) if place else made


def on_east(first: float, last: float, ranges: Floats = IDEAL) -> Bools:
    """Tell which rays end on the east wall between two heights."""
    x, y = hit_at(lasers(), ranges)
    return (np.abs(x - 6) < 1e-6) & (y > first) & (y < last)


def test_without_effects_a_scene_is_the_room() -> None:
    beams = scene().run()
    np.testing.assert_allclose(beams.reading, IDEAL, atol=TIGHT)
    np.testing.assert_allclose(beams.cosine, COSINE, atol=TIGHT)


def range_bias() -> Law:
    return effect("range_bias", b=0.03), IDEAL + 0.03


def range_scale() -> Law:
    return effect("range_scale", s=-0.01), 0.99 * IDEAL


def sector_bias() -> Law:
    return effect("sector_bias", theta1=-0.5, theta2=0.3, b=0.04), IDEAL + 0.04 * ((B > -0.51) & (B < 0.31))


def sector_bias_through_the_back() -> Law:
    return effect("sector_bias", theta1=1.5, theta2=-1.5, b=0.04), IDEAL + 0.04 * (np.abs(B) > 1.49)


def mount_yaw() -> Law:
    return effect("mount_yaw", delta=0.05), to_walls(lasers(), B + 0.05)[0]


def mount_xy() -> Law:
    return effect("mount_xy", dx=0.04, dy=-0.03), to_walls(lasers(shift=(0.04, -0.03, 0.0)))[0]


def latency() -> Law:
    return effect("latency", tau=0.07), to_walls(lasers(STAMPS[:, None] - 0.07))[0]


def scan_skew() -> Law:
    return effect("scan_skew", T=0.1), to_walls(lasers(STAMPS[:, None] + 0.1 * np.arange(N) / N))[0]


def glass() -> Law:
    through = on_east(1.0, 4.0) & (np.arccos(COSINE) >= 0.4)
    return (
        effect("glass", EAST, a=1.0, b=4.0, alpha_ret=0.4, depth=1.5),
        np.where(through, to_walls(lasers(), upper=[7.5, 5.0])[0], IDEAL),
    )


def glass_before_nothing() -> Law:
    through = on_east(1.0, 4.0) & (np.arccos(COSINE) >= 0.4)
    return effect("glass", EAST, a=1.0, b=4.0, alpha_ret=0.4, depth=0.0), np.where(through, np.inf, IDEAL)


def mirror() -> Law:
    mirrored, _ = to_walls(lasers(), upper=[12.0, 5.0])  # the room and its image
    return effect("mirror", EAST, a=1.0, b=4.0), np.where(on_east(1.0, 4.0), mirrored, IDEAL)


def moved_wall() -> Law:
    return effect("moved_wall", EAST, d=0.12), to_walls(lasers(), upper=[6.12, 5.0])[0]


def moved_wall_inward() -> Law:
    return effect("moved_wall", "room/edge_0", d=-0.12), to_walls(lasers(), lower=[0.0, 0.12])[0]


def map_scale() -> Law:
    middle, shift = (LOWER + UPPER) / 2, np.array([0.01, -0.02])
    return (
        effect("map_scale", s=0.02, dx=0.01, dy=-0.02),
        to_walls(lasers(), lower=middle - 1.02 * middle + shift, upper=middle + 1.02 * middle + shift)[0],
    )


def range_drift() -> Law:
    return effect("range_drift", b1=0.1, tau=0.0), IDEAL + 0.1 * STAMPS[:, None] / SPAN


def range_drift_of_a_warm_up() -> Law:
    return effect("range_drift", b1=0.1, tau=4.0), IDEAL + 0.1 * (1 - np.exp(-STAMPS[:, None] / 4))


def self_occlusion() -> Law:
    return effect("self_occlusion", r0=0.3, theta1=-0.5, theta2=0.3), np.where(
        (B > -0.51) & (B < 0.31), 0.3, IDEAL
    )


def tilt() -> Law:
    """Turn the rays of a level plane about the horizontal axis across 0.4 rad, as vectors."""
    beta, deepest = 0.1, 0.4
    ahead = np.array([np.cos(deepest), np.sin(deepest), 0.0])
    axis = np.array([np.sin(deepest), -np.cos(deepest), 0.0])
    rays = np.stack([np.cos(B), np.sin(B), 0 * B], axis=1)
    dipped = np.outer(rays @ axis, axis) + np.outer(rays @ ahead, np.cos(beta) * ahead - [0, 0, np.sin(beta)])
    level = np.hypot(dipped[:, 0], dipped[:, 1])
    walls, _ = to_walls(lasers(), np.arctan2(dipped[:, 1], dipped[:, 0]))
    with np.errstate(divide="ignore"):
        floor = np.where(dipped[:, 2] < 0, SENSOR.height / np.maximum(-dipped[:, 2], 1e-15), np.inf)
    return effect("tilt", beta=beta, theta0=deepest), np.minimum(walls / level, floor)


def unmapped_obstacle() -> Law:
    x, y, phi = lasers()
    ahead = (3.5 - x) * np.cos(phi + B) + (1.0 - y) * np.sin(phi + B)
    aside = (3.5 - x) * np.sin(phi + B) - (1.0 - y) * np.cos(phi + B)
    meets = (np.abs(aside) < 0.25) & (ahead > 0)
    disc = np.where(meets, ahead - np.sqrt(np.maximum(0.25**2 - aside**2, 0.0)), np.inf)
    return effect("unmapped_obstacle", x=3.5, y=1.0, r=0.25), np.minimum(IDEAL, disc)


LAWS: tuple[Callable[[], Law], ...] = (
    range_bias, range_scale, sector_bias, sector_bias_through_the_back, mount_yaw, mount_xy, latency, scan_skew,
    glass, glass_before_nothing, mirror, moved_wall, moved_wall_inward, map_scale, range_drift,
    range_drift_of_a_warm_up, self_occlusion, tilt, unmapped_obstacle,
)  # fmt: skip


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
def test_readings_follow_the_closed_form(law: Callable[[], Law]) -> None:
    amendment, expected = law()
    assert (np.abs(np.where(np.isinf(expected), 9.0, expected) - IDEAL) > 0.01).any(), (
        "the law shows in this run"
    )
    reading = scene().run([amendment]).reading
    np.testing.assert_allclose(reading, expected, atol=1e-5 if amendment.name == "mirror" else TIGHT)


def test_a_moved_obstacle_is_the_room_with_the_obstacle_elsewhere() -> None:
    (x0, y0), (x1, y1) = BOX
    elsewhere = arena(((x0 + 0.1, y0 - 0.2), (x1 + 0.1, y1 - 0.2)))
    reading = scene(box=True).run([effect("moved_obstacle", "box", dx=0.1, dy=-0.2)]).reading
    np.testing.assert_allclose(reading, cast(elsewhere, motion(STAMPS), SENSOR).ranges, atol=TIGHT)


def test_a_missing_obstacle_leaves_the_empty_room() -> None:
    reading = scene(box=True).run([effect("missing_obstacle", "box")]).reading
    np.testing.assert_allclose(reading, IDEAL, atol=TIGHT)


CHANCES: dict[str, tuple[Amendment, Floats, Bools]] = {
    "black_surface": (
        effect("black_surface", EAST, a=1.0, b=4.0, r0=2.5),
        np.where(on_east(1.0, 4.0), np.minimum(1.0, COSINE * (2.5 / IDEAL) ** 2), 1.0),
        np.ones_like(on_east(0, 1)),
    ),
    "incidence_dropout": (
        effect("incidence_dropout", alpha_max=0.7),
        1.0 * (np.arccos(COSINE) < 0.7),
        np.abs(np.arccos(COSINE) - 0.7) > 0.012,
    ),
    "max_range": (effect("max_range", R=3.0), 1.0 * (IDEAL < 3.0), np.abs(IDEAL - 3.0) > 0.05),
    "min_range": (effect("min_range", r_min=1.5), 1.0 * (IDEAL > 1.5), np.abs(IDEAL - 1.5) > 0.05),
}
"""Effect, chance of a return, and where the law is sharp enough to be tested."""


@pytest.mark.parametrize("name", CHANCES)
def test_rays_return_as_often_as_said(name: str) -> None:
    amendment, chance, sharp = CHANCES[name]
    there = scene()
    beams = there.run([amendment])
    np.testing.assert_allclose(np.broadcast_to(beams.p_return, IDEAL.shape)[sharp], chance[sharp], atol=1e-4)
    np.testing.assert_allclose(beams.reading, IDEAL, atol=TIGHT)
    rng = np.random.default_rng(0)
    seen = np.mean([np.isfinite(draw_readings(there, rng)) for _ in range(20)], axis=0)
    spread = np.sqrt((chance * (1 - chance))[sharp].sum() / 20) + 1.0  # of the count of returns
    assert abs(seen[sharp].sum() - chance[sharp].sum()) < 4 * spread


def test_noise_grows_with_the_range() -> None:
    there = scene()
    there.run([effect("range_noise", k=0.02)])
    rng = np.random.default_rng(0)
    off = np.array([draw_readings(there, rng) for _ in range(200)]) - IDEAL
    expected = np.sqrt(SENSOR.sigma**2 + (0.02 * IDEAL) ** 2)
    assert (off.std(axis=0) / expected).mean() == pytest.approx(1.0, abs=0.01)
    assert np.abs(off.std(axis=0) / expected - 1).max() < 0.3  # 200 draws: 5 % each


def test_readings_stand_on_the_lattice() -> None:
    there = scene()
    there.run([effect("quantisation", q=0.04)])
    readings = draw_readings(there, np.random.default_rng(0))
    np.testing.assert_allclose(readings / 0.04, np.round(readings / 0.04), atol=1e-9)
    assert np.abs(readings - IDEAL).max() < 0.02 + 5 * SENSOR.sigma


def test_outliers_are_uniform_and_as_many_as_said() -> None:
    there = scene()
    there.run([effect("random_outliers", p=0.2)])
    readings = draw_readings(there, np.random.default_rng(0))
    stray = np.abs(readings - IDEAL) > 6 * SENSOR.sigma
    assert stray.mean() == pytest.approx(0.2, abs=0.025)  # 3321 rays: 0.7 %
    values = np.where(np.isfinite(readings), readings, 0.0)[stray]
    assert values.mean() == pytest.approx(SENSOR.range_max / 2, rel=0.06)
    assert values.max() > 0.98 * SENSOR.range_max


def test_the_likelihood_of_people_is_a_share_of_short_readings() -> None:
    there = scene()
    there.run([effect("people", p=0.1)])
    readings = draw_readings(there, np.random.default_rng(0))
    short = readings < IDEAL - 6 * SENSOR.sigma
    assert there.movers.shape[1] == 0
    assert short.mean() == pytest.approx(0.1, abs=0.02)


def beam_mean(there: Scene, gamma: float, n: int = 401) -> tuple[Floats, Floats, Floats]:
    """Return mean, least and greatest range over the beam, by many rays."""
    parts = np.array([
        cast(there.arena, motion(STAMPS), replace(SENSOR, bearings=B + gamma * s)).ranges
        for s in (2 * np.arange(n) + 1) / n - 1
    ])  # fmt: skip
    return parts.mean(axis=0), parts.min(axis=0), parts.max(axis=0)


def test_a_wide_beam_reads_the_mean_at_edges_and_the_wall_elsewhere() -> None:
    gamma = 0.03
    there = scene(box=True)
    beams = there.run([effect("mixed_pixels", gamma=gamma)])
    mean, least, greatest = beam_mean(there, gamma)
    edge = ~np.asarray(beams.straight)
    assert 5 < edge.sum() < 200
    step = greatest - least
    assert (np.abs(beams.reading - mean)[edge] <= step[edge] / N_SPREAD).all()
    between = edge & (np.abs(mean - least) > step / 4) & (np.abs(mean - greatest) > step / 4)
    assert between.any()
    assert ((beams.reading > least) & (beams.reading < greatest))[between].all()
    np.testing.assert_array_equal(beams.reading[~edge], beams.ranges[~edge])
    corners = np.array(
        [(x, y) for low, high in [(LOWER, UPPER), BOX] for x in (low[0], high[0]) for y in (low[1], high[1])]
    )
    lx, ly, phi = lasers()
    to_corner = np.arctan2(corners[:, 1] - ly, corners[:, 0] - lx)[..., None, :] - (phi + B)[..., None]
    near = np.abs((to_corner + np.pi) % (2 * np.pi) - np.pi).min(axis=-1) < gamma
    assert (near | ~edge).all(), "edges are at corners only"


@pytest.mark.parametrize("sensor", [SENSOR, TURN], ids=["part", "full turn"])
def test_a_sonar_reads_the_perpendicular_while_its_cone_holds_it(sensor: RangeSensor) -> None:
    """Before a wall at distance d the nearest point of the cone is the foot of the perpendicular."""
    there = scene(sensor)
    gamma = 0.3
    beams = there.run([effect("sonar_cone", gamma=gamma, alpha_max=1.5707963)])
    x, y, phi = lasers()
    fans = np.linspace(-gamma, gamma, 601)
    nearest = np.min([to_walls((x, y, phi + fan), there.bearings)[0] for fan in fans], axis=0)
    assert (beams.reading - nearest).min() > -1e-4  # [m] of the 601 rays here
    assert (beams.reading / nearest).max() < 1.005  # the cone is filled every 1.5 degrees
    west = np.abs((phi + there.bearings - np.pi + np.pi) % (2 * np.pi) - np.pi) < gamma
    close = west & (x < np.minimum(y, 5 - y) - 0.05)
    assert close.any()
    np.testing.assert_allclose(
        beams.reading[close], np.broadcast_to(x, close.shape)[close], rtol=2e-4
    )  # 1 / cos(0.75 degrees)


@pytest.mark.parametrize(
    "bearings",
    [np.linspace(-1.2, 1.2, 401), np.linspace(-np.pi, np.pi, 240, endpoint=False)],
    ids=["part", "full turn"],
)
def test_the_cones_of_a_sweeping_laser_may_share_rays(bearings: Floats) -> None:
    """Plainly, all rays of a cone start at the time of its axis; rays of neighbours are a little early or late."""
    gamma, sweeping = 0.4, replace(SENSOR, bearings=bearings, sweep_time=0.1)
    cone = effect("sonar_cone", gamma=gamma, alpha_max=1.5707963)
    there = scene(sweeping)
    plain = np.min([there.shoot(offset).ranges for offset in np.linspace(-gamma, gamma, 161)], axis=0)
    shared, at_once = (
        scene(one).run([cone]).reading for one in (sweeping, replace(sweeping, sweep_time=0.0))
    )
    errors, of_still = np.abs(shared - plain), np.abs(at_once - plain)
    assert np.median(errors) < np.median(of_still) / 5
    assert np.quantile(errors, 0.9) < np.quantile(of_still, 0.9) / 4


def test_a_sonar_loses_walls_that_it_meets_slanting() -> None:
    gamma, alpha_max = 0.2, 0.3
    there = scene()
    beams = there.run([effect("sonar_cone", gamma=gamma, alpha_max=alpha_max)])
    x, y, phi = lasers()
    best = np.full(IDEAL.shape, np.inf)
    for fan in np.linspace(-gamma, gamma, 601):
        r, cosine = to_walls((x, y, phi + fan))
        best = np.where(np.arccos(cosine) <= alpha_max, np.minimum(best, r), best)
    assert np.isinf(best).mean() > 0.05
    assert (np.isinf(best) == np.isinf(beams.reading)).mean() > 0.98  # but at the rim of the cone
    both = np.isfinite(best) & np.isfinite(beams.reading)
    assert (beams.reading[both] / best[both]).max() < 1.02


def test_every_effect_of_the_scan_channel_has_a_law_here() -> None:
    tested = {law()[0].name for law in LAWS} | set(CHANCES)
    own = {
        "moved_obstacle", "missing_obstacle", "range_noise", "quantisation", "random_outliers", "people",
        "mixed_pixels", "sonar_cone",
    }  # fmt: skip
    assert tested | own == {name for name, e in EFFECTS.items() if e.channel == "scan"}
