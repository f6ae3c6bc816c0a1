"""Validate a model: correlation tests of its residuals, and scores compared with persistence."""
