"""Foreign worlds: runs of simulators that share nothing with this project, for `sensorgraph diagnose` to be tried on.

Nothing of `sensorgraph`, `planners` or `logs` is imported: rooms, navigation, contact physics (MuJoCo), lasers, base
loops, encoders, cameras and even the writer of the files are others' or written here. `pip install ".[bench]"` brings
MuJoCo, `pip install ir-sim` the second world.

    python -m benchmarks.foreign_worlds.generate --world mujoco --suite none --kinds dev --n 10 -o DIR
    python -m benchmarks.hidden_effects.run DIR
    python -m benchmarks.hidden_effects.score DIR
"""
