"""The error that the logs package raises for an unusable file; invalid arguments raise `ValueError`."""

MAX_TEXT = 1200
"""[characters] maximum length of a message; longer text from a malformed file is cut in the middle."""

MAX_LISTED = 5
"""Number of names, places or notes that a message lists; it counts the others."""


class LogError(ValueError):
    """A file cannot be used; the one-line message gives the value found, the value expected and the remedy."""

    def __str__(self) -> str:
        text = " ".join(super().__str__().split())
        return text if len(text) <= MAX_TEXT else f"{text[: MAX_TEXT - 300]} ... {text[-290:]}"
