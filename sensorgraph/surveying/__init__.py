"""One table over many logs: each log is a task with limits of time and memory; results are kept by content.

`survey` analyses one log, `limited` runs it in a process of its own, `trends` compares the logs of a robot and the
robots of a fleet, and `page` shows all of it.
"""
