"""Watch a robot in the place of a sensorgraph: is its pose right, has the place changed, do laser and wheels work.

* `observation`: one scan with odometry and the pose that the robot believes; from a run, or live.
* `readings`: evidence of each ray for a pose, against a ray from anywhere in the place.
* `resemblance`: evidence of a scan for a pose, against another place that resembles it.
* `tracker`, `modes`, `scan_input`: a filter over several possible poses and "elsewhere".
* `missing`, `search`, `kept_scans`: when the scans may fit better at another pose, and a search for it in parallel.
* `pose`: is the believed pose right.
* `place`: what stands there that the graph lacks, and what is gone.
* `odometry_errors`, `laser_errors`, `belief_lag`, `evidence`, `robot`: hypotheses about laser, wheels and a late belief, with their
  evidence.
* `watcher`, `status`: the three statements, once a second.
* `policy`: limits learned from good runs. `page`, `messages`: what people look at.
"""
