"""Somebody is as wide as a body, walks, and stays in the room when the robot turns; ghosts, stuck rays and floors do not."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from test_diagnosis_commissioning import ARENA, ROBOT, SENSOR, ranges_in

from logs.run import Run
from planners.types import Floats
from sensorgraph.diagnosis.scan.fit import fit, start_state
from sensorgraph.diagnosis.scan.people_law import (
    clustered,
    clusters_of,
    least_clustered,
    repeated_share,
    where_things_stand,
    why_not_people,
)
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.scan_data import prepare_scans
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.types import Bools

T = np.arange(300) * 0.1
POSES = np.stack([2.2 + np.sin(0.2 * T), 2.4 + 0.8 * np.cos(0.17 * T), 0.013 + 2.5 * np.sin(0.4 * T)], axis=1)
ANGLE = POSES[:, 2:] + SENSOR.bearings


def disc(x: Floats, y: Floats, r: float) -> Floats:
    """Return the range (n_scans, n_rays) [m] to a disc that is at (x, y) (n_scans,) [m]; inf where a ray misses it."""
    dx, dy = (x - POSES[:, 0])[:, None], (y - POSES[:, 1])[:, None]
    ahead, aside = dx * np.cos(ANGLE) + dy * np.sin(ANGLE), dx * np.sin(ANGLE) - dy * np.cos(ANGLE)
    with np.errstate(invalid="ignore"):
        face = ahead - np.sqrt(r**2 - aside**2)
    return np.where((np.abs(aside) < r) & (face > 0.2), face, np.inf)


def walker() -> Floats:
    """Somebody who walks up and down the room, 0.8 m/s."""
    way = 2.0 * np.abs((0.4 * T) % 2 - 1)
    return disc(1.0 + way, np.full(len(T), 3.2), 0.2)


def stuck(z: Floats) -> Floats:
    """Six rays repeat for five seconds what they read when somebody stood before them."""
    out = np.full(z.shape, np.inf)
    for first, ray, r in ((20, 10, 0.42), (90, 30, 0.55), (160, 44, 0.68), (230, 20, 0.81)):
        out[first : first + 50, ray : ray + 6] = r
    return out


def ghosts(rng: np.random.Generator) -> Floats:
    """Three rays side by side read what a second laser sends, anywhere and for one scan."""
    out = np.full(ANGLE.shape, np.inf)
    for k in range(len(T)):
        ray = rng.integers(0, SENSOR.n_rays - 3)
        out[k, ray : ray + 3] = rng.uniform(0.4, 2.0)
    return out


def rare_ghosts(rng: np.random.Generator) -> Floats:
    """An arc of twelve rays reads what a second laser sends, anywhere, in one scan of fifteen."""
    out = np.full(ANGLE.shape, np.inf)
    for k in range(0, len(T), 15):
        ray = rng.integers(0, SENSOR.n_rays - 12)
        out[k, ray : ray + 12] = rng.uniform(0.6, 1.8)
    return out


def turning_ghosts() -> Floats:
    """A second laser's ghosts: some rays side by side, at a range and a bearing that wander in the frame of the robot."""
    bearing = 1.2 * np.sin(0.9 * T)[:, None]
    r = 0.7 + 0.5 * ((0.4 * T) % 1)[:, None]
    beside = np.abs(SENSOR.bearings - bearing) < 0.12
    return np.where(beside, r, np.inf)


def door() -> Floats:
    """A leaf of 0.7 m that swings to and fro in every other eight seconds, and is out of sight meanwhile."""
    turn = -0.9 + 0.8 * np.sin(1.3 * T)
    leaf = [disc(1.1 + d * np.cos(turn), 3.3 + d * np.sin(turn), 0.06) for d in np.linspace(0, 0.7, 9)]
    return np.where((T % 8 < 4)[:, None], np.min(leaf, axis=0), np.inf)


def own_light(rng: np.random.Generator) -> Floats:
    """Three rays side by side read the robot's own light, reflected: at one range, all the time."""
    out = np.full(ANGLE.shape, np.inf)
    for k in range(len(T)):
        ray = rng.integers(0, SENSOR.n_rays - 3)
        out[k, ray : ray + 3] = 0.57
    return out


def passes_once(seconds: float) -> Floats:
    """Somebody goes round the robot once, 0.7 m away, and is gone."""
    since = T - 12.0
    around = POSES[:, 2] + 1.2 * (since - 0.5 * seconds)
    d = np.where((since > 0) & (since < seconds), 0.7, np.inf)
    with np.errstate(invalid="ignore"):
        return disc(POSES[:, 0] + d * np.cos(around), POSES[:, 1] + d * np.sin(around), 0.13)


def steam(rng: np.random.Generator) -> Floats:
    """A cloud comes up at one place for two seconds in six, and rays end somewhere within it."""
    cloud = disc(np.full(len(T), 1.2), np.full(len(T), 3.2), 0.35)
    blows = (T % 6 < 2)[:, None]
    return np.where(blows, cloud + rng.uniform(0.0, 0.4, size=cloud.shape), np.inf)


def floor() -> Floats:
    """Half of the rays meet the floor ahead, while the robot is on a ramp."""
    on_ramp = (np.arange(len(T)) % 100 < 25)[:, None]
    ahead = np.abs(SENSOR.bearings) < 0.8
    return np.where(on_ramp & ahead, 1.1 / np.cos(SENSOR.bearings), np.inf)


def pushed() -> Floats:
    """Somebody pushes a round thing to where it stands for the second half of the run."""
    return np.where((T > 15.0)[:, None], disc(np.full(len(T), 1.3), np.full(len(T), 3.2), 0.2), np.inf)


def chairs() -> Floats:
    """Legs of chairs, which somebody drags elsewhere half-way."""
    rng, out = np.random.default_rng(3), np.full(ANGLE.shape, np.inf)
    for _ in range(3):
        k = (T > 15.0).astype(int)
        x, y = rng.uniform(0.6, 3.4, 2)[k], rng.uniform(2.8, 3.4, 2)[k]
        out = np.minimum(out, disc(x, y, 0.05))
    return out


def wrapped() -> Floats:
    """A phase that begins anew after 1.5 m."""
    z = ranges_in(ARENA, POSES[:, :2], ANGLE)
    return np.where((z > 1.6) & (z < 2.2), z - 1.5, np.inf)


def short_readings(before: Floats) -> tuple[FitResiduals, Bools]:
    """Let something stand before the walls, and return what a fit of the room takes for short."""
    rng = np.random.default_rng(4)
    z = ranges_in(ARENA, POSES[:, :2], ANGLE)
    z = np.minimum(z, before) + rng.normal(size=z.shape) * 0.01 * np.isfinite(z)
    repeats = np.isfinite(before) & (before == np.roll(before, 1, axis=0))
    z = np.round(np.where(repeats & (before < 0.9), before, z), 3)
    run = Run(sensor=SENSOR, stamps=T, ranges=z, pose_stamps=T, poses=POSES, pose_frame="laser")
    data, _ = prepare_scans(run, ARENA, ROBOT)
    view = FitResiduals(data, fit(data, (), start_state(data, SCAN.noise), SCAN.noise, outer=1, inner=3))
    return view, view.short & (np.abs(view.z - before[np.isin(T, data.stamps)]) < 0.1)


def test_somebody_who_walks_up_and_down_may_be_people() -> None:
    view, short = short_readings(walker())
    assert short.sum() > 300
    assert why_not_people(view, short) == ("", ())


def test_somebody_who_passes_once_at_one_range_may_be_people() -> None:
    view, short = short_readings(passes_once(2.0))
    z = view.z[short]
    assert short.sum() > 50
    assert np.median(np.abs(z - np.median(z))) < 0.04  # one range, as what is reflected has
    assert why_not_people(view, short) == ("", ())


@pytest.mark.parametrize(
    ("before", "words"),
    [
        (own_light(np.random.default_rng(2)), "most of them at 0.57 m"),
        (stuck(ANGLE), "repeat the previous scan"),
        (ghosts(np.random.default_rng(1)), "of these objects again"),
        (steam(np.random.default_rng(4)), "m of (1.2, 3."),
        (rare_ghosts(np.random.default_rng(5)), "of these objects again"),
        (turning_ghosts(), "turn and move with the robot"),
        (door(), "people would also be seen elsewhere"),
        (floor(), "too wide for a person"),
        (pushed(), "a standing object is not a person"),
        (chairs(), "a standing object is not a person"),
        (wrapped(), "most of them by 1.5"),
    ],
    ids=[
        "the robot's own light",
        "rays that stick",
        "ghosts",
        "steam",
        "rare ghosts",
        "ghosts in the frame of the robot",
        "a door",
        "floor",
        "pushed there half-way",
        "thin legs",
        "wrapped",
    ],
)
def test_what_shortens_readings_otherwise_is_no_people(before: Floats, words: str) -> None:
    reason, causes = why_not_people(*short_readings(before))
    assert words in reason
    assert causes


def test_where_readings_end_again_and_again_something_stands_and_its_place_is_told() -> None:
    legs = [(0.9, 3.1), (1.1, 3.3), (3.0, 3.2)]
    there = [disc(np.full(len(T), x), np.full(len(T), y), 0.05) for x, y in legs]
    view, short = short_readings(np.minimum.reduce(there))
    told = where_things_stand(view, short)
    place = re.search(r"most at \((-?\d+\.\d), (-?\d+\.\d)\) m", told)
    assert place is not None
    x, y = (float(v) for v in place.groups())
    assert min(np.hypot(x - cx, y - cy) for cx, cy in legs) < 0.5
    assert where_things_stand(*short_readings(ghosts(np.random.default_rng(3)))) == ""


def test_coarse_steps_repeat_by_chance_and_are_not_counted() -> None:
    view, short = short_readings(walker())
    coarse = replace(view.data, sensor=replace(view.data.sensor, resolution=0.05))
    rng = np.random.default_rng(0)
    view.data, view.z = coarse, np.round((1.0 + rng.normal(size=view.z.shape) * 0.01) / 0.05) * 0.05
    assert repeated_share(view, np.ones_like(short)) == 0.0


def test_a_cluster_is_as_wide_as_what_it_shows() -> None:
    view, short = short_readings(walker())
    things = clusters_of(view, short)
    assert things.n_rays.sum() == short.sum()
    assert things.width.max() < 0.45  # a disc of 0.4 m
    near = np.abs(things.xy[things.n_rays > 3, 1] - 3.2)
    assert near.max() < 0.25  # the middle of its visible side


def test_legs_far_off_need_fewer_neighbours_and_scattered_rays_never_pass() -> None:
    view, _ = short_readings(walker())
    rng = np.random.default_rng(3)
    spacing = float(np.median(np.diff(SENSOR.bearings)))
    leg = SCAN.goodness_of_fit.leg_width
    for rays in (0.9, 1.3, 1.7, 3.0):  # that a leg is wide, at this range
        r = leg / (rays * spacing)
        first = rng.uniform(0, 1, 20_000)  # from the left end of the leg to its first ray
        count = np.floor(rays - first).astype(int) + 1
        met = np.repeat(count, np.maximum(count, 0))  # by each ray that meets one, how many do
        view.z = np.full(view.z.shape, r)
        some = np.zeros(view.z.shape, dtype=np.bool_)
        some[::40, 0] = True
        least = least_clustered(view, some)
        share = float(np.mean(met >= 2)) if len(met) else 0.0
        by_chance = 4 * float(some.mean())
        half = SCAN.goodness_of_fit.min_clustered_share
        assert least == pytest.approx(max(half * share, by_chance), abs=0.01)
    scattered = rng.random(view.z.shape) < 0.03
    view.z = np.where(scattered, rng.uniform(0.5, 3.0, view.z.shape), view.z)
    assert clustered(view, scattered) < least_clustered(view, scattered)
