"""The one error that the identification package raises when the data do not allow what was asked."""


class IdentError(ValueError):
    """The data do not allow what was asked; the message says in one line what came, what was expected, what to do."""
