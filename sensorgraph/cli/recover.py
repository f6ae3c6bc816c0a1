"""`sensorgraph recover`."""


def recover() -> None:
    """Save what can be saved."""
