"""Pictures, pages and reviews: `figures` draws PNG pictures, `page_shell` writes HTML, `review` a file for rerun (*.rrd)."""
