"""Models of what each ray perceives; registry MODELS."""
