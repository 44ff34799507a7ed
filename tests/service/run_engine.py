"""A server in a process of its own, to be killed: run_engine.py FOLDER... submits these attempts.

It says when each has ended, and then waits to be killed, its solver waiting for work.
"""

import sys
from functools import partial
from pathlib import Path

from tests.service.attempts import asked, ended
from tests.until import until
from wrenchbook.service.jobs.solver_pool import LocalEngine

engine = LocalEngine(1)
for folder in map(Path, sys.argv[1:]):
    engine.submit(asked(folder))
    print("submitted", flush=True)
    until(partial(ended, engine, folder))
    print("ended", flush=True)
sys.stdin.read()
