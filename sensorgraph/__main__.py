"""`python -m sensorgraph` is the command `sensorgraph`."""

from sensorgraph.cli import main

main()
