"""The version of this software, which every graph and report records."""

__version__ = "0.2.0"
