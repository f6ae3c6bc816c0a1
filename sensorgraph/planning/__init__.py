"""Planning with logs and sensorgraphs: plan folders, priorities and resumed drives."""
