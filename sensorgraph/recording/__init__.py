"""Drive the simulated robot and record what it perceives."""
