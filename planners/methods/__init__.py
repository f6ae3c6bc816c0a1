"""The planners, one file each: coverage (the default), stop_and_spin, views, baselines; and the repairs that complete a drive."""
