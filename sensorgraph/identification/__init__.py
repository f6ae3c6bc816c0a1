"""Identify one signal of a run from others, and quantify behaviour."""
