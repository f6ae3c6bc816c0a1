"""Run models sample by sample: one step ahead, several steps ahead, and in free run."""
