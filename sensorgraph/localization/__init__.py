"""Estimate the poses of a run from its own scans and wheels, in a known place or in a new one.

`settings`
    Tuning parameters of mapping, with unit and meaning.
`result`
    `Localization`: poses, covariances, status, closures, wheel parameters.
`odometry`
    Wheel odometry at the stamps of the scans, or none if it is unusable.
`scans`
    Returns of a run as points in base_link, deskewed, with surface normals.
`line_map`
    Points in hash buckets, and the line fitted to the points around a position.
`matching`
    Match of one scan to a line map: pose, information, inliers, weak direction.
`wheels`
    Distance scale, turn scale and heading bias of the odometry.
`front_end`
    Laser odometry: each scan is matched to the last key frames.
`submaps`, `loop_closures`
    Revisited places: search, tests, rejected closures.
`pose_graph`
    Poses that best fit steps and closures; the only module that imports GTSAM.
`patches`, `refinement`, `wheel_edges`
    Joint refinement of poses and surfaces, with wheel constraints.
`covariances`
    Covariances of the poses, from a bootstrap of the residuals.
`mapping`
    `map_run`: the whole pipeline for a run in a new place.
`locate`
    Entry point: a known place or a new one; located run, CSV, summary.
`kept`
    Locates a file once and keeps the located run next to it.
`odometry_check`, `course`, `half_angle`, `odometry_settings`
    Checks the units of the odometry, its heading by its course, and the ray order of the laser; their tuning parameters.
`ray_times`, `older_rays`, `scan_lag`, `time_settings`
    Time of each ray and lag of the scans, from the run itself; their tuning parameters.
`in_map`, `map_tracking`
    A run in a known place: search, track, recover, smooth.
`graph_walls`
    Surfaces of a sensorgraph of faces or cells as walls.
`seen_space`
    Space that the rays of a sensorgraph's own runs observed.
`known_map`, `global_search`
    A known map as lines, fields and ray tests; global search for a view.
`smoothing`
    All poses at once by a banded Cholesky factor, with covariances.
`map_settings`
    Tuning parameters of localization in a known place, with unit and meaning.
`likelihood_field`
    Likelihood of a return at each cell of a map.
`branch_and_bound`
    Global search for a scan in a likelihood field.
"""
