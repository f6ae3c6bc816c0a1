"""Blind buildings: runs with hidden effects in rooms cut from real floors, by somebody who has not seen the code.

Nothing of `sensorgraph`, `planners`, `logs`, `robotmodic_ident` or another benchmark is imported but the MCAP writer of
`benchmarks.blind_world`.

    python -m benchmarks.blind_buildings.generate --suite singles --n 70 -o DIR
    python -m benchmarks.hidden_effects.run DIR
    python -m benchmarks.hidden_effects.score DIR
"""
