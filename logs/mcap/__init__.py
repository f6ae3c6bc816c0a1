"""MCAP files record by record: layout, validation and handling of damage."""
