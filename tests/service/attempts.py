"""Attempts as a dispatcher hands them to an engine."""

from dataclasses import replace

from tests.until import until
from wrenchbook.service.jobs.attempt import ALIVE, Attempt, read_attempt


def asked(folder, **needs):
    """The attempt in a folder; nothing is known of one whose folder was never made."""
    if not folder.exists():
        return Attempt(0, 0, "", "", "", (), folder=folder, task=f"task-{folder.name}", **needs)
    known = read_attempt(folder)
    return replace(known, task=f"task-{folder.name}", **needs)


def ended(engine, folder):
    """Whether the engine knows the attempt in a folder to have ended."""
    return engine.poll(asked(folder)) not in ALIVE


def wait_for_sweeps(dispatcher, count=2):
    """Return once a dispatcher has looked so many times more for what others left."""
    for _ in range(count):
        last = dispatcher._next_sweep
        until(lambda last=last: dispatcher._next_sweep != last)
