"""The version of this software, which every graph and report records."""

__version__ = "0.1.0"
