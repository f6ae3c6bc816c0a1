"""`sensorgraph inspect`."""


def inspect() -> None:
    """Say what is in a file."""
