"""The next run: open questions, and the drive that is expected to answer them best."""
