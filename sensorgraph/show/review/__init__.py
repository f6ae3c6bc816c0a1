"""A run, and a sensorgraph against it, as one file for rerun's viewer.

`review` does all of it: it collects the `contents` (scans in the map, `cells`, scores), and writes them with a `report`,
`maps` and the layout of the `views`.
"""
