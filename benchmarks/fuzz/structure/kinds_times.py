"""Clocks and counts: offsets, drift, resets, missing stamps, the order of the messages; few rays, few scans, gaps, standing still."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.fuzz.structure.draft import EPOCH, Draft, Laser
from benchmarks.fuzz.structure.start import (
    ALL,
    ODOM,
    RNG,
    SCANS,
    WHEELS,
    Kind,
    Span,
    again,
    call,
    changed,
    gap,
    is_on,
    kept,
    kind,
    readings,
    sometimes,
    stamps,
    times,
)  # fmt: skip

SIGNS = (-1.0, 1.0)
UNORDERED = ("bag", "db3", "mcap")
"""Containers whose files need no order of the log times."""
STAMPED = ("/scan", "/odom", "/tf", "/pose", "/cmd_vel")
CLOCKS: dict[str, Kind] = {
    # the stamps of one computer are off by more than any latency
    "offset": kind(stamps((SCANS, WHEELS, ODOM), lambda t, sign, by: t + sign * by, SIGNS, (0.3, 2.0, 111.7, 3600.0, 1e7)),
                   said="ahead of|behind|clock|stamps"),
    "since_boot": kind(stamps((SCANS, WHEELS, ALL), lambda t: t - EPOCH + 1234.5)),
    # from 0, as with /use_sim_time
    "simulated_time": kind(times(lambda t, log, both: (t - EPOCH, log - EPOCH * both), 0.5)),
    "far_future": kind(times(lambda t, log, by: (t + by, log + by), (4.5e8, -1.69e9, 2.4e9))),
    "drift": kind(stamps((SCANS, WHEELS), lambda t, sign, rate: t * (1 + sign * rate), SIGNS, (2e-4, 2e-3, 2e-2))),
    "another_rate": kind(stamps((SCANS, WHEELS), lambda t, rate: t * rate, (0.5, 2.0, 10.0)),
                         said="times as fast|rate|rescaled|clock"),
    "reset": kind(stamps((SCANS, WHEELS), lambda t, at, by: t + by * (t > at), Span(6, 16), (-1e9, -50.0, 40.0, 3600.0)),
                  said="reset|clock|go back"),
    # the clock of the computer is set while it records
    "reset_of_all": kind(times(lambda t, log, at, by: (t + by * (t > at), log + by * (log > at)),
                               Span(6, 16), (-20.0, -3600.0, 30.0, 7200.0)), containers=UNORDERED),
    # recorded over a network, or played back later, or at another speed
    "log_offset": kind(times(lambda t, log, by: (t, log + by), (0.5, 30.0, 86400.0, -7200.0, 3e7))),
    "log_rate": kind(times(lambda t, log, rate: (t, 100.0 + log * rate), (0.1, 0.5, 3.0))),
    "log_jitter": kind(times(lambda t, log, mean, rng: (t, log + rng.exponential(mean)), (0.02, 0.3), RNG)),
    "log_bursts": kind(times(lambda t, log, period: (t, np.ceil(log / period) * period), (0.5, 2.0))),
    "equal_log_times": kind(times(lambda t, log: (t, 0.0)), containers=UNORDERED),
    "only_log_times": kind(times(lambda t, log: (-EPOCH, log))),
    # the scans carry the time of their arrival
    "late_stamps": kind(changed(SCANS, lambda m, by: {"stamp": m.stamp + by, "log": max(m.log, m.stamp + by + 0.002)},
                                Span(0.02, 0.12)), reference=0.0),
    "jittered_stamps": kind(stamps((SCANS,), lambda t, width, rng: t + width * rng.normal(), (0.002, 0.01), RNG)),
    "repeated_stamps": kind(stamps((SCANS, WHEELS), lambda t, step: np.floor(t / step + 1e-6) * step, (0.01, 0.1))),
    "whole_seconds": kind(stamps((SCANS,), np.floor)),
    "zero_stamps": kind(stamps((SCANS, ODOM, STAMPED), lambda t, share, rng: -EPOCH if rng.random() < share else t,
                               (1.0, 1.0, 0.1), RNG), said="stamp 0|header stamps"),
    "one_wrong_stamp": kind(changed(SCANS, lambda m, numbers, by: {"stamp": m.stamp + by * (m.scan in numbers)},
                                    ((20, 90, 170), (7, 8, 160)), (-100.0, 100.0, -EPOCH))),
    # the file is not in the order of the stamps
    "out_of_order": kind(changed(ALL, lambda m, rng: dict.fromkeys(("log", "arrival"), m.log + 0.35 * (rng.random() < 0.1)),
                                 RNG)),
    "repeated": kind(
        again(ALL, lambda m, topics, share, rng, late: (
            {"log": m.log + late} if is_on(topics, m.topic) and rng.random() < share else None
        ), (SCANS, WHEELS, ALL), (1.0, 0.2), RNG, (0.0, 0.003)), said="twice|duplicates|copies",
    ),
}  # fmt: skip


def varying_rays(draft: Draft, few: int) -> None:
    """A driver sends a few rays more or less in each scan, over the same angle."""
    rng = draft.rng
    for item in draft.scans:
        c = item.content
        n = len(c["ranges"]) - int(rng.integers(0, few + 1))
        if rng.random() < 0.5:  # the last rays are missing
            c["ranges"] = c["ranges"][:n]
            c["angle_max"] = c["angle_min"] + c["angle_increment"] * (n - 1)
        else:  # fewer rays over the same angle
            old = np.arange(len(c["ranges"]))
            nearest = np.linspace(0, len(old) - 1, n)
            c["ranges"] = np.interp(nearest, old, np.where(np.isfinite(c["ranges"]), c["ranges"], 50.0))
            c["angle_increment"] = (c["angle_max"] - c["angle_min"]) / (n - 1)
            c["time_increment"] *= (len(old) - 1) / (n - 1)
        c["intensities"] = item.scan + np.linspace(0.25, 0.75, n) if len(c["intensities"]) else np.zeros(0)


def standing(draft: Draft) -> None:
    """The robot never moves."""
    drive, first, still = draft.drive, draft.scans[0].content["ranges"], draft.drive.odometry * 0.0
    draft.drive = replace(drive, poses=np.repeat(drive.poses[:1], len(drive.poses), axis=0), odometry=still)
    draft.state(still)
    for item in draft.items:
        if item.scan >= 0:
            item.content["ranges"] = np.round(first + 0.01 * draft.rng.normal(size=len(first)), 3)
        if item.kind == "Odometry":
            item.content |= {"twist": np.zeros(6)}
        if item.kind == "PoseStamped":
            item.content["pose"] = draft.on("/pose")[0].content["pose"]


def rare_odometry(draft: Draft, every: int) -> None:
    rare = {id(item) for topic in WHEELS for item in draft.on(topic)[::every]}
    draft.keep(lambda m: m.topic not in WHEELS or id(m) in rare)


NO_WHEELS = call(Draft.drop_odometry)
COUNTS: dict[str, Kind] = {
    "varying_rays": kind(call(varying_rays, (1, 3, 10)), spins=True),
    "few_scans": kind(
        kept(lambda m, n: m.topic != "/scan" or 60 <= m.scan < 60 + n, (0, 1, 2, 3, 5, 9, 10, 12, 20, 40)),
        usable=lambda draft: len(draft.scans) >= 10, empty=(("/scan", "LaserScan"),),
    ),
    "few_rays": kind(
        laser=tuple(Laser(sweep=sweep, first=first, n=n, stride=-2 * first // n)
                    for n in (1, 2, 3, 5, 8, 16, 30) for sweep, first in ((0, -90), (1, -180))),
        usable=lambda draft: draft.laser.n >= 30,
    ),
    "narrow": kind(laser=tuple(Laser(sweep=sweep, first=-angle // 2, n=angle + 1)
                               for angle in (10, 30, 60, 90) for sweep in (0, 1)),
                   usable=lambda draft: draft.laser.n > 90),
    # some messages have no rays at all
    "empty_scans": kind(readings(
        lambda c, rng: dict.fromkeys(("ranges", "intensities"), np.zeros(0)) if rng.random() < 0.1 else {}, RNG
    )),
    # for some seconds no ray returns
    "blind_stretch": kind(changed(SCANS, lambda m, at, long, code: {"content": (
        {"ranges": np.full(len(m.content["ranges"]), code)} if at < m.stamp < at + long else {}
    )}, Span(3, 13), (1, 3, 5), (np.inf, 0.0))),
    "gap_of_scans": kind(gap(SCANS, Span(4, 14), 0.5, 2.0, 5.0)),
    "gap_of_odometry": kind(gap(WHEELS, Span(4, 14), 0.5, 2.0, 5.0)),
    # nothing is recorded for a while, and the robot has moved on
    "gap_of_all": kind(gap(ALL, Span(4, 12), 1.0, 3.0, 6.0)),
    # the recorder is stopped and started again an hour later, where the robot still stands
    "pause": kind(changed(ALL, lambda m, at: {
        name: getattr(m, name) + 3600.0 * (m.stamp > at) for name in ("log", "arrival", "stamp")
    }, Span(6, 14))),
    "lost_scans": kind(kept(lambda m, share, rng: m.topic != "/scan" or rng.random() > share, (0.1, 0.5), RNG)),
    "rare_scans": kind(every=(5, 10, 20)),
    "rare_odometry": kind(call(rare_odometry, (5, 25, 50))),
    "short_odometry": kind(
        kept(lambda m, low, high: m.topic not in WHEELS or low < m.stamp < high, (-1, 5, 6), (0.25, 12.0, 15.0, 99.0)),
        lacks=("odom",),
    ),
    "short_pose": kind(
        kept(lambda m, low, high: m.topic != "/pose" or low < m.stamp < high, (-1, 6), (0.3, 12.0, 99.0)), reference=1.0,
        lacks=("pose",),
    ),
    "standing": kind(call(standing), lacks=("odom", "pose")),
    "spin": kind(sometimes(NO_WHEELS), drive="spin"),
    "corridor": kind(drive="corridor", range_max=(5.0, 8.0)),
    "corridor_scans": kind(NO_WHEELS, drive="corridor", range_max=(5.0, 8.0), usable=False, said="ambiguous|along|corridor"),
    "short_range": kind(range_max=(0.8, 1.5, 2.5), usable=lambda draft: draft.laser.range_max > 2),
}  # fmt: skip
