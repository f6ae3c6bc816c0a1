"""The one error that the identification package raises when the data do not allow what was asked."""


class IdentError(ValueError):
    """Say what came, what was expected and what to do, in one line."""
