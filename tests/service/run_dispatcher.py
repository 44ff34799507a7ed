"""A dispatcher in a process of its own, to be killed: run_dispatcher.py DATA_FOLDER."""

import signal
import sys
from pathlib import Path

from service.jobs.dispatcher import Dispatcher
from service.jobs.engines.local import LocalEngine
from service.ledger import Ledger

data = Path(sys.argv[1])
ledger = Ledger(data / "ledger.sqlite")
Dispatcher(ledger, LocalEngine(2), lambda name: data, data / "jobs").start()
print("started", flush=True)
signal.pause()
