"""Estimation of coefficients beyond least squares: prediction error, noise models, rational models, simulation error."""
