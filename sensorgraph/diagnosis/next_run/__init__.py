"""The next run: open questions, and the drive that is expected to answer them best.

Its constants were set on the pairs of effects of `python -m benchmarks.next_run`, and on its two shorter versions,
`--minutes 0.3 --size 0.5` and `--minutes 0.5`.
"""
