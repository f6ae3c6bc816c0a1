"""Valid logs with one odd thing each, read by `inspect` and `locate`: nothing may crash, and no error may be silent.

    python -m benchmarks.fuzz.structure --n 10000 --seed 1 [--only KIND,...] [--keep FOUND.jsonl]

The robot, the room and the laser are MuJoCo's (`drives`); the files are written by rosbags, mcap and code of this folder.
Each log has its true poses. A run counts as a silent error if a pose with status ok is wrong by more than three stated
standard deviations plus 5 cm or 2°, and nothing is printed that says so (`judge`). `--keep` saves each result and
continues an interrupted run. The same seed gives the same logs.
"""
