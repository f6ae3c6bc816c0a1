"""Stretches of a log in cross-validation: held out whole, since neighbouring scans are alike."""

N_STRETCHES = 50
"""Number of contiguous stretches that a log is divided into; stretch b is held out in fold b mod `N_FOLDS`."""
N_FOLDS = 5
