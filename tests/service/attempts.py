"""Attempts as a dispatcher hands them to an engine."""

from wrenchbook.service.jobs.attempt import read_spec
from wrenchbook.service.jobs.engines.engine import ALIVE, Attempt


def asked(folder, **needs):
    """The attempt in a folder; nothing is known of one whose folder was never made."""
    spec = read_spec(folder) if folder.exists() else None
    return Attempt(f"task-{folder.name}", folder, spec, **needs)


def ended(engine, folder):
    """Whether the engine knows the attempt in a folder to have ended."""
    return engine.poll(asked(folder)) not in ALIVE
