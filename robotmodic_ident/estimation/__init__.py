"""Coefficients beyond least squares: prediction error, noise models, rational models, free-run error."""
