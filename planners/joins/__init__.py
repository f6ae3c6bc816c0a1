"""Paths that join the parts of a drive: direct where that is clear, else by OMPL in a separate process."""
