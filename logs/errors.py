"""The one error that the logs package raises when a file, not an argument, is at fault."""


class LogError(ValueError):
    """Say what came, what was expected and what to do, in one line."""
