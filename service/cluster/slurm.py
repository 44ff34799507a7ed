"""Workers from a SLURM cluster, by dask-jobqueue: run it on a login node, then start the server.

``pip install "wrenchbook[cluster,server]" dask-jobqueue``, then ``python slurm.py --most 64``, then
``wrenchbook serve --engine dask --scheduler tcp://LOGIN-NODE:8786``.
"""

import argparse
import signal
import threading

from dask_jobqueue import SLURMCluster  # pyright: ignore[reportMissingImports]


def main() -> None:
    """Keep workers for what is queued, none when nothing is, until SIGTERM or SIGINT."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--most", type=int, default=16, help="solves at once")
    parser.add_argument("--queue", help="SLURM partition")
    parser.add_argument("--memory", default="4GB", help="of a worker: what a solve takes, and 1 GB")
    parser.add_argument("--walltime", default="04:00:00", help="longer than the longest solve")
    options = parser.parse_args()
    over = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: over.set())
    with SLURMCluster(
        cores=1,
        processes=1,
        memory=options.memory,
        queue=options.queue,
        walltime=options.walltime,
        # The node's own disk: bundles and attempts, found again by the next worker there.
        local_directory="$TMPDIR",
        job_script_prologue=[
            "export OMP_NUM_THREADS=1",
            "export WRENCHBOOK_WORKER_FOLDER=$TMPDIR/wrenchbook",
        ],
        # Ends a worker before SLURM does, so that what it has is given to others.
        worker_extra_args=["--lifetime", "3h", "--lifetime-stagger", "10m"],
        scheduler_options={"port": 8786, "dashboard": False},
    ) as cluster:
        cluster.adapt(minimum=1, maximum=options.most)
        print(f"the scheduler is at {cluster.scheduler_address}", flush=True)
        over.wait()


if __name__ == "__main__":
    main()
