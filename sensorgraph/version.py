"""The version of sensorgraph, which each graph and report records."""

__version__ = "0.2.0"
