"""Poses from the robot's own log: scans and wheels, in a known place or a new one.

| module | what it does |
|---|---|
| `settings` | the tuned numbers of mapping, with unit and meaning |
| `result` | `Localization`: poses, covariances, status, closures, wheels |
| `odometry` | what the wheels say at the stamps of the scans, or that they say nothing |
| `scans` | returns of a run as points in base_link, deskewed, with the normals of their surfaces |
| `line_map` | points in buckets, and the line that fits them around any place |
| `matching` | one scan against a line map: pose, information, inliers, weak direction |
| `wheels` | scale, turn scale and heading bias of the odometry |
| `front_end` | one scan after the other against the last key frames |
| `submaps`, `loop_closures` | places that the robot came back to: search, tests, what was refused |
| `pose_graph` | poses that agree best with steps and closures; the only one that knows GTSAM |
| `patches`, `refinement`, `wheel_edges` | poses and surfaces together, tied by the wheels |
| `covariances` | how well the poses are known, by a bootstrap of the residuals |
| `mapping` | `map_run`: all of these, for a run in a new place |
| `locate` | the way in: a known place or a new one; the located run, CSV, summary |
| `kept` | locates a file once and keeps the run beside it |
| `odometry_check` | whether odometry is in metres and radians, and the laser counts its rays counter-clockwise |
| `in_map`, `map_tracking` | a run in a known place: search, follow, lose and find again, smooth |
| `graph_walls` | the surfaces of a graph of faces or cells as walls |
| `seen_space` | where the rays of a graph's own log went |
| `known_map`, `global_search` | walls as lines, fields and rays; all places where a view fits |
| `smoothing` | all poses at once by a banded Cholesky factor, with covariances |
| `map_settings` | every tuned number of these, with unit and meaning |
| `likelihood_field` | how likely a return is at each place of a map |
| `branch_and_bound` | where in a likelihood field a scan fits, without a guess |
"""
