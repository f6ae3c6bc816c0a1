"""Paths that join the parts of a drive: straight or shortest where that is clear, else by OMPL in a process of its own."""
