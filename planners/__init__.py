"""Where to drive so that (x, y, phi) is filled; knows no sensor, no log and no model."""
