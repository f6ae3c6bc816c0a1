"""What happened: runs in memory and the files that keep them; knows no planner and no model."""
