"""The error that the planners package raises when a job is impossible."""

MAX_TEXT = 1200
"""Maximum number of characters of a message; a longer one, as from a hostile file, is cut in the middle."""


class PlanError(ValueError):
    """A job is impossible; the message states in one line what was given, what was expected and what to do."""

    def __str__(self) -> str:
        text = " ".join(super().__str__().split())
        return text if len(text) <= MAX_TEXT else f"{text[: MAX_TEXT - 300]} ... {text[-290:]}"
