"""Dask's own worker command, whose processes are forks of one that has imported what runs need.

So one in the place of another that was killed is there at once.
"""

import dask
from distributed.cli.dask_worker import main
from distributed.utils import get_mp_context

if __name__ == "__main__":
    with dask.config.set({"distributed.worker.multiprocessing-method": "forkserver"}):
        get_mp_context().set_forkserver_preload(["distributed", "substep.sweeps.task"])
        main()
