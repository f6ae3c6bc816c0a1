"""`python -m benchmarks.hidden_effects`: see `command`."""

from benchmarks.hidden_effects.command import main

main()
