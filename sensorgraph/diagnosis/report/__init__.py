"""The report of a diagnosis: one folder with report.json, report.html, effects.yaml, review.rrd and pictures.

`files.save_report` writes all of it. `summary` says the result in sentences, `quantities` prints numbers, `comparison`
collects measured and simulated scans for pictures and `rerun_view`, `data` is report.json, `html` is report.html.
"""
