"""Cut the rays of a rotating laser into full turns, if its scans begin at another bearing each time.

Some drivers send a scan whenever they have a number of rays, or one sector after the other. Ray i of scan k is measured
at the angle u and the time t

    u = U_k + i s,    t = t_k + i s / w.

Here U_k is the angle of the first ray, unwrapped over the turns, s the step of the bearings, and w the rate of
rotation, which the stamps t_k of successive scans show. A turn m holds the rays with 2 pi m <= u < 2 pi (m + 1).
Then each ray has the same bearing, and the same time after its stamp, in all scans.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import tau

import numpy as np
from numpy.typing import NDArray

from logs.resampling import SAME_BEARING, resample, take_nearest
from logs.ros import cdr
from logs.ros.cloud_turns import MIN_WHOLE
from logs.ros.laser_scan import ShapeCensus
from logs.ros.messages import scan_topic
from logs.ros.recording import Topic, logged_times
from logs.transforms import wrap
from logs.types import Floats

SHARE = 0.9
"""Share of the scans that must begin where the last one ended; if as many begin at one bearing, nothing is cut."""
SLACK = 2.0
"""[steps] between the end of a scan and the beginning of the next, beyond which rays are missing."""


@dataclass(frozen=True)
class _Stream:
    """The rays of a laser in order of time."""

    stamps: NDArray[np.int64]
    """(n_scans,) [ns]"""
    logged: NDArray[np.int64]
    """(n_scans,) [ns]"""
    lows: Floats
    """(n_scans,) [rad] bearing of the first ray."""
    ranges: list[Floats]
    """n_scans arrays of ranges [m]."""
    intensities: list[Floats]
    """The same of intensities; empty where the driver sent none."""
    limits: Floats
    """(7,) of the first scan."""
    frame: str

    @property
    def step(self) -> float:
        """[rad] between two rays, negative if clockwise."""
        return float(self.limits[2])


def begin_elsewhere(census: ShapeCensus) -> bool:
    """Return whether fewer than `SHARE` of the scans begin at one bearing."""
    shapes = list(census.counts)
    lows = np.repeat([shape.angle_min for shape in shapes], [census.counts[shape] for shape in shapes])
    steps = [abs(shape.increment) for shape in shapes if shape.increment]
    return bool(steps) and _is_spread(np.asarray(lows), float(np.median(steps)))


def _is_spread(lows: Floats, step: float) -> bool:
    """Return whether fewer than `SHARE` of the first bearings agree within `SLACK` steps."""
    angles = np.sort(lows % tau)
    both = np.concatenate([angles, angles + tau])
    most = int(
        (np.searchsorted(both, angles + SLACK * step, side="right") - np.arange(len(angles))).max(initial=0)
    )
    return most < SHARE * len(lows)


def full_turns(topic: Topic) -> tuple[Topic, list[str]]:
    """Return a topic of LaserScan messages cut into full turns, with a note, or unchanged."""
    stream = _stream(topic)
    if stream is None:
        return topic, []
    sign, step = np.sign(stream.step), abs(stream.step)
    n_rays = np.array([len(part) for part in stream.ranges])
    after = sign * wrap(stream.lows[1:] - stream.lows[:-1] - stream.step * n_rays[:-1])
    follows = np.abs(after) <= SLACK * step
    elsewhere = np.abs(wrap(np.diff(stream.lows))) > 0.5 * step  # after a full turn, both are the same
    if follows.mean() < SHARE or elsewhere.mean() < 0.5:
        return topic, []
    advance, seconds = n_rays[:-1] * step + after, np.diff(stream.stamps) / 1e9
    rate = float(np.median(advance[follows] / seconds[follows]))  # [rad/s]
    missed = np.rint((rate * seconds - advance) / tau)
    advance += tau * np.where(follows, 0, np.maximum(missed, np.where(advance < 0, 1, 0)))
    n = round(tau / step)
    first = _first_bearing(stream.lows, n, sign)
    begins = sign * (stream.lows[0] - first) % tau + np.concatenate([[0.0], np.cumsum(advance)])
    return _cut(topic, stream, begins, rate, first, n)


def _stream(topic: Topic) -> _Stream | None:
    """Return the rays of a topic; None if its scans begin at one bearing, differ in frame or step, or are in degrees.

    Ranges are decoded only if the scans begin elsewhere.
    """
    blocks = list(cdr.unpack(topic.payloads, topic.type, topic.name, topic.encoding))
    if not blocks or len({block.strings["frame_id"] for block in blocks}) > 1:
        return None
    limits = np.concatenate([block["limits"].astype(np.float64) for block in blocks])
    step = float(limits[0, 2])
    if not 0 < abs(step) < 0.5 * np.pi or not np.allclose(limits[:, 2], step, rtol=1e-4, atol=0):
        return None
    if len(limits) < 3 or not _is_spread(limits[:, 0], abs(step)):
        return None
    stamps = np.concatenate([block.stamps_ns for block in blocks])
    index = np.concatenate([block.index for block in blocks])
    ranges = [row for block in blocks for row in block["ranges"].astype(np.float64)]
    if max(map(len, ranges)) * abs(step) > 2 * tau:
        return None
    intensities = [row for block in blocks for row in block["intensities"].astype(np.float64)]
    order = np.lexsort((index, stamps))
    order = order[np.diff(stamps[order], prepend=stamps.min() - 1) > 0]
    if len(order) < 3:
        return None
    return _Stream(
        stamps[order], logged_times(topic)[index[order]], limits[order, 0],
        [ranges[i] for i in order], [intensities[i] for i in order], limits[order[0]],
        blocks[0].strings["frame_id"],
    )  # fmt: skip


def _first_bearing(lows: Floats, n: int, sign: float) -> float:
    """Return the first bearing [rad] of a turn that begins behind the laser, in phase with the rays."""
    phase = float(np.angle(np.exp(1j * n * lows).mean())) / n
    return phase + sign * tau / n * float(np.ceil((-np.pi - sign * phase) * n / tau - 1e-3))


def _cut(
    topic: Topic, stream: _Stream, begins: Floats, rate: float, first: float, n: int
) -> tuple[Topic, list[str]]:
    """Return the messages of the full turns.

    Parameters
    ----------
    begins : (n_scans,) [rad] angle of the first ray of each scan, from bearing `first` in the direction of rotation
    rate : [rad/s] of the rotation
    n : number of bearings in a turn
    """
    n_rays = np.array([len(part) for part in stream.ranges])
    scan = np.repeat(np.arange(len(begins)), n_rays)
    along = (np.arange(len(scan)) - np.repeat(np.cumsum(n_rays) - n_rays, n_rays)) * abs(stream.step)
    angles = begins[scan] + along
    turn = np.floor(angles / tau + 0.5 / n).astype(np.int64)
    angles -= tau * turn
    ranges = np.concatenate(stream.ranges)
    strengths = [
        part if len(part) == m else np.full(m, np.nan)
        for part, m in zip(stream.intensities, n_rays, strict=True)
    ]
    intensities = np.concatenate(strengths)
    wanted = np.arange(n) * tau / n
    order = np.lexsort((angles, turn))
    rows, shares = [], []
    for mine in np.split(order, np.flatnonzero(np.diff(turn[order])) + 1):
        kept = mine[np.diff(angles[mine], prepend=-np.inf) > 0.5 * abs(stream.step)]
        at, early = angles[kept], kept[0]
        beside = np.clip(np.searchsorted(at, wanted)[:, None] + [-1, 0], 0, len(at) - 1)
        away = np.abs(wrap(wanted[:, None] - at[beside])).min(axis=1)
        is_measured = away < (1 - SAME_BEARING) * abs(stream.step)
        stamp = stream.stamps[scan[early]] + round((along[early] - angles[early]) / rate * 1e9)
        rows.append(
            (
                stamp,
                int(stream.logged[scan[kept]].max()),
                np.where(is_measured, resample(ranges[kept][None], at, wanted)[0], np.nan),
                take_nearest(intensities[kept][None], at, wanted)[0],
            )
        )
        shares.append(is_measured.mean())
    whole = np.array(shares) >= MIN_WHOLE * np.median(shares)
    stamps, logged, taken, strong = zip(
        *(row for row, is_whole in zip(rows, whole, strict=True) if is_whole), strict=True
    )
    sign = np.sign(stream.step)
    limits = stream.limits.copy()
    limits[:5] = first, first + sign * wanted[-1], sign * tau / n, tau / n / rate, tau / rate
    note = (
        f"{topic.name}: scans begin where the last one ended, so their rays were cut into {len(stamps)} full turns "
        f"of {tau / rate:.4g} s ({len(rows) - len(stamps)} incomplete turns were left out)"
    )
    cut = scan_topic(topic, np.array(stamps), logged, stream.frame, limits, np.stack(taken), np.stack(strong))
    return cut, [note]
