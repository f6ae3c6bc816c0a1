"""Pictures and reviews: `figures` draws PNG pictures, `review` writes a file for rerun's viewer (*.rrd)."""
