"""Families of structure of the motion channels that no effect of the library explains: names and titles."""

from __future__ import annotations

from collections.abc import Mapping

ODOMETRY_FAMILIES = {
    "steady change": ("wheels_steady_change", "wheels that change steadily, as a tyre that loses air"),
    "at rest": ("turn_at_rest", "a turn that continues at rest, as from a gyro bias"),
    "jump": ("wheels_jump", "wheel scales that change once"),
    "while": ("wheels_temporary", "wheel scales that change temporarily"),
    "speed": ("wheels_by_speed", "wheel scales that depend on speed or turn rate"),
    "direction": ("wheels_by_direction", "wheel scales that differ between directions of motion"),
    "curvature": ("wheels_in_tight_turns", "wheel scales that differ in tight turns"),
    "acceleration": ("wheels_by_acceleration", "wheel scales that depend on the acceleration"),
    "place": ("wheels_by_place", "wheel scales that depend on the place"),
    "clock": ("clock_over_time", "a clock offset that changes over time"),
    "heading": ("distance_by_heading", "a distance scale that depends on the heading"),
    "compass": ("turn_by_heading", "a turn scale that depends on the heading, as of a compass near iron"),
    "spinning": ("wheels_spin", "wheels that spin while they speed up"),
    "turns of a wheel": ("wheel_out_of_round", "an error that repeats with every turn of a wheel"),
    "reference yaw": ("reference_yaw_by_place", "a heading error of the reference that depends on the place"),
    "reference place": ("reference_by_place", "a position error of the reference that depends on the place"),
    "reference jumps": ("reference_jumps", "jumps of the reference at single moments"),
    "sideways curve": ("sliding_in_curves", "sideways sliding in curves"),
    "sideways direction": ("sideways_by_direction", "a sideways motion that differs between directions"),
    "sideways heading": ("sideways_by_heading", "a sideways motion that depends on the heading"),
    "sideways time": ("sideways_over_time", "a sideways motion that changes over time"),
    "askew": ("askew", "a direction of travel at an angle to the heading"),
}
"""Kind -> name in the ledger, and noun phrase."""

DRIVE_FAMILIES = {
    "time": ("gain_over_time", "a gain of the motors that changes over time"),
    "direction": ("gain_by_direction", "a gain of the motors that differs between directions of motion"),
    "coupling": ("gain_in_turns", "a speed that depends on the turn rate, or vice versa"),
    "answer": ("motors_ring", "a response of the motors that is not a single lag"),
    "lag by sense": ("lag_by_sense", "a lag that differs between speeding up and slowing down"),
    "heading": ("speed_by_heading", "a speed that depends on the heading, as on a sloped floor"),
    "drops": ("speed_losses", "temporary losses of speed despite commands to continue"),
    "jump": ("gain_jump", "a gain of the motors that changes once"),
    "jump of the lag": ("lag_jump", "a lag of the motors that changes once"),
    "jump of the delay": ("delay_jump", "a delay of the motors that changes once"),
    "deadband": ("dead_zone", "a dead zone of small commands"),
    "ramp": ("slow_ramp", "a slower acceleration than specified"),
    "constant gain": ("constant_gain", "a constant gain of the motors beyond the tolerances"),
}
"""Kind -> name in the ledger, and noun phrase."""

FAMILIES_OF: Mapping[str, Mapping[str, tuple[str, str]]] = {
    "odometry": ODOMETRY_FAMILIES,
    "drive": DRIVE_FAMILIES,
}
"""Channel -> its families."""
