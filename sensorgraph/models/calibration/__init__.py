"""Joint identification of the laser (mount, bias, scale, incidence), the training poses and the faces."""
