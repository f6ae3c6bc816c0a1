"""Score a sensorgraph, or the ray caster, on a run."""
