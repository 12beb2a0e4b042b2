"""Dask's own worker command, whose processes are forks of one that has imported what runs need.

So one in the place of another that was killed is there at once.
"""

import os
import sys
from multiprocessing import process

import dask
import numpy as np
from distributed.cli.dask_worker import main
from distributed.utils import get_mp_context

from substep.sweeps import task  # noqa: F401

_LONGEST = 89  # of the name of a folder for the socket of the server: sockets' have 107 letters

os.register_at_fork(after_in_child=np.random.seed)  # Python's own numbers see to it themselves

if __name__ == "__main__":
    scratch = sys.argv[sys.argv.index("--local-directory") + 1]
    method = "forkserver" if len(os.fsencode(scratch)) <= _LONGEST else "spawn"
    process.current_process()._config["tempdir"] = scratch  # type: ignore[attr-defined]
    with dask.config.set({"distributed.worker.multiprocessing-method": method}):
        if method == "forkserver":
            get_mp_context().set_forkserver_preload(["substep.sweeps.processes"])
        main()
