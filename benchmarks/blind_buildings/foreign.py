"""The 43 effects that no library has a name for."""

from __future__ import annotations

from collections.abc import Mapping

from benchmarks.blind_buildings import foreign_driver as driver
from benchmarks.blind_buildings import foreign_laser as laser
from benchmarks.blind_buildings import foreign_motors as motors
from benchmarks.blind_buildings import foreign_places as places
from benchmarks.blind_buildings import foreign_poses as poses
from benchmarks.blind_buildings import foreign_wheels as wheels
from benchmarks.blind_buildings.effect import Effect

FOREIGN: Mapping[str, type[Effect]] = {
    effect.name: effect
    for effect in (
        places.HalfMirror,
        laser.Mast,
        laser.WrappedRange,
        places.Chairs,
        places.Posters,
        laser.Restart,
        driver.Interpolated,
        driver.Median,
        laser.EndStamp,
        driver.Reversed,
        places.Radiators,
        places.Plaster,
        driver.Disparity,
        laser.SquaredRange,
        laser.Facets,
        driver.PacketShift,
        laser.NearBias,
        places.Cart,
        places.Overhang,
        places.Pipes,
        driver.Average,
        laser.Blanking,
        laser.Pitch,
        wheels.Tyre,
        wheels.Payload,
        wheels.Joints,
        wheels.Scrub,
        wheels.TurnAsymmetry,
        wheels.Crab,
        wheels.Gaps,
        wheels.SlewedClock,
        wheels.YawSteps,
        poses.Extrapolated,
        poses.Lever,
        poses.MarkerSwap,
        poses.Stale,
        motors.SetSteps,
        motors.Resonance,
        motors.LagAsymmetry,
        motors.Bursts,
        motors.PowerShare,
        motors.Slope,
        motors.Windup,
    )
}
"""In this order, which the turns of the suite are drawn from."""
