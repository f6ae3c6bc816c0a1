"""Sensorgraph: transparent equations of what a range sensor perceives at every (x, y, phi) of an arena."""

from sensorgraph.packages import check_packages

__version__ = "0.1.0.dev0"

check_packages()  # before anything else can fail on a package of the same name
