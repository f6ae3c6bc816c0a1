"""The one error that the planners package raises when a job, not an argument, is impossible."""

MAX_TEXT = 1200
"""Characters of a message; what a hostile file puts into it is cut in the middle."""


class PlanError(ValueError):
    """Say what came, what was expected and what to do, in one line."""

    def __str__(self) -> str:
        text = " ".join(super().__str__().split())
        return text if len(text) <= MAX_TEXT else f"{text[: MAX_TEXT - 300]} ... {text[-290:]}"
