"""Is the model good enough: correlation tests of its residuals, and scores beside those of persistence."""
