"""Waiting for rows to be in use: an import is answered when they are durable."""

import time


def wait_for_version(http, name, version, seconds=30.0):
    """Ask a component until its table's version is this one or a later one."""
    deadline = time.monotonic() + seconds
    while http.get(f"/v1/components/{name}").json()["table_version"] < version:
        assert time.monotonic() < deadline, f"{name} is not at version {version}"
        time.sleep(0.02)
