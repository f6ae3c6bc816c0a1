"""The one error that the identification package raises when the data do not allow what was asked."""

MAX_TEXT = 1200
"""Characters of a message; what a hostile file puts into it is cut in the middle."""


class IdentError(ValueError):
    """The data do not allow what was asked; the message says in one line what came, what was expected, what to do."""

    def __str__(self) -> str:
        text = " ".join(super().__str__().split())
        return text if len(text) <= MAX_TEXT else f"{text[: MAX_TEXT - 300]} ... {text[-290:]}"
