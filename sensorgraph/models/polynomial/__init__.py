"""Model `polynomial`: one polynomial in (x, y, phi) for each ray, the form of 2004."""
