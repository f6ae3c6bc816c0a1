"""The error that the identification package raises if the data do not permit the requested operation."""

MAX_TEXT = 1200
"""[characters] maximum length of a message; longer text from a malformed file is cut in the middle."""


class IdentError(ValueError):
    """The data do not permit the operation; the one-line message gives the value, the expectation and the remedy."""

    def __str__(self) -> str:
        text = " ".join(super().__str__().split())
        return text if len(text) <= MAX_TEXT else f"{text[: MAX_TEXT - 300]} ... {text[-290:]}"
