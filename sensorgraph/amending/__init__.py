"""Write found effects into the user's own model files: URDF and xacro, SDF, MJCF, Nav2 parameters, robot.yaml.

`amend` edits spans of the text, so that all other bytes of a file stay as they are.
"""
