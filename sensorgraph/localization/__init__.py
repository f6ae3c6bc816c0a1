"""Poses from the robot's own log: scans and wheels, in a known place or a new one.

| module | what it does |
|---|---|
| `settings` | the tuned numbers of mapping, with unit and meaning |
| `result` | `Localization`: poses, covariances, status, closures, wheels |
| `odometry` | what the wheels say at the stamps of the scans, or that they say nothing |
| `scans` | returns of a run as points in base_link, deskewed, with the normals of their surfaces |
| `line_map` | points in buckets, and the line that fits them around any place |
| `matching` | one scan against a line map: pose, information, inliers, weak direction |
| `likelihood_field` | how likely a return is at each place of a map |
| `branch_and_bound` | where in a likelihood field a scan fits, without a guess |
"""
