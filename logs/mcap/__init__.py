"""MCAP files record by record: how they are laid out, how they are checked, and what damage costs."""
