"""Model `polynomial`: one polynomial in (x, y, phi) for each ray, as published in 2004."""
