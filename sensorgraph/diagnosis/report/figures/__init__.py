"""Pictures of a diagnosis, one module each; `draw` draws all of them. matplotlib is imported on first use."""
