"""Blind world: runs with hidden effects, by a generator whose author read two reference pages and no code.

Nothing of `sensorgraph`, `planners`, `logs`, `robotmodic_ident` or another benchmark is imported.

    python -m benchmarks.blind_world.generate --suite singles --kinds development --n 70 -o DIR
    python -m benchmarks.hidden_effects.run DIR
    python -m benchmarks.hidden_effects.score DIR
"""
