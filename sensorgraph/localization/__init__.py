"""Estimate the poses of a run from its own scans and wheels, in a known place or in a new one.

`settings`
    What depends on robot, laser or building, with unit and meaning. Constants of an algorithm are in its module.
`result`
    `Localization`: poses, covariances, status, closures, wheel parameters.
`locate`, `kept`
    Entry point: a known place or a new one; located run, CSV, summary. Locates a file once and keeps the located run next to it.
`odometry`, `odometry_check`, `course`, `missing_odometry`
    Wheel odometry at the stamps of the scans, its units, its heading by its course, the ray order of the laser; gaps and jumps.
`scans`, `robot_parts`
    Returns of a run as points in base_link, deskewed, with surface normals, and the space that they crossed; those of the robot.
`line_map`, `matching`
    Points in hash buckets with the line around a position; match of one scan to them: pose, information, inliers.
`front_end`, `scan_track`, `wheels`
    Laser odometry: each scan is matched to the last key frames; its result; scales and heading bias of the odometry.
`tracked_run`, `ray_times`, `turning_pieces`, `older_rays`, `bearing_scale`, `range_offset`, `scan_lag`
    Time of each ray, step of the bearings, offset of the ranges and lag of the scans, from the run itself.
`contrast`, `moving_returns`
    Where scans and odometry contradict each other, and which of the two is right.
`submaps`, `loop_closures`, `pose_graph`
    Revisited places: search, tests, rejected closures; poses that best fit steps and closures, by GTSAM.
`patches`, `point_rows`, `refinement`, `wheel_edges`
    Joint refinement of poses and surfaces, with wheel constraints.
`covariances`, `surface_errors`, `dead_reckoning`
    Covariances of the poses: from a bootstrap of the residuals, and along directions that scans do not determine.
`sweep_middles`
    Poses at the stamps of slow sweeps, between the middles of two sweeps.
`mapping`, `map_states`
    `map_run`: the whole pipeline for a run in a new place; its maps, and the status of its scans.
`in_map`, `map_check`, `map_tracking`, `rival_places`
    A run in a known place: first look, search, track, recover, compare with other places, smooth.
`known_map`, `arena_walls`, `displaced_walls`, `graph_walls`, `global_search`
    A known map as lines, fields and ray tests; walls of an arena, with the errors of those of cells, and of a sensorgraph with its
    observed space; global search for a view.
`likelihood_field`, `branch_and_bound`
    Likelihood of a return at each cell of a map, and the best poses of a scan in it.
`smoothing`
    All poses at once by a banded Cholesky factor, with covariances.
"""
