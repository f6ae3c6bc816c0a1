"""The simulated world: robot files, ray casting, the simulated robot and its recordings."""
