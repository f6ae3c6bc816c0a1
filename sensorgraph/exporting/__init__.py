"""Export an arena and a robot to other simulators: MuJoCo, ir-sim, Gazebo, Nav2.

`export` writes a folder. The scripts in it use `twin`, so that a drive there becomes a run like any other.
"""
