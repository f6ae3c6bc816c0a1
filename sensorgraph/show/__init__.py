"""What people look at: `figures` draws pictures (PNG), `review` makes a file for rerun's viewer (*.rrd)."""
