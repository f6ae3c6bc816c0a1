"""The one error that the logs package raises when a file, not an argument, is at fault."""


class LogError(ValueError):
    """A file cannot be used as asked; the message says in one line what came, what was expected, what to do."""
