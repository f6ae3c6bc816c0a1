"""Build a sensorgraph from logs, in one pass and in bounded memory."""
