"""Hidden effects: runs whose physics deviates from map and robot file in ways that only the truth file tells.

Nothing here comes from the package under test but one entrant, `entrants.product`. Its command line is `command`.
"""
