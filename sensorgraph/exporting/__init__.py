"""An arena and a robot for other simulators: MuJoCo, ir-sim, Gazebo, Nav2.

`export` writes a folder; `twin` is what the scripts in it run on, so that a drive there becomes a run like any other.
"""
