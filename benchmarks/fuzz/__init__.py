"""Feed damaged and hostile files to every reader, odd options to every command; count what is wrong.

    python -m benchmarks.fuzz [--inputs 100000] [--seed 0] [--only "mcap,robot,$ plan"]

A reader may return or raise an error of ours with one line; a command may end with exit code 0 or 2. Everything else is
a finding: another exception, several lines, too much time or memory (`judge`). The same seed gives the same inputs.

`benchmarks.fuzz.structure` makes valid logs with one odd thing each, and holds located poses against the truth.
"""
