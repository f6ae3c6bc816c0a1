"""The one error that the sensorgraph package raises when what the user gave does not allow what was asked."""


class GapError(ValueError):
    """Say what came, what was expected and what to do, in one line."""
