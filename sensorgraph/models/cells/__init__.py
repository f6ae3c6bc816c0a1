"""Model `cells`: a short line in every 5 cm cell, with one learned polynomial for the visibility of all cells."""
