"""The order of the tests: slow ones first, shared out evenly, so that no core waits for one at the
end. Processes of pytest-xdist begin with equal parts of the list and then take from each other."""

import os


def pytest_collection_modifyitems(items):
    processes = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", 1))
    slow, quick = [], []
    for item in items:
        (slow if item.get_closest_marker("slow") else quick).append(item)
    items[:] = [
        item
        for k in range(processes)
        for item in (
            *slow[k::processes],
            *quick[k * len(quick) // processes : (k + 1) * len(quick) // processes],
        )
    ]
