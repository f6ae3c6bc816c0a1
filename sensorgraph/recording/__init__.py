"""Drive the embedded robot and record what it perceives."""
