"""CARMEN and Wean Hall logs: layouts, clocks, no-return codes, and whose poses these are."""

from __future__ import annotations

import bz2
import gzip
from pathlib import Path

import numpy as np
import pytest
from conftest import further
from hypothesis import given
from hypothesis import strategies as st
from logs_samples import DATA

import logs
from logs.no_return import find_code


def flaser(
    ranges: np.ndarray, t: float, *, laser: tuple[float, ...] = (0, 0, 0), robot: tuple[float, ...] = (0, 0, 0),
    logger: float | None = None, word: str = "FLASER",
) -> str:  # fmt: skip
    shown = " ".join(f"{value:.2f}" for value in ranges)
    poses = " ".join(map(str, (*laser, *robot)))
    return f"{word} {len(ranges)} {shown} {poses} {t} host {t if logger is None else logger}"


def write(path: Path, lines: list[str]) -> Path:
    path.write_text("# message formats defined: PARAM FLASER\n## comment\n" + "\n".join(lines) + "\n")
    return path


def walk(n: int = 6, n_rays: int = 181) -> list[str]:
    rng = np.random.default_rng(0)
    return [flaser(rng.uniform(1, 9, n_rays), i / 2, laser=(i, 0, 0.1), robot=(i, 0, 0.1)) for i in range(n)]


@pytest.mark.parametrize(
    ("n_rays", "first", "last"),
    [(180, -90, 89), (181, -90, 90), (360, -90, 89.5), (361, -90, 90), (401, -50, 50), (541, -135, 135),
     (1081, -135, 135), (7, -90, 90)],
)  # fmt: skip
def test_count_of_rays_tells_the_bearings(tmp_path: Path, n_rays: int, first: float, last: float) -> None:
    run = logs.read(write(tmp_path / "a.log", walk(n_rays=n_rays)))
    np.testing.assert_allclose(np.degrees(run.sensor.bearings[[0, -1]]), [first, last], atol=1e-9)
    assert run.sensor.is_evenly_spaced


def test_robotlaser_brings_its_own_geometry_and_poses(tmp_path: Path) -> None:
    line = (
        "ROBOTLASER1 1 -1.0 2.0 0.5 30.0 0.01 0 5 1.0 2.0 30.0 4.0 5.0 2 7 7 "
        "1.2 0 0 1.0 0 0 0.3 0.1 0 0 0 100.5 host 0.5"
    )
    run = logs.read(write(tmp_path / "a.log", [line, line.replace("100.5", "100.6")]))
    np.testing.assert_allclose(run.sensor.bearings, [-1, -0.5, 0, 0.5, 1])
    np.testing.assert_array_equal(run.ranges[0], [1, 2, np.inf, 4, 5])
    assert run.sensor.range_max == 30
    np.testing.assert_allclose(run.sensor.mount, [0.2, 0, 0], atol=1e-12)
    np.testing.assert_allclose(run.stamps, [100.5, 100.6])
    np.testing.assert_allclose(run.poses[0], [1, 0, 0])
    assert (run.pose_frame, run.meta["pose_source"]) == ("base_link", "odometry")


@pytest.mark.parametrize("code", [32.767, 81.83, *further(50.0, 51.1, 81.91)])
@given(seed=st.integers(0, 50), share=st.floats(0.01, 0.3))
def test_no_return_code_is_found_whatever_it_is(code: float, seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    ranges = np.round(rng.gamma(2.0, 2.0, 20_000).clip(0.1, code - 0.2), 2)
    ranges[rng.random(len(ranges)) < share] = code
    assert find_code(ranges) == code


def test_codes_that_differ_a_little_are_all_taken_and_a_stray_return_is_not() -> None:
    ranges = np.concatenate(
        [np.linspace(1, 30, 5000).round(2), np.full(600, 51.05), np.full(40, 51.1), [51.01]]
    )
    assert find_code(ranges) == 51.05


@given(seed=st.integers(0, 200))
def test_ranges_without_a_code_are_left_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    assert find_code(np.round(rng.uniform(0.5, 12.0, 5000), 2)) is None
    assert find_code(np.round(rng.gamma(2.0, 2.0, 5000), 2)) is None


def test_zero_and_negative_ranges_tell_nothing(tmp_path: Path) -> None:
    lines = walk()
    lines[2] = flaser(np.array([0.0, -1.0, *np.full(179, 2.0)]), 1.0)
    run = logs.read(write(tmp_path / "a.log", lines))
    assert np.isnan(run.ranges[2, :2]).all() and np.isfinite(run.ranges[2, 2:]).all()
    assert "2 ranges are 0 or less" in run.meta["notes"]


def test_raw_log_gives_odometry_and_the_mount(tmp_path: Path) -> None:
    lines = []
    for i in range(8):
        phi = 0.3 * i
        laser = (i + 0.25 * np.cos(phi), 0.25 * np.sin(phi), phi)
        lines += [f"ODOM {i} 0 {phi} 1.5 0.2 0 {i / 2} host {i / 2}", flaser(np.full(181, 2.0 + i), i / 2, laser=laser, robot=(i, 0, phi))]  # fmt: skip
    run = logs.read(write(tmp_path / "a.log", lines))
    assert (run.meta["pose_source"], run.pose_frame) == ("odometry", "base_link")
    np.testing.assert_allclose(run.sensor.mount, [0.25, 0, 0], atol=1e-9)
    np.testing.assert_allclose(run.odom_twists, np.tile([1.5, 0.2], (8, 1)))
    np.testing.assert_allclose(run.odometry[:, 0], np.arange(8))


def test_corrected_log_gives_the_lasers_poses_and_drops_restarting_odometry(tmp_path: Path) -> None:
    lines = ["PARAM robot_frontlaser_offset 0.17 nohost 0"]
    for line in walk():
        lines += ["ODOM 0 0 0 0 0 0 0 host 0", line, "NEFF 12.5", "ODOM 0 0 0 0 0 0 -1.0 host -1.0"]
    run = logs.read(write(tmp_path / "a.log", lines))
    assert (run.meta["pose_source"], run.pose_frame, len(run.odom_stamps)) == ("slam", "laser", 0)
    np.testing.assert_allclose(run.poses[:, 0], np.arange(6))
    np.testing.assert_allclose(run.sensor.mount, [0.17, 0, 0])
    assert "ODOM lines follow the corrected poses" in run.meta["notes"]


def test_true_poses_win_over_odometry(tmp_path: Path) -> None:
    lines = [*walk(), *(f"TRUEPOS {i} 5 0.5 {i} 0 0 {i / 2} host {i / 2}" for i in range(6))]
    run = logs.read(write(tmp_path / "a.log", lines))
    assert run.meta["pose_source"] == "TRUEPOS"
    np.testing.assert_allclose(run.poses[:, 1], 5)


@pytest.mark.parametrize(
    ("times", "loggers", "want", "words"),
    [
        ([0, 0, 0], [0, 0, 0], [0, 0.1, 0.2], "no clock runs"),
        ([7, 7, 7], [1.0, 1.5, 2.0], [1.0, 1.5, 2.0], "the logger clock was used"),
        ([-3, -2, -1], [0, 0, 0], [-3, -2, -1], ""),
        ([1, 3, 2], [1, 3, 2], [1, 2, 3], "go back 1 times, sorted"),
        ([1, 1, 2], [1, 1, 2], [1, 1, 2], "1 scan stamps are duplicates"),
        ([1.6e9, 1.6e9 + 1, 1.6e9 + 2], [0, 0, 0], [0, 1, 2], ""),
    ],
)
def test_any_clock_gives_stamps_that_do_not_go_back(
    tmp_path: Path, times: list[float], loggers: list[float], want: list[float], words: str
) -> None:
    lines = [
        flaser(np.full(181, 2.0 + i), t, logger=s)
        for i, (t, s) in enumerate(zip(times, loggers, strict=True))
    ]
    run = logs.read(write(tmp_path / "a.log", lines))
    np.testing.assert_allclose(run.stamps, want)
    assert words in run.meta.get("notes", "")
    assert run.epoch_ns == (1_600_000_000_000_000_000 if max(times) > 1e9 else 0)


def corridor(times: list[float]) -> list[str]:
    """A robot that drives 0.3 m a scan; each scan shows how far it has come, as does the pose in its line."""
    lines = []
    for i, t in enumerate(times):
        pose = (0.3 * i, 0.0, 0.0)
        lines += [
            f"ODOM {0.3 * i} 0 0 1 0 0 {t} host {t}",
            flaser(np.full(181, 1 + 0.01 * i), t, laser=pose, robot=pose),
        ]
    return lines


CLOCKS = {
    "repeat": [5.0] * 40 + [5.1, 5.2],
    "all but two repeat": [5.0] * 404 + [5.5, 6.0],
    "all zero": [0.0] * 42,
    "whole seconds": [float(i // 5) for i in range(42)],
    "go back": [0.1 * i - (0.8 if i % 10 == 9 else 0) for i in range(42)],
    "set anew": [0.1 * (i % 21) for i in range(42)],
    "negative": [-9 + 0.1 * i for i in range(42)],
}


@pytest.mark.parametrize("clock", CLOCKS)
def test_a_scan_and_the_pose_in_its_line_belong_together_whatever_the_clock(
    clock: str, tmp_path: Path
) -> None:
    run = logs.read(write(tmp_path / "a.log", corridor(CLOCKS[clock])))
    for again in (run, _written_and_read(run, tmp_path)):
        pairing = logs.pair(again)
        assert pairing.paired.all()
        came = (again.ranges[:, 90] - 1) / 0.01  # which scan it is
        np.testing.assert_allclose(
            pairing.poses[:, 0], 0.3 * came, atol=1e-4
        )  # ranges are float32 in the file
        np.testing.assert_allclose(again.odometry[:, 0].max(), 0.3 * (len(CLOCKS[clock]) - 1))
        assert (np.hypot(*np.diff(again.odometry[:, :2], axis=0).T) < 0.31).all(), "odometry in its order"


def _written_and_read(run: logs.Run, folder: Path) -> logs.Run:
    logs.write(run, folder / "again.mcap")
    return logs.read(folder / "again.mcap")


def test_lines_of_one_laser_with_180_and_181_rays_are_all_kept(tmp_path: Path) -> None:
    lines = []
    for i in range(30):
        ranges = np.round(2 + np.arange(181) / 100, 2)
        pose = (0.1 * i, 0, 0)
        lines.append(flaser(ranges[: 180 if i % 3 else 181], i / 2, laser=pose, robot=pose))
    run = logs.read(write(tmp_path / "a.log", lines))
    assert run.ranges.shape == (30, 180)
    np.testing.assert_allclose(run.ranges, np.tile(2 + np.arange(180) / 100, (30, 1)))
    assert (
        "180 to 181 rays: 10 of 30 were resampled to the bearings of most scans (180 rays), none was dropped"
        in run.meta["notes"]
    )


@pytest.mark.parametrize(("named", "want"), [(None, np.inf), ("zero", np.inf), ("inf", np.nan)])
def test_a_missing_return_of_0_is_noticed_by_its_frequency(
    named: str | None, want: float, tmp_path: Path
) -> None:
    lines = walk(20)
    rng = np.random.default_rng(1)
    for i in range(20):
        ranges = rng.uniform(1, 9, 181)
        ranges[rng.permutation(181)[:9]] = 0
        lines[i] = flaser(ranges, i / 2, laser=(i, 0, 0.1), robot=(i, 0, 0.1))
    run = logs.read(write(tmp_path / "a.log", lines), no_return=named)
    missing = ~np.isfinite(run.ranges)
    assert missing.sum() == 180
    np.testing.assert_array_equal(run.ranges[missing], want)


def test_bzip2_is_told_by_content_and_a_cut_one_is_an_error(tmp_path: Path) -> None:
    text = write(tmp_path / "a.log", walk()).read_bytes()
    (tmp_path / "a.clf").write_bytes(bz2.compress(text))
    np.testing.assert_array_equal(logs.read(tmp_path / "a.clf").ranges, logs.read(tmp_path / "a.log").ranges)
    (tmp_path / "cut.clf.bz2").write_bytes(bz2.compress(text)[:-20])
    with pytest.raises(logs.LogError, match="bzip2"):
        logs.read(tmp_path / "cut.clf.bz2")


def test_gzip_is_told_by_content_and_broken_lines_are_counted(tmp_path: Path) -> None:
    lines = [*walk(), "FLASER 181 1.0 2.0"]
    text = write(tmp_path / "a.log", lines).read_bytes()
    (tmp_path / "b.log").write_bytes(gzip.compress(text))
    run = logs.read(tmp_path / "b.log")
    assert run.n_scans == 6
    assert "1 invalid lines left out, the first is line 9" in run.meta["notes"]


@pytest.mark.parametrize("stamp", [-1e308, 1e300])
def test_a_line_with_a_stamp_that_no_clock_shows_is_broken(stamp: float, tmp_path: Path) -> None:
    lines = walk()
    lines.insert(5, flaser(np.full(181, 3.0), stamp))
    run = logs.read(write(tmp_path / "a.log", lines))
    assert run.n_scans == 6
    assert "1 invalid lines left out, the first is line 8" in run.meta["notes"]


def ends(kind: str, i: int) -> str:
    """The words after the ranges in one dialect, for a robot at x = i at 100 + i / 2 s."""
    pose, at = f"{i} 0 0.1", f"{100 + i / 2}"
    return {
        "time host time": f"{pose} {pose} {at} host {at}",
        "time time host": f"{pose} {pose} {at} {at} host",
        "host time time": f"{pose} {pose} host {at} {at}",
        "time": f"{pose} {pose} {at}",
        "zeros": f"{pose} {pose} 0 0 host",
        "nan": f"{pose} {pose} nan host nan",
        "poses": f"{pose} {pose}",
        "one pose": pose,
        "time alone": at,
        "nothing": "",
    }[kind]


@pytest.mark.parametrize(
    "kind",
    [
        "time host time", "time time host", "host time time", "time", "zeros", "nan", "poses", "one pose",
        "time alone", "nothing",
    ],
)  # fmt: skip
@pytest.mark.parametrize("with_cut_line", [False, True])
def test_words_after_the_ranges_may_have_any_order_or_be_absent(
    kind: str, with_cut_line: bool, tmp_path: Path
) -> None:
    rng = np.random.default_rng(4)
    ranges = rng.uniform(1, 9, (12, 181)).round(2)
    lines = [f"FLASER 181 {' '.join(map(str, row))} {ends(kind, i)}".strip() for i, row in enumerate(ranges)]
    if with_cut_line:
        lines[-1] = lines[-1].rpartition(" ")[0]
        ranges = ranges[:-1]
    run = logs.read(write(tmp_path / "a.log", lines))
    np.testing.assert_array_equal(run.ranges, ranges)
    is_timed = "time" in kind
    np.testing.assert_allclose(
        run.stamps, np.arange(len(ranges)) * 0.5 + 100 if is_timed else np.arange(len(ranges)) / 10
    )
    assert (
        "a scan period of 0.1 s was assumed, in the order of the lines" in run.meta.get("notes", "")
    ) != is_timed
    has_poses = kind not in ("time alone", "nothing")
    assert len(run.poses) == (len(ranges) if has_poses else 0)
    if has_poses:
        np.testing.assert_allclose(run.poses, [(i, 0, 0.1) for i in range(len(ranges))])
    assert ("1 invalid lines left out, the first is line 14" in run.meta.get("notes", "")) == with_cut_line


def test_a_laser_of_which_every_line_is_broken_is_left_out(tmp_path: Path) -> None:
    run = logs.read(write(tmp_path / "a.log", [*walk(), "RLASER 181 1.0 2.0", "RLASER x"]))
    assert run.n_scans == 6
    assert "2 invalid lines left out, the first is line 9" in run.meta["notes"]


def test_a_scan_without_a_time_among_others_lies_between_them(tmp_path: Path) -> None:
    lines = walk()
    lines.insert(3, flaser(np.full(181, 3.0), float("nan"), laser=(2.5, 0, 0.1), robot=(2.5, 0, 0.1)))
    run = logs.read(write(tmp_path / "a.log", lines))
    np.testing.assert_allclose(run.stamps, [0, 0.5, 1, 1.25, 1.5, 2, 2.5])
    assert "1 scans have no time: it was interpolated in the order of the lines" in run.meta["notes"]


def test_odometry_lines_without_times_or_speeds_are_placed_by_their_lines(tmp_path: Path) -> None:
    lines = []
    for i in range(8):
        lines += [f"ODOM {i} 0 0", f"FLASER 181 {' '.join(['2.5'] * 181)}"]
    run = logs.read(write(tmp_path / "a.log", lines))
    np.testing.assert_allclose(np.diff(run.odom_stamps), 0.1)
    np.testing.assert_allclose(run.odometry[:, 0], np.arange(8))
    np.testing.assert_allclose(run.odom_twists[1:-1], np.tile([10.0, 0.0], (6, 1)))


@pytest.mark.parametrize(("no_return", "want"), [(None, np.nan), ("nan", np.inf)])
def test_nan_among_the_ranges_is_an_invalid_reading_unless_it_means_no_return(
    no_return: str | None, want: float, tmp_path: Path
) -> None:
    lines = walk()
    ranges = np.full(181, 3.0)
    ranges[:40] = np.nan
    lines[2] = flaser(ranges, 1.0)
    run = logs.read(write(tmp_path / "a.log", lines), no_return=no_return)
    np.testing.assert_array_equal(run.ranges[2, :40], np.full(40, want))
    assert (
        "40 ranges (3.7 %) are nan" in run.meta["notes"]
        or "ranges of nan are missing returns: 40" in run.meta["notes"]
    )


def test_other_laser_is_read_when_named(tmp_path: Path) -> None:
    lines = [*walk(), flaser(np.full(181, 3.0), 9.0, word="RLASER")]
    path = write(tmp_path / "a.log", lines)
    assert "1 RLASER" in logs.read(path).meta["notes"]
    assert logs.read(path, topics={"scan": "RLASER"}).n_scans == 1
    with pytest.raises(logs.LogError, match="has FLASER, RLASER"):
        logs.read(path, topics={"scan": "ROBOTLASER1"})


REAL = {  # name -> scans, rays, range_max, rays without return, pose_source (as first read; ple-* checked by a separate script)
    "ple-intel/intel-corrected.log.gz": (910, 180, 81.83, 4172, "slam"),
    "ple-freiburg-079/freiburg-079-corrected.log.gz": (4316, 360, 81.91, 33607, "slam"),
    "ple-fhw/fhw-corrected.log.gz": (488, 180, 51.05, 647, "slam"),
    "ple-aces/aces-corrected.log.gz": (440, 180, 50.0, 620, "slam"),
    "wean-hall/robotdata2.log.gz": (2251, 180, 81.83, 15066, "odometry"),
    "wean-hall/robotdata4.log.gz": (600, 180, 81.83, 2770, "odometry"),
}


LARGE = [name for name, (n_scans, n_rays, *_) in REAL.items() if n_scans * n_rays > 150_000]


@pytest.mark.parametrize("name", [*(name for name in REAL if name not in LARGE), *further(*LARGE)])
def test_real_log_is_read_whole(name: str, tmp_path: Path) -> None:
    path = DATA / name
    if not path.is_file():
        pytest.skip(f"the research data set {name} is not beside the project")
    run = logs.read(path)
    n_scans, n_rays, range_max, n_nothing, source = REAL[name]
    assert run.ranges.shape == (n_scans, n_rays)
    assert (run.sensor.range_max, run.meta["pose_source"]) == (range_max, source)
    assert np.isposinf(run.ranges).sum() == n_nothing
    assert run.sensor.resolution == 0.01
    assert logs.pair(run).paired.all()
    logs.write(run, tmp_path / "run.mcap")
    again = logs.read(tmp_path / "run.mcap")
    np.testing.assert_array_equal(again.ranges, run.ranges.astype(np.float32))
    assert again.pose_frame == run.pose_frame


@pytest.mark.slow
def test_the_real_raw_log_drives_as_far_as_its_lines_say_whatever_its_stamps(real_logs: Path) -> None:
    """Stamps of the raw Intel log go back 631 times, by up to 0.9 s; its PROVENANCE says 508 m."""
    run = logs.read(real_logs / "raw-carmen" / "intel.clf.bz2")
    pairing = logs.pair(run)
    assert pairing.paired.all() and run.n_scans == 13_631
    assert np.hypot(*np.diff(pairing.poses[:, :2], axis=0).T).sum() == pytest.approx(508.4, abs=0.1)
    assert np.hypot(*np.diff(run.odometry[:, :2], axis=0).T).sum() == pytest.approx(509.1, abs=0.1)
    assert run.duration == pytest.approx(2691.4, abs=1.0)
