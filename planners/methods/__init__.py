"""The planners: coverage (default), stop_and_spin, views, baselines; and repairs that complete a drive."""
