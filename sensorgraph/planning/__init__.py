"""Plan folders, priorities and resumed drives: what planning takes from logs and sensorgraphs."""
