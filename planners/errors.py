"""The one error that the planners package raises when a job, not an argument, is impossible."""


class PlanError(ValueError):
    """Say what came, what was expected and what to do, in one line."""
