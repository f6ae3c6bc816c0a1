"""Hidden effects: runs whose physics deviates from map and robot file in ways that only the truth file tells.

Nothing here comes from the package under test: own rooms, ray caster, robot and physics of every effect
(`logs` only writes the file). `generate` makes the cases, `run` lets `sensorgraph diagnose` look at them and
`score` compares what it said with the truth. Development and report seeds come from disjoint streams.

    python -m benchmarks.hidden_effects.generate --suite singles --seeds dev --n 70 -o DIR
    python -m benchmarks.hidden_effects.run DIR --workers 2
    python -m benchmarks.hidden_effects.score DIR
"""
