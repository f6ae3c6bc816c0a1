"""The run to make next: which questions are open, and the drive that is expected to answer them best."""
