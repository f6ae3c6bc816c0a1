"""Occupancy-grid maps: straightened walls, the tolerance that their cells imply, and where the surfaces are in the cells.

A robot's map has the surfaces in the middle of the cells on average. A simulator that makes its world from a map extrudes
the cells, so that every wall is half a cell nearer. The likelihood of the scans decides between the two. The bias of the
laser is free in both, since it changes all readings alike. A wall that is half a cell w/2 nearer changes a reading by

    -w / (2 cos incidence).
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from planners.arena import Arena
from sensorgraph.diagnosis.map_changes import ends_at, known_and_unchanged
from sensorgraph.diagnosis.scan.corner_sums import Corners
from sensorgraph.diagnosis.scan.fit import fit, start_state, thin
from sensorgraph.diagnosis.scan.scan_data import ScanData
from sensorgraph.diagnosis.scan.settings import SCAN, NoiseBounds
from sensorgraph.effects.range_bias import RANGE_BIAS
from sensorgraph.models.cones.settings import measures_cones
from sensorgraph.types import Bools, Floats, Ints
from sensorgraph.world.cell_borders import with_borders_as_walls
from sensorgraph.world.pixel_walls import (
    is_near_gap,
    pixel_of,
    straightened,
    unknown_borders,
)
from sensorgraph.world.raycast import laser_poses
from sensorgraph.world.robot import Robot

Prepared: TypeAlias = tuple[ScanData, dict[str, Any]]
"""Scans in a map, and notes for the report."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RasterMap:
    """An occupancy-grid map, prepared for the diagnosis."""

    arena: Arena
    """With straightened walls."""
    pixel: float
    """[m] size of a cell."""
    tolerance: float
    """[m] standard deviation of the walls: half a cell to either side, and the residual of the straightening."""
    borders: Floats
    """(n, 2, 2) [m] ends of free space without a wall; the space beyond is unknown."""
    drawn: Arena
    """With the outlines of the cells as walls."""
    is_drawn: bool = False
    """Whether the walls are these outlines, as in a simulated world that is made from the map."""

    @classmethod
    def of(cls, arena: Arena) -> RasterMap:
        """Straighten the walls of an occupancy-grid arena."""
        pixel = pixel_of(arena)
        straight, rms = straightened(arena)
        tolerance = float(np.hypot(pixel / np.sqrt(12), rms))
        return cls(
            arena=straight,
            pixel=pixel,
            tolerance=tolerance,
            borders=unknown_borders(arena),
            drawn=arena,
        )

    def as_drawn(self) -> RasterMap:
        """Return the map with the outlines of the cells as walls; it may still be half a cell off."""
        return replace(
            self,
            arena=with_borders_as_walls(self.drawn, self.arena),
            tolerance=float(self.pixel / np.sqrt(12)),
            is_drawn=True,
        )

    def widened(self, robot: Robot) -> Robot:
        """Return the robot with at least the map tolerance of this map."""
        t = robot.tolerances
        return replace(robot, tolerances=replace(t, map=max(t.map, self.tolerance)))

    def judged(self, data: ScanData) -> tuple[ScanData, dict[str, Any]]:
        """Exclude rays into unknown space and rays that show a change; return the scans and notes for the report."""
        if data.sensor.is_composite or measures_cones(
            data.sensor
        ):  # rays that start at several places, or are not thin
            return data, self._notes()
        _, wall = data.plain_cast
        at_gap = self._at_gap(data)
        if at_gap.any():  # otherwise the cached cast stays valid
            data = replace(data, ranges=np.where(at_gap, np.nan, data.ranges), memo={})
        data, said = known_and_unchanged(data, self.borders, left_in="named")
        data = replace(data, corners=_most_met(data.arena.walls, wall), grain=self.pixel / 2, memo={})
        return data, {**self._notes(), **said}

    def _notes(self) -> dict[str, Any]:
        """Return what the map is, for the report."""
        return {
            "pixel_m": self.pixel,
            "walls": self.arena.n_walls,
            "map_tolerance_m": self.tolerance,
            "walls_at_cell_borders": self.is_drawn,
        }

    def _at_gap(self, data: ScanData) -> Bools:
        """Tell which rays (n_scans, n_rays) end at a gap between cells, or pass a gap that the map closes."""
        out = np.zeros(data.ranges.shape, dtype=np.bool_)
        expected, wall = data.plain_cast
        scan, ray = np.nonzero(wall >= 0)
        lasers = laser_poses(data.poses, data.sensor.mount)
        out[scan, ray] = is_near_gap(
            self.drawn, ends_at(lasers, data.sensor.bearings, scan, ray, expected[scan, ray])
        )
        return out


def _most_met(walls: Floats, wall: Ints) -> Corners:
    """Return the corners of the walls that most rays meet, up to the maximum number of corners that may shift.

    Parameters
    ----------
    wall : (n_scans, n_rays) Index of the wall that each ray meets; -1 for none.
    """
    count = np.bincount(wall[wall >= 0], minlength=len(walls))
    numbers = range(1, int(count.max(initial=1)))
    most = SCAN.nuisance.max_corners
    k = bisect_left(numbers, True, key=lambda least: Corners.of(walls, count >= least).count <= most)
    return Corners.of(walls, count >= k + 1)


def raster_map_of(
    arena: Arena, prepare: Callable[[RasterMap], Prepared], noise_bounds: NoiseBounds
) -> tuple[RasterMap, Prepared]:
    """Return an occupancy-grid arena with its surfaces where the scans have them, and the scans prepared for it.

    Parameters
    ----------
    prepare : Prepares the scans for comparison with a map.
    """
    pixels = RasterMap.of(arena)
    prepared = prepare(pixels)
    if _distance_before_walls(prepared[0]) < pixels.pixel / 4:
        return pixels, prepared
    drawn = pixels.as_drawn()
    again = prepare(drawn)
    is_compared = np.isfinite(prepared[0].ranges) & np.isfinite(again[0].ranges)
    evidence = [_log_likelihood(data, is_compared, noise_bounds) for data in (prepared[0], again[0])]
    return (drawn, again) if evidence[1] > evidence[0] else (pixels, prepared)


def _distance_before_walls(data: ScanData) -> float:
    """Return the median distance [m] of the returns before the walls, along their normals; 0 if there are no walls."""
    if data.sensor.is_composite or measures_cones(data.sensor):
        return 0.0
    beams = data.scene().shoot()
    off = beams.ranges - np.where(data.returned, data.ranges, np.nan)
    near = (beams.wall >= 0) & (np.abs(off) < 4 * data.tolerances.map)
    return float(np.median(off[near] * beams.cosine[near])) if near.any() else 0.0


def _log_likelihood(data: ScanData, is_compared: Bools, noise_bounds: NoiseBounds) -> float:
    """Return the penalised log-likelihood [nats] of some returns (n_scans, n_rays), with the laser's bias free."""
    data = replace(data, ranges=np.where(is_compared, data.ranges, np.nan), memo={})
    few = thin(data, max(1, data.n_scans // SCAN.selection.n_scans))
    model = (RANGE_BIAS(b=0.0),)
    return fit(few, model, start_state(few, noise_bounds), noise_bounds).j
