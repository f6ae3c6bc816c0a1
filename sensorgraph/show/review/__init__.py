"""Write a run and the errors of a sensorgraph on it as one file for rerun's viewer.

`review` collects the `contents` (scans in the map, `cells`, scores) and writes them with a `report`, `maps` and the
layout of the `views`.
"""
