"""Run the command `sensorgraph` as `python -m sensorgraph`."""

from sensorgraph.cli import main

if __name__ == "__main__":
    main()
