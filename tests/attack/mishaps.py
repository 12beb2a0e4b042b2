"""A torture of nothing, for the test of what runs them: its jobs go well, crash or hang."""

import ctypes

from runner import Counts


def work(job):
    if job == "crash":
        ctypes.string_at(0)
    while job == "hang":
        pass
    return Counts({job: {"calls": 1}})
