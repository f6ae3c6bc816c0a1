"""A person is narrow and walks; reflections, stuck rays, floors, wrapped ranges and standing objects follow other laws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_diagnosis_commissioning import ARENA, ROBOT, SENSOR, ranges_in

from logs.run import Run
from planners.types import Floats
from sensorgraph.diagnosis.scan.fit import fit, start_state
from sensorgraph.diagnosis.scan.residuals import FitResiduals
from sensorgraph.diagnosis.scan.scan_data import prepare_scans
from sensorgraph.diagnosis.scan.settings import SCAN
from sensorgraph.diagnosis.scan.unnamed.absorbed_readings import (
    CAUSES,
    PEOPLE,
    STRAYS,
    OddReadings,
    better_law,
    law_scores,
)
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
    view = FitResiduals(data, fit(data, (), start_state(data, SCAN.noise), SCAN.noise))
    return view, view.short & (np.abs(view.z - before[np.isin(T, data.stamps)]) < 0.1)


def outliers(seed: int) -> Floats:
    """One ray in thirty reads anything short of the wall, independent of all others."""
    rng = np.random.default_rng(seed)
    z = ranges_in(ARENA, POSES[:, :2], ANGLE)
    return np.where(rng.random(z.shape) < 0.03, rng.uniform(0.05, 1.0, z.shape) * z, np.inf)


@pytest.mark.parametrize("before", [walker(), passes_once(2.0)], ids=["walks up and down", "passes once"])
def test_a_walking_person_may_be_people(before: Floats) -> None:
    view, short = short_readings(before)
    assert short.sum() > 50
    assert better_law(view, short, PEOPLE) == ("", ())
    reason, causes = better_law(view, short, STRAYS)
    assert "the next scan shows again" in reason
    assert causes == CAUSES[PEOPLE]


def test_independent_outliers_may_be_random_and_are_not_people() -> None:
    view, short = short_readings(outliers(6))
    assert short.sum() > 300
    assert better_law(view, short, STRAYS) == ("", ())
    assert "does not show them again" in better_law(view, short, PEOPLE)[0]


@pytest.mark.parametrize(
    ("before", "words", "law"),
    [
        (own_light(np.random.default_rng(2)), "most of them at 0.57 m", "range"),
        (stuck(ANGLE), "repeat the previous scan", "repeated"),
        (ghosts(np.random.default_rng(1)), "most of them at", "range"),
        (rare_ghosts(np.random.default_rng(5)), "most of them at", "range"),
        (steam(np.random.default_rng(4)), "at the same places", "standing"),
        (floor(), "too wide for a person", "wide"),
        (pushed(), "at the same places", "standing"),
        (chairs(), "at the same places", "standing"),
        (wrapped(), "most of them by 1.5", "wrapped"),
    ],
    ids=[
        "the robot's own light",
        "rays that stick",
        "ghosts",
        "rare ghosts",
        "steam",
        "floor",
        "pushed there half-way",
        "thin legs",
        "wrapped",
    ],
)
def test_readings_that_follow_another_law_are_not_people(before: Floats, words: str, law: str) -> None:
    reason, causes = better_law(*short_readings(before), PEOPLE)
    assert words in reason
    assert causes == CAUSES[law]


def test_the_statement_says_where_something_stands() -> None:
    reason, _ = better_law(*short_readings(pushed()), PEOPLE)
    x, y = (float(v) for v in reason.split("most at (")[1].split(")")[0].split(", "))
    assert np.hypot(x - 1.3, y - 3.2) < 0.35  # a disc of 0.4 m, and a cell of 0.5 m


def test_coarse_readings_that_coincide_are_not_repeated_ones() -> None:
    """With steps of 5 cm, a person who stands in front of a ray gives the same reading twice."""
    view, short = short_readings(walker())
    coarse = replace(view.data.sensor, resolution=0.05)
    view.data, view.sensor, view.z = replace(view.data, sensor=coarse), coarse, np.round(view.z / 0.05) * 0.05
    scores = law_scores(view, OddReadings.of(view, short))
    assert scores["repeated"] < scores[PEOPLE] - 3


def test_the_score_does_not_grow_with_the_number_of_rays() -> None:
    """OddReadings of one second belong to few objects: half of the rays bring about the same evidence."""
    view, short = short_readings(walker())
    half = short & (np.arange(short.shape[1]) % 2 == 0)
    whole, part = (law_scores(view, OddReadings.of(view, some))[PEOPLE] for some in (short, half))
    assert part == pytest.approx(whole, rel=0.1)
