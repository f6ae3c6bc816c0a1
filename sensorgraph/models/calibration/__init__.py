"""Identify the laser (mount, bias, scale, incidence) and the training poses together with the faces."""
