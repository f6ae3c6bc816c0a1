"""`python -m sensorgraph` is the command `sensorgraph`."""

from sensorgraph.cli import main

if __name__ == "__main__":
    main()
