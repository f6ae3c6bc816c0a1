"""Hidden effects: runs whose physics deviates from map and robot file in ways that only the truth file tells.

Nothing here comes from the package under test but one entrant, `entrants.product`.

    python -m benchmarks.hidden_effects generate --world own --suite singles --kinds dev --n 70 -o DIR
    python -m benchmarks.hidden_effects answer DIR --entrant sensorgraph --workers 2
    python -m benchmarks.hidden_effects score DIR
"""
