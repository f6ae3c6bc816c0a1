"""The library of physical effects that a bare ray caster lacks, one file each; `EFFECTS` is the registry."""

from __future__ import annotations

from sensorgraph.effects.actuator_lag import ACTUATOR_LAG
from sensorgraph.effects.black_surface import BLACK_SURFACE
from sensorgraph.effects.dead_time import DEAD_TIME
from sensorgraph.effects.effect import Amendment, Diagnostics, Effect, Location, Parameter
from sensorgraph.effects.glass import GLASS
from sensorgraph.effects.incidence_dropout import INCIDENCE_DROPOUT
from sensorgraph.effects.latency import LATENCY
from sensorgraph.effects.map_scale import MAP_SCALE
from sensorgraph.effects.max_range import MAX_RANGE
from sensorgraph.effects.min_range import MIN_RANGE
from sensorgraph.effects.mirror import MIRROR
from sensorgraph.effects.missing_obstacle import MISSING_OBSTACLE
from sensorgraph.effects.mixed_pixels import MIXED_PIXELS
from sensorgraph.effects.mount_xy import MOUNT_XY
from sensorgraph.effects.mount_yaw import MOUNT_YAW
from sensorgraph.effects.moved_obstacle import MOVED_OBSTACLE
from sensorgraph.effects.moved_wall import MOVED_WALL
from sensorgraph.effects.people import PEOPLE
from sensorgraph.effects.pose_clock_offset import POSE_CLOCK_OFFSET
from sensorgraph.effects.quantisation import QUANTISATION
from sensorgraph.effects.random_outliers import RANDOM_OUTLIERS
from sensorgraph.effects.range_bias import RANGE_BIAS
from sensorgraph.effects.range_drift import RANGE_DRIFT
from sensorgraph.effects.range_noise import RANGE_NOISE
from sensorgraph.effects.range_scale import RANGE_SCALE
from sensorgraph.effects.scan_skew import SCAN_SKEW
from sensorgraph.effects.sector_bias import SECTOR_BIAS
from sensorgraph.effects.self_occlusion import SELF_OCCLUSION
from sensorgraph.effects.sonar_cone import SONAR_CONE
from sensorgraph.effects.speed_saturation import SPEED_SATURATION
from sensorgraph.effects.tilt import TILT
from sensorgraph.effects.unmapped_obstacle import UNMAPPED_OBSTACLE
from sensorgraph.effects.wheel_base import WHEEL_BASE
from sensorgraph.effects.wheel_radius import WHEEL_RADIUS
from sensorgraph.effects.wheel_radius_diff import WHEEL_RADIUS_DIFF
from sensorgraph.effects.wheel_slip import WHEEL_SLIP

__all__ = ["EFFECTS", "Amendment", "Diagnostics", "Effect", "Location", "Parameter"]

EFFECTS: dict[str, Effect] = {
    "range_bias": RANGE_BIAS,
    "range_scale": RANGE_SCALE,
    "range_noise": RANGE_NOISE,
    "sector_bias": SECTOR_BIAS,
    "mount_yaw": MOUNT_YAW,
    "mount_xy": MOUNT_XY,
    "latency": LATENCY,
    "scan_skew": SCAN_SKEW,
    "mixed_pixels": MIXED_PIXELS,
    "glass": GLASS,
    "mirror": MIRROR,
    "black_surface": BLACK_SURFACE,
    "incidence_dropout": INCIDENCE_DROPOUT,
    "max_range": MAX_RANGE,
    "min_range": MIN_RANGE,
    "quantisation": QUANTISATION,
    "unmapped_obstacle": UNMAPPED_OBSTACLE,
    "moved_obstacle": MOVED_OBSTACLE,
    "missing_obstacle": MISSING_OBSTACLE,
    "moved_wall": MOVED_WALL,
    "map_scale": MAP_SCALE,
    "people": PEOPLE,
    "range_drift": RANGE_DRIFT,
    "wheel_radius": WHEEL_RADIUS,
    "wheel_radius_diff": WHEEL_RADIUS_DIFF,
    "wheel_base": WHEEL_BASE,
    "wheel_slip": WHEEL_SLIP,
    "actuator_lag": ACTUATOR_LAG,
    "dead_time": DEAD_TIME,
    "speed_saturation": SPEED_SATURATION,
    "sonar_cone": SONAR_CONE,
    "self_occlusion": SELF_OCCLUSION,
    "tilt": TILT,
    "random_outliers": RANDOM_OUTLIERS,
    "pose_clock_offset": POSE_CLOCK_OFFSET,
}
