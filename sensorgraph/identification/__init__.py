"""Identify one signal of a run from others, measure behaviour, and design controllers."""
