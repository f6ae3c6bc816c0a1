"""The one error that the logs package raises when a file, not an argument, is at fault."""

MAX_TEXT = 1200
"""Characters of a message; what a hostile file puts into it is cut in the middle."""


class LogError(ValueError):
    """A file cannot be used as asked; the message says in one line what came, what was expected, what to do."""

    def __str__(self) -> str:
        text = " ".join(super().__str__().split())
        return text if len(text) <= MAX_TEXT else f"{text[: MAX_TEXT - 300]} ... {text[-290:]}"
