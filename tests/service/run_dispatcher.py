"""A server in a process of its own, to be killed: run_dispatcher.py DATA_FOLDER.

It has a dispatcher, and answers each line of six loads with the number of the job it accepted.
"""

import sys
from pathlib import Path

from wrenchbook.service.jobs.dispatcher import Dispatcher
from wrenchbook.service.jobs.solver_pool import LocalEngine
from wrenchbook.service.ledger import Ledger

data = Path(sys.argv[1])
ledger = Ledger(data / "ledger.sqlite")
Dispatcher(ledger, LocalEngine(2), lambda name: data, data / "jobs").start()
print("started", flush=True)
for line in sys.stdin:
    job, _ = ledger.accept("bar", "f1", [float(load) for load in line.split()])
    print(job.id, flush=True)
